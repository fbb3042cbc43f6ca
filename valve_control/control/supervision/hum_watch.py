# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Finds a hum of the mains in the LVDT reading, also one that is too small for even cycles of the voltage.

The block means of the plausibility check give the complex amplitude of the reading at 50 and 60 Hz, in
windows weighted by Hann's 1 - cos (synchronous detection). A hum of the mains has an exact frequency: its
phase turns evenly from window to window. The command does not have it: its amplitude is computed alike, from
its value at the end of each block. A command beyond half the rate of the blocks folds: with blocks of 4 ms
one at 200 Hz counts as one at 50 Hz, and a hum beside it is not found. In fast motion, whose harmonics may
lie there, the hum is a small part of the differences between the blocks, and nothing is said.
"""

import math
from typing import NamedTuple

from valve_control.control.supervision import plausibility
from valve_control.parameter import Values

MAINS = (50.0, 60.0)  # Hz
WINDOW = 0.4  # s
ROWS = 3.0  # windows in a row
EXACT = 0.5  # Hz  by which the frequency may differ from that of the mains
FLOOR = 0.01  # V  amplitude from which a hum is reported
CALMED = 0.75  # of that amplitude, below which the report ends
SHARE = 0.3  # of the mean square of the differences between blocks, at least
COMMAND = 0.25  # of the amplitude of the reading that the command may have, at most
SHORT = 2.05  # blocks in a cycle, at least; with longer blocks nothing is measured


class Params(NamedTuple):
    """How the blocks are taken together."""

    span: float  # s  of a block
    blocks: float  # of a window, 0.0: the blocks are too long
    low_pass: float  # -  of the first filter behind the block mean


class Line(NamedTuple):
    """Sums at one frequency in the open window, and two results of the windows before it."""

    reading: float  # V  in phase
    reading_lag: float  # V  in quadrature
    command: float  # V
    command_lag: float  # V
    phase: float  # rad  of the reading in the last window
    rows: float  # windows in a row that were alike


class State(NamedTuple):
    """The open window, and the hum that is there."""

    taken: float  # blocks; -1.0: there has been none at all
    filtered: float  # V  block means behind the first filter
    last: float  # V  block mean
    change: float  # V²  sum of the squares of the differences between block means
    low: Line
    high: Line
    amplitude: float  # V
    frequency: float  # Hz, 0.0: no hum


EMPTY = Line(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
NOTHING = State(-1.0, 0.0, 0.0, 0.0, EMPTY, EMPTY, 0.0, 0.0)


def design(values: Values, c: plausibility.Params) -> Params:
    """Watch beside the plausibility check ``c``."""
    blocks = float(round(WINDOW / c.span))
    return Params(c.span, blocks if SHORT * MAINS[1] * c.span <= 1.0 else 0.0, c.low_pass)


def step(p: Params, s: State, seen: plausibility.SeenBlock) -> State:
    """State after one more block."""
    if p.blocks == 0.0:
        return s
    y1 = seen.shown.y1
    if s.taken < 0.0:
        s = s._replace(taken=0.0, filtered=y1, last=y1)
    reading = s.filtered + (y1 - s.filtered) / p.low_pass
    change = s.change + (reading - s.last) * (reading - s.last)
    low, high = (
        _added(line, 2.0 * math.pi * mains * p.span * s.taken, weight, reading, seen.command)
        for line, mains in ((s.low, MAINS[0]), (s.high, MAINS[1]))
        for weight in (1.0 - math.cos(2.0 * math.pi * s.taken / p.blocks),)
    )
    if s.taken + 1.0 < p.blocks:
        return State(s.taken + 1.0, y1, reading, change, low, high, s.amplitude, s.frequency)
    limit = max(FLOOR, seen.grain)
    amplitude = frequency = 0.0
    closed = []
    for line, mains in ((low, MAINS[0]), (high, MAINS[1])):
        there = abs(s.frequency - mains) < 2.0 * EXACT
        now, size, found = _closed(p, line, mains, CALMED * limit if there else limit, change)
        closed.append(now)
        if now.rows >= ROWS and size > amplitude:
            amplitude, frequency = size, found
    return State(0.0, y1, reading, 0.0, closed[0], closed[1], amplitude, frequency)


def _added(line: Line, angle: float, weight: float, reading: float, command: float) -> Line:
    """``line`` after one more block."""
    c, d = weight * math.cos(angle), weight * math.sin(angle)
    return Line(
        line.reading + c * reading,
        line.reading_lag + d * reading,
        line.command + c * command,
        line.command_lag + d * command,
        line.phase,
        line.rows,
    )


def _closed(p: Params, line: Line, mains: float, limit: float, change: float) -> tuple[Line, float, float]:
    """``line`` after its window, amplitude [V] of the reading, and frequency [Hz].

    ``limit`` [V]: amplitude from which it counts; ``change`` [V²]: sum of all squared differences.
    """
    half = math.pi * mains * p.span
    scale = 2.0 / p.blocks
    block = scale * math.hypot(line.reading, line.reading_lag)  # a mean over a block is smaller by sin(x)/x
    command = scale * math.hypot(line.command, line.command_lag)
    phase = math.atan2(-line.reading_lag, line.reading)
    turn = phase - line.phase - 2.0 * half * p.blocks
    turn = (turn + math.pi) % (2.0 * math.pi) - math.pi
    off = turn / (2.0 * math.pi * p.blocks * p.span)
    difference = 2.0 * block * math.sin(half)
    amplitude = block * half / math.sin(half)
    rows = 0.0
    if (
        amplitude > limit
        and 0.5 * difference * difference * p.blocks > SHARE * change
        and command < COMMAND * amplitude
    ):
        rows = line.rows + 1.0 if abs(off) < EXACT else 1.0
    return Line(0.0, 0.0, 0.0, 0.0, phase, min(rows, ROWS)), amplitude, mains + off


def text(p: Params, s: State) -> str:
    """One sentence about the hum, "": there is none."""
    if s.frequency == 0.0:
        return ""
    mains = min(MAINS, key=lambda one: abs(one - s.frequency))
    hum = f"{1e3 * s.amplitude:.3g} mV at {s.frequency:.3g} Hz (mains: {mains:.0f} Hz)"
    return f"LVDT reading has a hum of {hum}"
