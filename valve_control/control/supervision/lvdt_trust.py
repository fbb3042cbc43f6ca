# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes the limits by which control_step.py trusts the LVDT, from parameters, and holds how far it does.

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
LARGEST = 0.7  # of u_max: a disturbance above it leaves no voltage that could show a dead reading
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


def design(values: Values, params: Any) -> Params:
    """Params from the controller's values, and ``params`` of its law."""
    period = number(values, "sample_period")
    model = model_of(values, params)
    a1, a0, b0 = model or (0.0, 0.0, 0.0)
    comparison = None
    if model is not None and number(values, "lvdt.disturbance") != 0.0:
        comparison = plausibility.design(
            model, period, number(values, "lvdt.slow"), number(values, "lvdt.excitation")
        )
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
            disturbance=min(
                number(values, "lvdt.disturbance") or DISTURBANCE, LARGEST * number(values, "u_max")
            ),
        ),
        pace=rate.Params(period, number(values, "lvdt.period_limit")),
        comparison=comparison,
        tachometer=velocity.design(TACHOMETER_CUTOFF, period),
        hold_samples=int(number(values, "lvdt.hold_samples")),
        recovery_samples=int(number(values, "lvdt.recovery_samples")),
        hold_off=number(values, "lvdt.hold_off"),
        hold_off_limit=number(values, "lvdt.hold_off_limit"),
        period=period,
    )
