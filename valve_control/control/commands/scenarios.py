# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes command shapes: the commanded spool position [V] as a function of time [s]."""

import bisect
import functools
import math
from typing import NamedTuple


class Shape(NamedTuple):
    """One command shape; each scenario uses the fields that it needs."""

    scenario: str  # point_to_point, sine, triangle, step, sweep, stepped_sine or constant
    amplitude: float  # V     height, stroke or amplitude
    offset: float  # V     added to everything
    start: float  # s     standstill before the motion begins
    frequency: float  # Hz    sine, triangle; start of the sweep; first step
    end_frequency: float  # Hz    end of the sweep; last step
    max_velocity: float  # V/s   point to point
    max_accel: float  # V/s²  point to point
    cycle: float  # s     point to point: there and back again
    sweep_time: float  # s     duration of one sweep
    steps: int = 30  # -     frequencies of the stepped sine
    cycles: int = 5  # -     least cycles of each; those of the triangle
    step_time: float = 1.0  # s     least time of each


def strokes(amplitude: float, velocity: float, accel: float, cycle: float) -> Shape:
    """Point to point over ``amplitude`` [V], there and back in each ``cycle`` [s], from the beginning on."""
    return Shape("point_to_point", amplitude, 0.0, 0.0, 1.0, 1.0, velocity, accel, cycle, 1.0)


class Step(NamedTuple):
    """One frequency of a stepped sine, from ``start`` to ``end`` [s] after the motion's beginning."""

    start: float  # s
    end: float  # s
    frequency: float  # Hz


SCENARIOS = {
    "point_to_point": "smooth motion there and back with limited velocity and acceleration (Fig. 5)",
    "sine": "sine wave (Fig. 4: 6 Hz)",
    "triangle": "straight lines up and down, whole cycles of one frequency: slowly, it tells friction",
    "step": "step to the amplitude",
    "sweep": "sine whose frequency rises exponentially from frequency to end_frequency",
    "stepped_sine": "whole cycles of one frequency after the other, from frequency to end_frequency",
    "constant": "the offset alone",
}


def stroke_time(distance: float, max_velocity: float, max_accel: float) -> tuple[float, float, float]:
    """Ramp time [s], cruise time [s] and peak velocity [V/s] of one stroke of ``distance`` [V] >= 0.

    The velocity rises and falls along half a cosine, v = vp·(1 - cos(πt/tr))/2, whose acceleration peaks
    at π·vp/(2·tr); the two ramps together cover vp·tr.
    """
    peak = max_velocity
    ramp = math.pi * peak / (2.0 * max_accel)
    if peak * ramp > distance:
        peak = math.sqrt(2.0 * max_accel * distance / math.pi)
        ramp = math.pi * peak / (2.0 * max_accel)
        return ramp, 0.0, peak
    return ramp, (distance - peak * ramp) / peak, peak


def _rising(time: float, ramp: float, peak: float) -> float:
    """Way [V] that the velocity has covered on its rise to ``peak`` [V/s] within ``ramp`` [s]."""
    return 0.5 * peak * (time - ramp / math.pi * math.sin(math.pi * time / ramp))


def stroke(time: float, distance: float, max_velocity: float, max_accel: float) -> float:
    """Position [V] on one smooth stroke from 0 to ``distance`` [V] that begins at time 0."""
    if distance == 0.0 or time <= 0.0:
        return 0.0
    size = abs(distance)
    sign = math.copysign(1.0, distance)
    ramp, cruise, peak = stroke_time(size, max_velocity, max_accel)
    if time < ramp:
        return sign * _rising(time, ramp, peak)
    if time < ramp + cruise:
        return sign * (0.5 * peak * ramp + peak * (time - ramp))
    if time < 2.0 * ramp + cruise:
        return sign * (size - _rising(2.0 * ramp + cruise - time, ramp, peak))
    return distance


def there_and_back(shape: Shape, time: float) -> float:
    """Position [V] on the strokes of a point-to-point motion that began at time 0, without the offset."""
    t = time % shape.cycle
    there = stroke(t, shape.amplitude, shape.max_velocity, shape.max_accel)
    return there + stroke(t - 0.5 * shape.cycle, -shape.amplitude, shape.max_velocity, shape.max_accel)


@functools.cache
def sine_steps(
    frequency: float, end_frequency: float, steps: int, cycles: int, step_time: float
) -> tuple[Step, ...]:
    """Log-spaced frequencies [Hz], each with whole ``cycles`` that last at least ``step_time`` [s]."""
    made: list[Step] = []
    start = 0.0
    for i in range(steps):
        f = frequency * (end_frequency / frequency) ** (i / max(1, steps - 1))
        end = start + max(cycles, math.ceil(step_time * f)) / f
        made.append(Step(start, end, f))
        start = end
    return tuple(made)


def steps_of(shape: Shape) -> tuple[Step, ...]:
    """The steps of a stepped sine."""
    return sine_steps(shape.frequency, shape.end_frequency, shape.steps, shape.cycles, shape.step_time)


def stepped_sine(steps: tuple[Step, ...], time: float) -> float:
    """Unit sine at ``time`` [s] of a stepped sine that began at time 0; 0 after its end."""
    i = bisect.bisect_right(steps, time, key=lambda step: step.end)
    if i == len(steps):
        return 0.0
    return math.sin(2.0 * math.pi * steps[i].frequency * (time - steps[i].start))


def triangle(frequency: float, cycles: int, time: float) -> float:
    """Unit triangle at ``time`` [s] of one that began at 0 at time 0; 0 after its ``cycles``."""
    turns = time * frequency
    if turns >= cycles:
        return 0.0
    share = turns % 1.0
    if share < 0.25:
        return 4.0 * share
    return 2.0 - 4.0 * share if share < 0.75 else 4.0 * share - 4.0


def command(shape: Shape, time: float) -> float:
    """Command [V] at ``time`` [s] after the beginning."""
    t = time - shape.start
    a = shape.amplitude
    if t < 0.0 or shape.scenario == "constant":
        return shape.offset
    if shape.scenario == "step":
        return shape.offset + a
    if shape.scenario == "sine":
        return shape.offset + a * math.sin(2.0 * math.pi * shape.frequency * t)
    if shape.scenario == "triangle":
        return shape.offset + a * triangle(shape.frequency, shape.cycles, t)
    if shape.scenario == "sweep":
        t = min(t, shape.sweep_time)
        ratio = math.log(shape.end_frequency / shape.frequency)
        if ratio == 0.0:
            return shape.offset + a * math.sin(2.0 * math.pi * shape.frequency * t)
        length = shape.sweep_time / ratio
        phase = 2.0 * math.pi * shape.frequency * length * math.expm1(t / length)
        return shape.offset + a * math.sin(phase)
    if shape.scenario == "stepped_sine":
        return shape.offset + a * stepped_sine(steps_of(shape), t)
    return shape.offset + there_and_back(shape, t)
