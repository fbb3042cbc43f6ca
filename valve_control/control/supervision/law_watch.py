# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Watches the law: reports long saturation and broken assumptions."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

from valve_control.control.laws import linearisation
from valve_control.control.supervision.record import Memory, clear, report
from valve_control.parameter import Values, number

ASSUMPTIONS = {
    "lyapunov": "V2 is above its guaranteed bound: the valve has left the assumed parameter ranges or "
    "disturbance bound",
    "burden": "observer and compensation make good more disturbance than the spread of the weights allows: "
    "the valve has left the assumed model, friction, flow force or offset",
}  # what is said when a term of the law is above the one of its name with _bound


class Params(NamedTuple):
    """Limits beyond which something is reported."""

    u_max: float  # V
    saturation_limit: float  # s
    period: float  # s  ΔT


def design(values: Values) -> Params:
    """Params from the controller's values, for voltages of the law. Raises ParameterError."""
    return Params(
        number(linearisation.seen(values), "u_max"),
        number(values, "saturation_limit"),
        number(values, "sample_period"),
    )


def step(p: Params, m: Memory, voltage: float) -> None:
    """Take in the ``voltage`` [V] of one sample."""
    if abs(voltage) >= p.u_max:
        m.saturated_for = min(m.saturated_for + p.period, 2.0 * p.saturation_limit)
        if m.saturated_for > p.saturation_limit:
            report(m, "saturation", f"saturated for more than {p.saturation_limit:g} s")
        m.counts["saturated"] += 1
    elif m.saturated_for > 0.0:
        # Noise lifts single samples off the limit: time without saturation counts against time with it.
        m.saturated_for = max(0.0, m.saturated_for - p.period)
        if m.saturated_for == 0.0:
            clear(m, "saturation")


def watched(fields: Sequence[str]) -> tuple[int, str] | None:
    """Which of the terms ``fields`` must stay below the one after it, and what is said if not.

    None: there is nothing to watch.
    """
    for i, (name, after) in enumerate(itertools.pairwise(fields)):
        if name in ASSUMPTIONS and after == f"{name}_bound":
            return i, ASSUMPTIONS[name]
    return None
