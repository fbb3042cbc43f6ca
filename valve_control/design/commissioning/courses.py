# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Gives the commands of each test, reading by reading, within the limits of voltage and travel.

While the law is ``open_loop`` with a static gain of 1 a command is the voltage itself.
"""

import math
from collections.abc import Sequence

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.commands.scenarios import Step
from valve_control.design.commissioning.bench import Begun, Course, Point, SafetyLimits, nothing_begun

PIECE = 0.5  # s  of a rest, that a pause spoils
REACH = 0.8  # of the travel, at which a course turns round
CLOSE = 0.9  # of the travel, that a spool may go on to after a turn
LOWER = 0.9  # factor by which a sine is made smaller where the reading reaches that
CALM = 0.05  # s  between two such factors, so that the spool can follow
LATE, MISSED = 0.005, 1.5  # s, sample periods: part of a ramp that is made good after a pause of this process


def rest(duration: float, begun: Begun = nothing_begun, first: int = 0) -> Course:
    """0 V for ``duration`` [s], of which each PIECE is a stretch for ``begun``, from the ``first`` on."""
    before = first * PIECE
    seen = yield 0.0
    while before + seen.time < duration:
        if before + seen.time >= (first + 1) * PIECE:
            first += 1
            begun(first, seen.time)
        seen = yield 0.0


def triangle(
    limits: SafetyLimits,
    rate: float,
    turns: int,
    begun: Begun = nothing_begun,
    period: float = 0.0,
    first: int = 0,
) -> Course:
    """Voltage that rises and falls at ``rate`` [V/s], with ``turns`` turns, and ends at 0 V.

    It turns where the voltage reaches its limit, or the reading REACH of the travel. Where the spool goes on
    after a turn to CLOSE of the travel, it turns earlier the next time, by as much as the spool went on.
    ``begun`` gets each stretch, which begins with the turn of this number. ``period`` [s]: between two
    readings. ``first``: stretch with which the course begins, from 0 V through the turn before it.
    """
    most = max(LATE, MISSED * period)
    turn = max(0, first - 1)
    value, direction, last = 0.0, -1.0 if turn % 2 else 1.0, 0.0
    turned, beyond = math.inf, 0.0
    seen = yield 0.0
    while turn < turns:
        value += direction * rate * min(most, seen.time - last)
        last = seen.time
        if -direction * seen.reading > CLOSE * limits.travel:
            beyond = max(beyond, -direction * seen.reading - turned)
        if direction * value >= limits.voltage or direction * seen.reading >= REACH * limits.travel - beyond:
            value = max(-limits.voltage, min(limits.voltage, value))
            turned = max(0.0, direction * seen.reading)
            direction = -direction
            turn += 1
            begun(turn, seen.time)
        seen = yield value
    while value != 0.0:
        change = rate * min(most, seen.time - last)
        last = seen.time
        value = math.copysign(max(0.0, abs(value) - change), value)
        seen = yield value + 0.0


def triangle_time(limits: SafetyLimits, rate: float, turns: int, turned: Sequence[float]) -> float:
    """About how long [s] a triangle takes of which the times ``turned`` [s] of the turns until now are known.

    Until its first turn it is taken to reach the limit of the voltage.
    """
    if not turned:
        return 2.0 * turns * limits.voltage / rate
    if len(turned) == 1:
        return 2.0 * turns * turned[0]
    stretch = (turned[-1] - turned[0]) / (len(turned) - 1)
    return turned[-1] + (turns - len(turned) + 0.5) * stretch


def stepped_sine(
    limits: SafetyLimits,
    steps: Sequence[Step],
    amplitude: float,
    offset: float,
    begun: Begun = nothing_begun,
    period: float = 0.0,
    first: int = 0,
) -> Course:
    """Sines of ``amplitude`` around ``offset`` [V], one frequency after the other.

    The amplitude becomes smaller, and stays so, where the reading reaches REACH of the travel. ``begun`` gets
    each stretch, which is a frequency; ``first``: the one with which the course begins, at the sample of the
    whole course, which has one every ``period`` [s].
    """
    before = math.ceil(steps[first].start / period - 1e-9) * period if first else 0.0
    lowered = 0.0
    seen = yield max(-limits.voltage, min(limits.voltage, offset))
    for number, step in enumerate(steps[first:], first):
        if number > first:
            begun(number, math.ceil(step.start / period - 1e-9) * period - before if period else seen.time)
        while before + seen.time < step.end:
            time = before + seen.time
            if abs(seen.reading) > REACH * limits.travel and time > lowered + CALM:
                amplitude *= LOWER
                lowered = time
            value = offset + amplitude * math.sin(2.0 * math.pi * step.frequency * (time - step.start))
            seen = yield max(-limits.voltage, min(limits.voltage, value))
    yield 0.0


def motion(
    wanted: Floats, period: float, stretches: Sequence[int] = (), begun: Begun = nothing_begun
) -> Course:
    """Points of a ``wanted`` motion [V], one entry a sample, that begins and ends at 0 V.

    ``begun`` gets the stretches that begin at the samples ``stretches``, from 1 on.
    """
    velocity, acceleration = derivatives(wanted, period)
    left = list(enumerate(stretches, 1))
    last = len(wanted) - 1
    k, time = 0, 0.0
    while k <= last:
        if left and k >= left[0][1]:
            begun(left.pop(0)[0], time)
        seen = yield Point(float(wanted[k]), float(velocity[k]), float(acceleration[k]))
        time = seen.time
        k = round(time / period)
    yield Point(0.0, 0.0, 0.0)


def derivatives(wanted: Floats, period: float) -> tuple[Floats, Floats]:
    """Velocity [V/s] and acceleration [V/s²] of a ``wanted`` motion [V], one entry a sample."""
    velocity: Floats = np.gradient(wanted, period)
    acceleration: Floats = np.gradient(velocity, period)
    return velocity, acceleration
