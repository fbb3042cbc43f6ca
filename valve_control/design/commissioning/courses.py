# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Gives the commands of each test, reading by reading, within the limits of voltage and travel.

While the law is ``open_loop`` with a static gain of 1 a command is the voltage itself.
"""

import math
from collections.abc import Sequence

from valve_control.arrays import Floats
from valve_control.control.commands.scenarios import Step
from valve_control.control.parameters import build
from valve_control.design.commissioning.bench import Course, Mark, Point, SafetyLimits

PIECE = 0.5  # s  of a rest, that a pause spoils
REACH = 0.8  # of the travel, at which a course turns round
CLOSE = 0.9  # of the travel, that a spool may go on to after a turn
LOWER = 0.9  # factor by which a sine is made smaller where the reading reaches that
CALM = 0.05  # s  between two such factors, so that the spool can follow
LATE, MISSED = 0.005, 1.5  # s, sample periods: part of a ramp that is made good after a pause of this process


def rest(duration: float, mark: Mark = lambda stretch, time: None, first: int = 0) -> Course:
    """0 V for ``duration`` [s], of which each PIECE is a stretch for ``mark``, from the ``first`` on."""
    before = first * PIECE
    now = yield 0.0
    while before + now.time < duration:
        if before + now.time >= (first + 1) * PIECE:
            first += 1
            mark(first, now.time)
        now = yield 0.0


def triangle(
    limits: SafetyLimits,
    rate: float,
    turns: int,
    mark: Mark = lambda stretch, time: None,
    period: float = 0.0,
    first: int = 0,
) -> Course:
    """Voltage that rises and falls at ``rate`` [V/s], with ``turns`` turns, and ends at 0 V.

    It turns where the voltage reaches its limit, or the reading REACH of the travel. Where the spool goes on
    after a turn to CLOSE of the travel, it turns earlier the next time, by as much as the spool went on.
    ``mark`` gets each stretch, which begins with the turn of this number. ``period`` [s]: between two
    readings. ``first``: stretch with which the course begins, from 0 V through the turn before it.
    """
    most = max(LATE, MISSED * period)
    turn = max(0, first - 1)
    value, direction, last = 0.0, -1.0 if turn % 2 else 1.0, 0.0
    turned, beyond = math.inf, 0.0
    now = yield 0.0
    while turn < turns:
        value += direction * rate * min(most, now.time - last)
        last = now.time
        if -direction * now.reading > CLOSE * limits.travel:
            beyond = max(beyond, -direction * now.reading - turned)
        if direction * value >= limits.voltage or direction * now.reading >= REACH * limits.travel - beyond:
            value = max(-limits.voltage, min(limits.voltage, value))
            turned = max(0.0, direction * now.reading)
            direction = -direction
            turn += 1
            mark(turn, now.time)
        now = yield value
    while value != 0.0:
        change = rate * min(most, now.time - last)
        last = now.time
        value = math.copysign(max(0.0, abs(value) - change), value)
        now = yield value + 0.0


def stepped_sine(
    limits: SafetyLimits,
    steps: Sequence[Step],
    amplitude: float,
    offset: float,
    mark: Mark = lambda stretch, time: None,
    period: float = 0.0,
    first: int = 0,
) -> Course:
    """Sines of ``amplitude`` around ``offset`` [V], one frequency after the other.

    The amplitude becomes smaller, and stays so, where the reading reaches REACH of the travel. ``mark`` gets
    each stretch, which is a frequency; ``first``: the one with which the course begins, at the sample of the
    whole course, which has one every ``period`` [s].
    """
    before = math.ceil(steps[first].start / period - 1e-9) * period if first else 0.0
    lowered = 0.0
    now = yield max(-limits.voltage, min(limits.voltage, offset))
    for number, step in enumerate(steps[first:], first):
        if number > first:
            mark(number, math.ceil(step.start / period - 1e-9) * period - before if period else now.time)
        while before + now.time < step.end:
            time = before + now.time
            if abs(now.reading) > REACH * limits.travel and time > lowered + CALM:
                amplitude *= LOWER
                lowered = time
            value = offset + amplitude * math.sin(2.0 * math.pi * step.frequency * (time - step.start))
            now = yield max(-limits.voltage, min(limits.voltage, value))
    yield 0.0


def motion(
    wanted: Floats, period: float, stretches: Sequence[int] = (), mark: Mark = lambda stretch, time: None
) -> Course:
    """Points of a ``wanted`` motion [V], one entry a sample, that begins and ends at 0 V.

    ``mark`` gets the stretches that begin at the samples ``stretches``, from 1 on.
    """
    velocity, acceleration = build.derivatives(wanted, period)
    left = list(enumerate(stretches, 1))
    last = len(wanted) - 1
    k, time = 0, 0.0
    while k <= last:
        if left and k >= left[0][1]:
            mark(left.pop(0)[0], time)
        now = yield Point(float(wanted[k]), float(velocity[k]), float(acceleration[k]))
        time = now.time
        k = round(time / period)
    yield Point(0.0, 0.0, 0.0)
