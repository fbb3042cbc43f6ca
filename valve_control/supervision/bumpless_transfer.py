"""Hands the valve from one law to another without a bump; a step that remains decays to zero.

Two steps remain: one in the voltage, between what was applied until now and what the new law would apply; and
one in the command, between the command under which the new law would go on as things are and the real one.
Both are made good by an offset that leaves its first value with slope 0, or with the spool's own speed.
"""

import math
from typing import Any, NamedTuple

from valve_control.laws.law import Law
from valve_control.laws.projection import clip
from valve_control.laws.signals import Start


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


ZERO = Offset(0.0, 0.0)
NOTHING = State(ZERO, ZERO, False)
NEGLIGIBLE = 1e-9  # V; here the decay ends


def design(time: float, period: float) -> Params:
    """Decay with the time constant ``time`` [s], sampled every ``period`` [s]."""
    return Params(time, period, math.exp(-period / time))


def step(p: Params, s: State) -> State:
    """State one period later."""
    if s.voltage is ZERO and s.command is ZERO:
        return s
    return State(decayed(p, s.voltage), decayed(p, s.command), s.taking_over)


def decayed(p: Params, o: Offset) -> Offset:
    """One period of τ²·ö + 2τ·ȯ + o = 0: it leaves its first value with slope 0 and never overshoots."""
    if abs(o.value) < NEGLIGIBLE and abs(o.rate) * p.time < NEGLIGIBLE:
        return ZERO
    slope = o.rate + o.value / p.time
    return Offset((o.value + slope * p.period) * p.decay, (o.rate - slope * p.period / p.time) * p.decay)


def begun(s: State, offset: float) -> State:
    """State after the law's first step, which differs by ``offset`` [V] from the voltage until now."""
    return State(Offset(offset, 0.0), s.command, False)


def taken_over(
    law: Law,
    params: Any,
    former: Any,
    s: State,
    start: Start,
    base: float,
    same_reference: bool,
    following: bool,
) -> tuple[Any, State]:
    """State in which ``law`` begins at ``start``, and the offset on the command ``base`` [V] that this needs.

    ``former``: state of the law before, whose estimates and, with ``same_reference``, whose reference go on;
    ``following``: the spool has been following the command until now.
    """
    offset = s.command
    if same_reference:
        reference, rate = former.reference
        start = start._replace(reference=reference, reference_rate=rate)
    else:
        # A spool that follows has the rate of the command; one from elsewhere has to lose its own.
        rate = 0.0 if following else start.velocity
        offset = Offset(law.steady_command(params, start) - base, rate)
    estimates = getattr(former, "theta", None)
    kind: Any = type(getattr(params, "theta_initial", None))
    if estimates is not None and isinstance(estimates, kind):
        theta = kind(*map(clip, estimates, params.theta_min, params.theta_max))
        params = params._replace(theta_initial=theta)
    return law.module.initial(params, start), State(s.voltage, offset, True)
