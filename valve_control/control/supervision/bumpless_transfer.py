# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Hands the valve from one law to another without a bump; a step that remains decays to zero.

Two steps remain: one in the voltage, between what was applied until now and what the new law would apply; and
one in the command, between the command under which the new law would go on as things are and the real one.
Both are made good by an offset that leaves its first value with slope 0, or with the spool's own speed. A
command that the spool has not followed until now moves, and an offset would carry its rate into the first
step: it comes in by a share that rises from 0 to 1 without a kink.
"""

import math
from typing import Any, NamedTuple

from valve_control.control.laws import reshaping
from valve_control.control.laws.projection import clip


class Params(NamedTuple):
    """Critically damped decay, discretised exactly."""

    time: float  # s  time constant τ
    period: float  # s  ΔT
    decay: float  # -  exp(-ΔT/τ)


class Offset(NamedTuple):
    """One offset [V] on its way to 0, and its rate."""

    value: float  # V
    rate: float  # V/s


class State(NamedTuple):
    """The offsets of the last takeover."""

    voltage: Offset
    command: Offset
    taking_over: bool  # whether the law has not made its first step yet, which tells the voltage's offset
    held: float = 0.0  # V  command under which the spool rests
    left: float = 0.0  # s  until the command has come in wholly


ZERO = Offset(0.0, 0.0)
NOTHING = State(ZERO, ZERO, False)
NEGLIGIBLE = 1e-9  # V; here the decay ends
JOINING = 5.0  # time constants within which a command comes in


def design(time: float, period: float) -> Params:
    """Decay with the time constant ``time`` [s], sampled every ``period`` [s]."""
    return Params(time, period, math.exp(-period / time))


def step(p: Params, s: State) -> State:
    """State one period later."""
    left = max(0.0, s.left - p.period)
    return State(decayed(p, s.voltage), decayed(p, s.command), s.taking_over, s.held, left)


def joined(p: Params, s: State, command: float) -> float:
    """Command [V] between that of rest and ``command`` [V], by a share without slope at both ends."""
    if s.left <= 0.0:
        return command
    x = s.left / (JOINING * p.time)
    share = x * x * x * (10.0 + x * (6.0 * x - 15.0))
    return command + share * (s.held - command)


def decayed(p: Params, o: Offset) -> Offset:
    """One period of τ²·ö + 2τ·ȯ + o = 0: it leaves its first value with slope 0 and never overshoots."""
    if abs(o.value) < NEGLIGIBLE and abs(o.rate) * p.time < NEGLIGIBLE:
        return ZERO
    slope = o.rate + o.value / p.time
    return Offset((o.value + slope * p.period) * p.decay, (o.rate - slope * p.period / p.time) * p.decay)


def resumed(params: Any, former: Any) -> Any:
    """Parameters with which a law starts from the estimates of the ``former`` state, of whichever law."""
    estimates = getattr(former, "theta", None)
    kind: Any = type(getattr(params, "theta_initial", None))
    if estimates is None or not isinstance(estimates, kind):
        return params
    if not hasattr(params, "theta_min") or not hasattr(params, "theta_max"):
        return params._replace(theta_initial=estimates)
    theta = kind(*map(clip, estimates, params.theta_min, params.theta_max))
    return params._replace(theta_initial=theta)


def followed(params: Any, s: Any) -> reshaping.State:
    """Reference that a law with ``params`` follows in state ``s``: that behind its filter, if it has one."""
    reference: reshaping.State = s.reference
    smoothing: float = getattr(getattr(params, "reshaping", None), "smoothing", 0.0)
    if smoothing == 0.0:
        return reference
    return reshaping.State(s.smooth, smoothing * (reference.reference - s.smooth))
