# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Watches the law: reports long saturation and broken assumptions."""

import itertools
from collections.abc import Sequence

from valve_control.control.supervision.memory import Memory, clear, report

ASSUMPTIONS = {
    "lyapunov": "V2 is above its guaranteed bound: the valve has left the assumed parameter ranges or "
    "disturbance bound",
    "burden": "observer and compensation make good more disturbance than the spread of the weights allows: "
    "the valve has left the assumed model, friction, flow force or offset",
}  # what is said when a term of the law is above the one of its name with _bound


def step(memory: Memory, voltage: float, u_max: float, period: float, longest: float) -> None:
    """Take in the ``voltage`` [V] of one sample, within ``u_max`` [V]; ``longest`` [s] may it saturate."""
    if abs(voltage) >= u_max:
        memory.saturated_for = min(memory.saturated_for + period, 2.0 * longest)
        if memory.saturated_for > longest:
            report(memory, "saturation", f"saturated for more than {longest:g} s")
        memory.counts["saturated"] += 1
    elif memory.saturated_for > 0.0:
        # Noise lifts single samples off the limit: time without saturation counts against time with it.
        memory.saturated_for = max(0.0, memory.saturated_for - period)
        if memory.saturated_for == 0.0:
            clear(memory, "saturation")


def bounded_term(fields: Sequence[str]) -> tuple[int, str] | None:
    """Which of the terms ``fields`` must stay below the one after it, and what is said if not.

    None: there is nothing to watch.
    """
    for i, (name, after) in enumerate(itertools.pairwise(fields)):
        if name in ASSUMPTIONS and after == f"{name}_bound":
            return i, ASSUMPTIONS[name]
    return None
