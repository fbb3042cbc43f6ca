# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Watches the LVDT: judges each reading, counts gaps, and tells when readings may be trusted again.

lvdt.py judges a single reading, rate.py whether the readings come at the sample period, and plausibility.py
whether they answer the voltage as a valve would. A few bad or missing readings are bridged. More of them
switch the voltage off, until enough sound ones have come and the spool is at rest. Readings that were smooth
but wrong are not believed again for a while, each time twice as long.
"""

from typing import Any, NamedTuple

from valve_control.control.laws import velocity
from valve_control.control.laws.registry import LAWS
from valve_control.control.supervision import lvdt, plausibility, rate
from valve_control.parameter import Values, number, numbers, word

TACHOMETER_CUTOFF = 50.0  # Hz, of the velocity with which a law takes over
REST = 10.0  # V/s; a spool that moves faster has not yet come to rest ...
REST_LIMIT = 0.5  # s  ... but a noisy reading must not keep the valve off for ever
DISTURBANCE = 5.0  # V  for standing readings, where readings shall not be compared with the voltage
PROBATION = 1.2  # times the largest disturbance: the voltage while readings are doubted
DOUBTS = ("lvdt_jump", "lvdt_disagrees")  # after which readings are not believed because they are smooth


class Params(NamedTuple):
    """What is expected of the LVDT."""

    judge: lvdt.Params
    pace: rate.Params
    comparison: plausibility.Params | None  # with the voltage, None: none
    tachometer: velocity.Params
    hold_samples: int  # that are bridged
    recovery_samples: int  # sound ones in a row before the law has the valve again
    hold_off: float  # s  for which readings that were found wrong are not believed, the first time
    hold_off_limit: float  # s
    period: float  # s  ΔT


class State(NamedTuple):
    """How far the LVDT is trusted."""

    bridged: int  # readings in a row that were lost or could not be believed
    sound: int  # readings in a row since the voltage was switched off
    blocked: str  # name of the condition that switched the voltage off
    doubt: plausibility.Doubt


class SpoolEstimate(NamedTuple):
    """What the believable readings say of the spool."""

    measurement: float  # V  the last one, NaN before the first
    velocity: velocity.State
    evidence: plausibility.State | None  # whether they answer the voltage


NOTHING = State(0, 0, "", plausibility.TRUST)


def model_of(values: Values, params: Any) -> tuple[float, float, float] | None:
    """The model (a1 [1/s], a0, b0 [1/s²]) that readings are judged by: the identified valve.

    That which a law begins with that adapts. The numbers of another are gains, which ``tune`` changes; it is
    watched with ``arc.theta_initial``, which ``identify`` and ``commission`` write whatever the law. None:
    there is no such model.
    """
    model = LAWS[word(values, "controller")].model if hasattr(params, "theta_initial") else None
    a1, a0, b0 = numbers(values, "arc.theta_initial")[:3] if model is None else model(params)
    return None if min(a1, a0, b0) <= 0.0 else (a1, a0, b0)


def comparison(values: Values, params: Any) -> plausibility.Params | None:
    """Watch that compares readings with the voltage; None: no watch."""
    model = model_of(values, params)
    if model is None or number(values, "lvdt.disturbance") == 0.0:
        return None
    return plausibility.design(
        model,
        number(values, "sample_period"),
        number(values, "lvdt.slow"),
        number(values, "lvdt.excitation"),
    )


def design(values: Values, params: Any) -> Params:
    """Params from the controller's values, and ``params`` of its law."""
    period = number(values, "sample_period")
    a1, a0, b0 = model_of(values, params) or (0.0, 0.0, 0.0)
    return Params(
        judge=lvdt.Params(
            limit=number(values, "lvdt.limit"),
            max_rate=number(values, "lvdt.max_rate"),
            tolerance=number(values, "lvdt.tolerance"),
            frozen_samples=int(number(values, "lvdt.frozen_samples")),
            frozen_voltage=number(values, "lvdt.frozen_voltage"),
            period=period,
            a1=a1,
            a0=a0,
            b0=b0,
            disturbance=min(number(values, "lvdt.disturbance") or DISTURBANCE, 0.5 * number(values, "u_max")),
        ),
        pace=rate.Params(period, number(values, "lvdt.period_limit")),
        comparison=comparison(values, params),
        tachometer=velocity.design(TACHOMETER_CUTOFF, period),
        hold_samples=int(number(values, "lvdt.hold_samples")),
        recovery_samples=int(number(values, "lvdt.recovery_samples")),
        hold_off=number(values, "lvdt.hold_off"),
        hold_off_limit=number(values, "lvdt.hold_off_limit"),
        period=period,
    )


def refused(s: State, lost: int) -> State:
    """State after a reading, ``lost`` ones after the last, that could not be believed."""
    return s._replace(bridged=s.bridged + 1 + lost, sound=0)


def switched_off(
    p: Params,
    s: State,
    evidence: plausibility.State | None,
    name: str,
    now: float,
    answered: bool,
    leapt: bool,
) -> State:
    """State with the voltage off since ``now`` [s] because of ``name``.

    ``answered``: readings answer the voltage; ``leapt``: they had leapt when this happened.
    """
    doubt = s.doubt
    if (leapt or name in DOUBTS) and p.comparison is not None and answered:
        doubt = plausibility.doubted(doubt, evidence, now, p.hold_off, p.hold_off_limit)
    return s._replace(sound=0, blocked=name, doubt=doubt)


def recovered(
    p: Params, s: State, m: SpoolEstimate, reading: float, anew: bool, now: float
) -> tuple[State, SpoolEstimate]:
    """State after one more sound reading while the voltage is off; not ``blocked`` once there are enough.

    ``anew``: the count begins with this one. At the end the motion is that of the reading before: the law
    takes in the present one in its first step.
    """
    sound = 0 if anew else s.sound
    if sound == 0:
        evidence = m.evidence
        if p.comparison is not None:
            usual = 0.0 if evidence is None else evidence.shown.usual
            evidence = plausibility.initial(p.comparison, reading, 0.0, usual)
        m = SpoolEstimate(reading, velocity.State(reading, 0.0), evidence)
    resting = abs(m.velocity.velocity) <= REST or sound * p.period >= REST_LIMIT
    s = s._replace(sound=sound + 1)
    if s.sound < p.recovery_samples or not resting or now < s.doubt.until:
        return s, SpoolEstimate(reading, velocity.step(p.tachometer, m.velocity, reading), m.evidence)
    if m.evidence is not None:
        m = m._replace(evidence=plausibility.anew(m.evidence))
    return s._replace(blocked=""), m


def weighed(
    p: plausibility.Params | None,
    s: plausibility.State | None,
    reading: float,
    applied: float,
    samples: int,
) -> plausibility.State | None:
    """Evidence with one more ``reading`` [V], before which ``applied`` [V] was on for ``samples`` periods."""
    if p is None:
        return s
    if s is None:
        s = plausibility.initial(p, reading, applied)
    return plausibility.step(p, s, reading, applied, float(samples))
