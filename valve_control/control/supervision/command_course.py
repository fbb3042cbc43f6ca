# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Course of the command between the messages of an upper level that is slower than the loop.

The commands' own time stamps tell how far they are apart, so that an uneven way to the controller does not
bend the course; when they are due on the clock of the samples is smoothed for the same reason.
"""

from typing import NamedTuple

from valve_control.control.laws.projection import clip
from valve_control.control.plant.amplifier import saturate
from valve_control.control.supervision.late_commands import LONGEST, joined
from valve_control.parameter import Values, number, word

STEEPER = 6.0  # from one line to the next, of a motion


class Params(NamedTuple):
    """How commands are joined."""

    extrapolate: bool  # to where the next one will be, otherwise to the newest one
    limit: float  # V
    period: float  # s  ΔT


class State(NamedTuple):
    """A straight line from one sample to another, and the command that it comes from."""

    origin: float  # V
    begin: float  # s
    goal: float  # V, held from `end` on
    end: float  # s
    command: float  # V  the newest
    due: float  # s  when it was due
    slope: float  # V/s  from the one before it
    rate: float  # V/s  of the motion at `begin`, without the corners of the lines
    final_rate: float  # V/s  at `end`


def design(values: Values) -> Params | None:
    """Course with the parameters of the controller, None for commands that hold until the next one."""
    kind = word(values, "command.interpolation")
    if kind not in ("linear", "extrapolate"):
        return None
    return Params(kind == "extrapolate", number(values, "command_limit"), number(values, "sample_period"))


def taken(p: Params, s: State | None, command: float, interval: float, arrival: float) -> State:
    """A ``command`` [V] has come for the sample at ``arrival`` [s], ``interval`` [s] after the one before.

    The line to it, or to where the next one will be, takes until the next one is due and one sample more,
    so that one which comes a little late finds the line not at its end.
    """
    if s is None or not 0.0 < interval <= LONGEST:
        return State(command, arrival, command, arrival, command, arrival, 0.0, 0.0, 0.0)
    due = joined(s.due, interval, arrival)
    end = max(due + interval, arrival) + p.period
    slope = (command - s.command) / interval
    goal = command
    if p.extrapolate:
        # The smaller of two slopes: a step is not gone beyond.
        smaller = s.slope if abs(s.slope) < abs(slope) else slope
        sure = 0.0 if slope * s.slope <= 0.0 else smaller
        goal = saturate(command + sure * (end - due), p.limit)
    begun, final = beside(rate(s, arrival), slope), beside(slope, s.slope)
    return State(value(s, arrival), arrival, goal, end, command, due, slope, begun, final)


def beside(rate: float, slope: float) -> float:
    """``rate`` [V/s] as far as a motion may have it next to this ``slope`` [V/s]; a step has none."""
    most = STEEPER * abs(slope)
    return clip(rate, -most, most)


def value(s: State, now: float) -> float:
    """Command [V] of the sample at ``now`` [s]."""
    if now >= s.end:
        return s.goal
    if now <= s.begin:
        return s.origin
    return s.origin + (s.goal - s.origin) * ((now - s.begin) / (s.end - s.begin))


def rate(s: State, now: float) -> float:
    """Rate [V/s] of the motion at ``now`` [s]: it goes evenly from one slope to the next.

    Beyond the end, where no further command has come, it fades as long again as the line took.
    """
    length = s.end - s.begin
    if length <= 0.0:
        return 0.0
    share = (now - s.begin) / length
    if share > 1.0:
        return s.final_rate * max(0.0, 2.0 - share)
    return s.rate + (s.final_rate - s.rate) * max(0.0, share)
