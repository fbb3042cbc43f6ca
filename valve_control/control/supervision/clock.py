# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Offset between two clocks, from messages that carry the time of one and arrive at a time of the other.

The difference of the two times is the offset plus the delay on the way. A line through the differences
follows offset and drift: a second-order loop on innovations that are limited, so that late messages do not
move it. The smallest residual of the last messages lowers the line to the smallest delay, as NTP and PTP do.
"""

from typing import NamedTuple

OFFSET = 0.5  # s  time constant of the line's offset
DRIFT = 1.0  # s  of its drift; twice OFFSET gives a damping of 1
LARGEST = 0.05  # s/s  drift of a clock
LIMIT = 0.001  # s  of an innovation; a message that much before the smallest delay begins the line anew
LEAP = 0.1  # s  by which a message is late that does, for a clock was set; the drift is kept
WINDOW = 0.25  # s  the smallest residual is that of this window and of the one before
SETTLING = 0.1  # s  time constant with which it counts


class State(NamedTuple):
    """A line of differences, and the residuals below it."""

    time: float  # s  of the last message
    offset: float  # s  of the line at this time
    drift: float  # s/s
    messages: float
    smallest: float  # s  residual of this window
    former: float  # s  residual of the window before
    begin: float  # s  of this window
    lowered: float  # s  by which the line lies above the smallest delay, below 0


NOTHING = State(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def step(s: State, time: float, difference: float) -> State:
    """Take in the ``difference`` [s] of a message that came at ``time`` [s], in time or not."""
    elapsed = time - s.time if time > s.time else 0.0
    line = s.offset + s.drift * elapsed
    innovation = difference - line
    if s.messages == 0.0 or innovation > LEAP or innovation < s.lowered - LIMIT or elapsed > OFFSET:
        return State(time, difference, s.drift, 1.0, 0.0, 0.0, time, 0.0)
    messages = s.messages + 1.0
    innovation = max(-LIMIT, min(LIMIT, innovation))
    first, share = 1.0 / messages, elapsed / OFFSET
    offset = line + max(share, first) * innovation
    shift = line - offset if first > share else 0.0  # of residuals, while a line has just begun
    drift = max(-LARGEST, min(LARGEST, s.drift + elapsed / (DRIFT * DRIFT) * innovation))
    residual = difference - offset
    smallest, former, begin = min(s.smallest + shift, residual), s.former + shift, s.begin
    if time - begin > WINDOW:
        smallest, former, begin = residual, smallest, time
    lowered = s.lowered + shift
    lowered += max(first, min(1.0, elapsed / SETTLING)) * (min(smallest, former) - lowered)
    return State(time, offset, drift, messages, smallest, former, begin, lowered)


def offset(s: State) -> float:
    """Difference [s] of the two clocks at the last message, as a message with the smallest delay shows it."""
    return s.offset + s.lowered
