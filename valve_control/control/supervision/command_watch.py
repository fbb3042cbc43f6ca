# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Watches the command: limits it, refuses NaN, and brings the spool to neutral when it falls silent."""

import math
from typing import NamedTuple

from valve_control.control.commands.scenarios import stroke
from valve_control.control.plant.saturation import saturate
from valve_control.control.supervision.bumpless_transfer import Offset
from valve_control.parameter import Values, number


class Params(NamedTuple):
    """What is expected of the upper level, and how the spool returns to neutral without it."""

    timeout: float  # s  0.0: a silent command is none that is missed
    limit: float  # V
    rate: float  # V/s  on the way back to neutral
    accel: float  # V/s²
    period: float  # s  ΔT


class Homing(NamedTuple):
    """The motion back to neutral."""

    origin: float  # V  where it began
    began: float  # s
    rate: float  # V/s
    accel: float  # V/s²


class State(NamedTuple):
    """The command in force, and whether the upper level is silent."""

    value: float | None  # V, None before the first one
    time: float  # s at which it acts
    renewed: bool  # whether one has come since the way back to neutral began
    gone_since: float | None  # s, when the upper level left
    homing: Homing | None  # once begun, only a new command ends it
    origin: float  # V  where the spool stays before the first command


SILENT = "command is silent, the spool returns to neutral"
NOTHING = State(None, 0.0, False, None, None, 0.0)


def design(values: Values) -> Params:
    """Params from the controller's values."""
    return Params(
        number(values, "command_timeout"),
        number(values, "command_limit"),
        number(values, "neutral_rate"),
        number(values, "neutral_accel"),
        number(values, "sample_period"),
    )


def moved(s: State, value: float) -> State:
    """State ``s`` with the command ``value`` [V] in force; quicker than ``_replace``."""
    return State(value, s.time, s.renewed, s.gone_since, s.homing, s.origin)


def taken(p: Params, s: State, value: float, now: float) -> State:
    """State after a command ``value`` [V] that came at ``now`` [s]; one that is not finite is refused."""
    if not math.isfinite(value):
        return s._replace(gone_since=None)
    return State(saturate(value, p.limit), now + p.period, True, None, s.homing, s.origin)


def held_here(p: Params, s: State, reading: float, now: float) -> State:
    """State when a law takes the valve at ``reading`` [V]: the spool stays there until a command comes."""
    if s.value is None:
        return s._replace(origin=reading)
    if s.homing is not None or silent_since(p, s, now) is not None:
        # The spool is not where the old command was.
        return _homeward(p, s, reading, now)
    return s


def step(p: Params, s: State, offset: Offset, now: float) -> tuple[float, State, Offset]:
    """Command [V] of the sample at ``now`` [s]: the upper level's, the way back to neutral, or the start.

    ``offset`` is added to the command. A new command ends the way back: its distance from there is then
    added to the offset.
    """
    value = s.value
    if value is None:
        return s.origin + offset.value, s, offset
    if s.homing is None and s.gone_since is None and now <= s.time + p.timeout:
        return value + offset.value, s, offset  # as nearly always
    since = silent_since(p, s, now)
    if s.homing is None and since is not None:
        s = _homeward(p, s, value, since)
    if s.homing is None:
        return value + offset.value, s, offset
    here = _home(s.homing, now)
    if since is not None or not s.renewed:
        return here + offset.value, s, offset
    rate = (here - _home(s.homing, now, p.period)) / p.period
    offset = Offset(offset.value + here - value, offset.rate + rate)
    return value + offset.value, s._replace(homing=None), offset


def silent_since(p: Params, s: State, now: float) -> float | None:
    """Since when [s] the command counts as silent, None if it does not."""
    if p.timeout == 0.0:
        return None
    if s.gone_since is not None:
        return s.gone_since
    end = s.time + p.timeout
    return end if now > end else None


def _homeward(p: Params, s: State, origin: float, since: float) -> State:
    return s._replace(homing=Homing(origin, since, p.rate, p.accel), renewed=False)


def _home(homing: Homing, now: float, ago: float = 0.0) -> float:
    """Command [V] on the way to neutral, ``ago`` [s] before ``now`` [s]."""
    time = now - homing.began - ago
    return homing.origin + stroke(time, -homing.origin, homing.rate, homing.accel)
