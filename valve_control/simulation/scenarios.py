"""Command shapes: functions of time [s] that give the spool position command [V]."""

import math
from typing import NamedTuple


class Shape(NamedTuple):
    """One command shape; each scenario uses what it needs."""

    scenario: str  # point_to_point, sine, step, sweep or constant
    amplitude: float  # V     height, stroke or amplitude
    offset: float  # V     added to everything
    start: float  # s     standstill before the motion begins
    frequency: float  # Hz    sine; start of the sweep
    end_frequency: float  # Hz    end of the sweep
    max_velocity: float  # V/s   point to point
    max_accel: float  # V/s²  point to point
    cycle: float  # s     point to point: there and back again
    sweep_time: float  # s     duration of one sweep


SCENARIOS = {
    "point_to_point": "smooth motion there and back with limited velocity and acceleration (Fig. 5)",
    "sine": "sine wave (Fig. 4: 6 Hz)",
    "step": "step to the amplitude",
    "sweep": "sine whose frequency rises exponentially from frequency to end_frequency",
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


def stroke(time: float, distance: float, max_velocity: float, max_accel: float) -> float:
    """Position [V] on one smooth stroke from 0 to ``distance`` [V] that begins at time 0."""
    if distance == 0.0 or time <= 0.0:
        return 0.0
    size = abs(distance)
    sign = math.copysign(1.0, distance)
    ramp, cruise, peak = stroke_time(size, max_velocity, max_accel)

    def rising(t: float) -> float:
        return 0.5 * peak * (t - ramp / math.pi * math.sin(math.pi * t / ramp))

    if time < ramp:
        return sign * rising(time)
    if time < ramp + cruise:
        return sign * (0.5 * peak * ramp + peak * (time - ramp))
    if time < 2.0 * ramp + cruise:
        return sign * (size - rising(2.0 * ramp + cruise - time))
    return distance


def there_and_back(shape: Shape, time: float) -> float:
    """Position [V] on the strokes of a point-to-point motion that began at time 0, without the offset."""
    t = time % shape.cycle
    there = stroke(t, shape.amplitude, shape.max_velocity, shape.max_accel)
    return there + stroke(t - 0.5 * shape.cycle, -shape.amplitude, shape.max_velocity, shape.max_accel)


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
    if shape.scenario == "sweep":
        t = min(t, shape.sweep_time)
        ratio = math.log(shape.end_frequency / shape.frequency)
        if ratio == 0.0:
            return shape.offset + a * math.sin(2.0 * math.pi * shape.frequency * t)
        length = shape.sweep_time / ratio
        phase = 2.0 * math.pi * shape.frequency * length * math.expm1(t / length)
        return shape.offset + a * math.sin(phase)
    if shape.scenario == "point_to_point":
        return shape.offset + there_and_back(shape, t)
    raise ValueError(f"scenario '{shape.scenario}' is not one of {', '.join(SCENARIOS)}")
