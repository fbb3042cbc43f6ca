# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tells of a spool that rests away from the command, or against a large part of ``lvdt.disturbance``.

A law without feedback never gives a voltage that answer.py could judge, and one that hunts against friction
makes no even cycles. Time in which the spool so rests counts, other time counts back.
"""

from typing import NamedTuple

from valve_control.control.supervision import answer, plausibility
from valve_control.parameter import Values, number

AWAY = 0.3  # of the largest disturbance, from the command
AGAINST = 0.5  # of the largest disturbance
LASTING = 1.0  # s
BACK = 0.2  # s that one second of other time counts back


class Params(NamedTuple):
    """How far a resting spool may be away."""

    away: float  # V  from the command
    against: float  # V
    slow: float  # V/s
    span: float  # s  of a block
    asked: float  # -  voltage for each volt of the reading


class State(NamedTuple):
    """For how long the spool has rested so, and where it was then."""

    time: float  # s
    away: float  # V  from the command
    pull: float  # V
    sticks: float  # 1.0: reported


NOTHING = State(0.0, 0.0, 0.0, 0.0)


def design(values: Values, c: plausibility.Params) -> Params:
    """Watch with the controller's ``values`` beside the plausibility check ``c``."""
    largest = number(values, "lvdt.disturbance")
    return Params(AWAY * largest, AGAINST * largest, c.slow, c.span, c.a0 / c.b0)


def step(p: Params, s: State, block: plausibility.Block) -> State:
    """State after one more block."""
    away = block.command - block.position
    pull = answer.pull(block.filtered_voltage, p.asked * block.position)
    if abs(block.velocity) < p.slow and (abs(away) > p.away or abs(pull) > p.against):
        time = min(2.0 * LASTING, s.time + p.span)
        return State(time, away, pull, 1.0 if time > LASTING else s.sticks)
    time = max(0.0, s.time - BACK * p.span)
    return State(time, s.away, s.pull, s.sticks if time > 0.0 else 0.0)


def text(p: Params, s: State) -> str:
    """One sentence about it, "": the spool moves."""
    if s.sticks == 0.0:
        return ""
    where = f"{abs(s.away):.2g} V from the command and {abs(s.pull):.2g} V from the voltage"
    return f"the spool rests {where}: friction, supply, or dead LVDT"


def stopped(s: State) -> State:
    """State after the voltage was switched off."""
    return NOTHING
