# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Judges whether the spool answers the voltage: a pull that no disturbance holds must move the reading.

A reading y at rest asks for the voltage y·a0/b0, within SPREAD of it. What the voltage u exceeds it by is the
pull. Friction and offset together are at most D. The laziest valve of these bounds has all of D as friction:

    x'' = b0·(|pull| - D) - a1·x',  x' >= 0 in the direction of the pull,

with the pull behind a low-pass filter as slow as the dead time, and from the speed that the spool may have
against it. Each time when this due motion has reached LEAST tolerances, the reading must have gone by SHARE
of it, noisy or not. See docs/explanation/plausibility.md.
"""

import math
from typing import NamedTuple

from valve_control.control.supervision import lvdt

SPREAD = 1.25  # factor by which the valve may ask for more, or less, than the identified one
LEAST = 3.0  # tolerances of the LVDT
SHARE = 0.3  # of the due motion, that the reading must show
DOUBTED = 0.5  # of the largest disturbance, which is what readings in doubt may claim
AGREED = 0.3  # of the largest disturbance: a pull below which reading and voltage agree


class State(NamedTuple):
    """The pull, and the motion that is due since the last answer."""

    pull: float  # V
    side: float  # 1.0 or -1.0, 0.0: no motion is due
    rate: float  # V/s  of the due motion in the direction of the pull; below 0: the spool has yet to turn
    due: float  # V
    start: float  # V  reading from which the answer counts


NOTHING = State(0.0, 0.0, 0.0, 0.0, 0.0)


def step(
    p: lvdt.Params, s: State, reading: float, speed: float, voltage: float, samples: int, doubted: bool
) -> tuple[str, State]:
    """Name of what is wrong, "": nothing, after ``reading`` [V] with ``voltage`` [V] for ``samples`` periods.

    ``speed`` [V/s]: of the readings before; ``doubted``: whether they were found wrong before.
    """
    if p.b0 == 0.0:
        return "", s
    time = samples * p.period
    held = DOUBTED * p.disturbance if doubted else p.disturbance
    force = s.pull + time / (lvdt.DEAD_TIME + time) * (pull(voltage, reading * p.a0 / p.b0) - s.pull)
    if s.side == 0.0 and abs(force) <= held:
        return "", State(force, 0.0, 0.0, 0.0, 0.0)
    side = math.copysign(1.0, force) if s.side == 0.0 else s.side
    if abs(reading) > lvdt.INSIDE * p.limit and reading * side > 0.0:
        return "", State(force, 0.0, 0.0, 0.0, 0.0)
    if s.side == 0.0:
        return "", State(force, side, min(0.0, side * speed), 0.0, reading)
    excess = side * force - held
    rate = (s.rate + time * p.b0 * excess) / (1.0 + time * p.a1)
    if rate <= 0.0:
        return "", State(force, side if excess > 0.0 else 0.0, rate, 0.0, reading)
    due, gone = s.due + time * rate, side * (reading - s.start)
    if due < LEAST * p.tolerance:
        return "", State(force, side, rate, due, s.start)
    if gone < SHARE * due:
        return "wrong_sign" if gone < -SHARE * due else "unanswered", NOTHING
    return "", State(force, side, 0.0, 0.0, reading)


def pull(voltage: float, asked: float) -> float:
    """Part of the ``voltage`` [V] beyond what a reading asks for, ``asked`` [V] on the identified valve."""
    return voltage - (asked * SPREAD if (voltage - asked) * asked > 0.0 else asked / SPREAD)
