# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Measures the noise of the LVDT, at rest and in motion, and compares it with that of the start.

Second differences D of the readings leave of a motion with the acceleration x'' only x''·ΔT², and of white
noise of the standard deviation σ the mean |D| = √6·√(2/π)·σ. The mean |D| of a window, less the square of
the part that the voltage explains, gives σ. What balances friction and spring changes slowly; the rest of the
voltage, above a low-pass filter, accelerates the spool by at most MOST·b0 times itself. A mean of magnitudes
is robust against a few jumps.
"""

import math
from typing import NamedTuple

from valve_control.control.supervision import plausibility
from valve_control.parameter import Values, number

SHARE = 1.954  # mean |D| over σ
MOST = 3.0  # times the model's acceleration, of a stronger valve
SLOW = 0.02  # s  time constant of the slow part of the voltage
WINDOW = 0.25  # s
LEARNT = 4.0  # windows whose mean is the noise of the start
LOUDER = 4.0  # times that noise is reported
ROUNDING = 0.3  # of the converter's step, noise that rounding gives in motion
FLOOR = 0.005  # V  noise below is none that is reported
LASTING = 2.0  # windows in a row
CALMED = 0.75  # of the reported noise, below which the word ends


class Params(NamedTuple):
    """What the voltage explains of the second differences."""

    blocks: float  # of a window
    explained: float  # -  second difference of the reading over the voltage that pulls
    follow: float  # -  share by which the slow part of the voltage follows it in a block


class State(NamedTuple):
    """The open window and the noise of those before it."""

    blocks: float
    differences: float  # V  sum of |D|
    pull: float  # V  sum of the magnitudes of the quick part of the voltage
    slow: float  # V  the other part
    windows: float  # that have been learnt from
    usual: float  # V  noise of the start
    noise: float  # V  in the last window
    loud: float  # windows in a row that were louder than allowed; once reported, LASTING until it is calm


NOTHING = State(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def design(values: Values, c: plausibility.Params) -> Params:
    """Watch with the controller's ``values`` beside the plausibility check ``c``."""
    period = number(values, "sample_period")
    return Params(
        max(1.0, float(round(WINDOW / c.span))),
        MOST * c.b0 * period * period,
        min(1.0, c.span / SLOW),
    )


def step(p: Params, s: State, block: plausibility.Block) -> State:
    """State after one more block."""
    blocks = s.blocks + 1.0
    differences = s.differences + abs(block.second_difference)
    pull = s.pull + abs(block.voltage - s.slow)
    slow = s.slow + p.follow * (block.voltage - s.slow)
    if blocks < p.blocks:
        return State(blocks, differences, pull, slow, s.windows, s.usual, s.noise, s.loud)
    motion = p.explained * pull
    noise = math.sqrt(max(0.0, differences * differences - motion * motion)) / (SHARE * blocks)
    if s.windows < LEARNT:
        usual = s.usual + (noise - s.usual) / (s.windows + 1.0)
        return State(0.0, 0.0, 0.0, slow, s.windows + 1.0, usual, noise, 0.0)
    limit = max(FLOOR, LOUDER * max(s.usual, ROUNDING * block.converter_step))
    loud = 0.0
    if noise > (CALMED * limit if s.loud >= LASTING else limit):
        loud = min(LASTING, s.loud + 1.0)
    return State(0.0, 0.0, 0.0, slow, s.windows, s.usual, noise, loud)


def text(p: Params, s: State) -> str:
    """One sentence about the noise of the last window, "": it is as at the start."""
    if s.loud < LASTING:
        return ""
    return f"LVDT noise is {1e3 * s.noise:.3g} mV rms, {1e3 * s.usual:.3g} mV at the start"


def forgotten(s: State) -> State:
    """State after a reset, or under another model of the valve: the noise of the start stays."""
    return s
