# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Compares the gain of the readings over the voltage with that of the start, on slow motions.

A reading asks for the voltage w of ``plausibility``; the applied voltage is u = κ·w + F·sgn y' + c. An LVDT
of r times its gain gives κ/r, and so does a valve of r times its gain: nothing tells these apart. On slow
motions a wrong a1 or a0 of the model hardly changes κ: at the frequency ω its error is (ω/ω0)² times that of
the model. The frequency of a motion is that of the rms rate over the rms position.
"""

import math
from typing import NamedTuple

from valve_control.control.supervision import plausibility
from valve_control.control.supervision.plausibility import NOTHING as EMPTY
from valve_control.control.supervision.plausibility import Block, Sums
from valve_control.parameter import Values

EVERY = 4.0  # blocks of the plausibility check, of which one counts
FORGET = 70.0  # of the sums, moved time in units of 1/√a0
SLOW = 0.35  # frequency of a motion that counts, in units of √a0
ENOUGH = 0.5  # of the moved time FORGET, from which on a slope is known
LARGE = 0.7  # V  least standard deviation of the readings; friction makes smaller motions uncertain
CHANGED = 1.5  # factor that is reported
BACK = 1.3  # factor below which the report ends
LASTING = 1.0  # of the moved time FORGET, for which it must be there


class Params(NamedTuple):
    """How much motion is needed."""

    keep: float  # -  what is left of the sums after one entry
    enough: float  # entries
    lasting: float  # entries
    slow: float  # 1/s²  square of the frequency below which a motion counts
    span: float  # s  between two entries
    check: plausibility.Params  # beside which it is


class State(NamedTuple):
    """Sums over slow motion, and the slopes that they gave."""

    skipped: float  # blocks since the last entry
    velocity: float  # V/s  at the last entry
    sums: Sums
    rates: float  # V²/s²  sum of the squares of the velocity
    usual: float  # -  slope of the start, 0.0: not known yet
    present: float  # -  slope now, 0.0: not known yet
    strange: float  # entries for which it has been another; once reported, all that are needed


NOTHING = State(0.0, 0.0, EMPTY, 0.0, 0.0, 0.0, 0.0)


def design(values: Values, c: plausibility.Params) -> Params:
    """Watch beside the plausibility check ``c``."""
    own = 1.0 / math.sqrt(c.a0)
    span = EVERY * c.span
    entries = FORGET * own / span
    return Params(math.exp(-1.0 / entries), ENOUGH * entries, LASTING * entries, SLOW * SLOW * c.a0, span, c)


def step(p: Params, s: State, block: Block) -> State:
    """State after one more block."""
    if block.doubted:
        return s
    c = p.check
    skipped = s.skipped + 1.0
    if skipped < EVERY:
        return State(skipped, s.velocity, s.sums, s.rates, s.usual, s.present, s.strange)
    velocity = block.velocity
    if not block.settled or abs(velocity) <= c.slow:
        return s._replace(skipped=0.0, velocity=velocity)
    acceleration = (velocity - s.velocity) / p.span
    w = (acceleration + c.a1 * velocity + c.a0 * block.position) / c.b0
    u, sign = block.filtered_voltage, math.copysign(1.0, velocity)
    sums = plausibility.add(p.keep, s.sums, u, block.position, w, sign)
    rates = p.keep * s.rates + velocity * velocity
    present = slope(p, c, sums, rates)
    if present == 0.0:
        return State(0.0, velocity, sums, rates, s.usual, 0.0, s.strange)
    if s.usual == 0.0:
        return State(0.0, velocity, sums, rates, present, present, 0.0)
    change = max(present / s.usual, s.usual / present)
    strange = 0.0
    if change > (BACK if s.strange >= p.lasting else CHANGED):
        strange = min(p.lasting, s.strange + 1.0)
    return State(0.0, velocity, sums, rates, s.usual, present, strange)


def stopped(s: State) -> State:
    """State after the voltage was switched off: the slope of the start stays, the motion does not."""
    return State(0.0, 0.0, EMPTY, 0.0, s.usual, 0.0, s.strange)


def slope(p: Params, c: plausibility.Params, sums: Sums, rates: float) -> float:
    """Voltage over voltage that slow motion asks for, 0.0: too little of it, too small or too fast."""
    if sums.n < p.enough:
        return 0.0
    spread = sums.n * sums.zz - sums.z * sums.z
    if spread < sums.n * sums.n * LARGE * LARGE or rates * sums.n > p.slow * spread:
        return 0.0
    return max(0.0, plausibility.slope(c, sums))


def text(p: Params, s: State) -> str:
    """One sentence about the change, "": there is none."""
    if s.strange < p.lasting:
        return ""
    times = s.usual / s.present if s.present > 0.0 else 1.0
    return f"LVDT readings over the voltage are {times:.2g} times those of the start: LVDT or valve drifts"
