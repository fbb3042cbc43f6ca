"""Watches the law: reports long saturation, limit cycles of the voltage, and broken assumptions."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

from valve_control.parameter import Values, number
from valve_control.supervision import conditions, oscillation

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
    cycling: oscillation.Params
    period: float  # s  ΔT


def design(values: Values) -> Params:
    """Params from the controller's values."""
    period = number(values, "sample_period")
    return Params(
        number(values, "u_max"),
        number(values, "saturation_limit"),
        oscillation.Params(number(values, "oscillation_limit"), period),
        period,
    )


def step(
    p: Params,
    saturated_for: float,
    cycle: oscillation.State,
    said: conditions.State,
    now: float,
    voltage: float,
    command: float,
) -> tuple[float, oscillation.State, conditions.State]:
    """Take in ``voltage`` and ``command`` [V] of the sample at ``now`` [s].

    ``saturated_for`` [s] and ``cycle`` are remembered between two samples; ``said`` is what is reported.
    """
    if abs(voltage) >= p.u_max:
        saturated_for = min(saturated_for + p.period, 2.0 * p.saturation_limit)
        if saturated_for > p.saturation_limit:
            text = f"saturated for more than {p.saturation_limit:g} s"
            said = conditions.report(said, "saturation", text)
    elif saturated_for > 0.0:
        # Noise lifts single samples off the limit: time without saturation counts against time with it.
        saturated_for = max(0.0, saturated_for - p.period)
        if saturated_for == 0.0:
            said = conditions.clear(said, "saturation")
    if p.cycling.amplitude > 0.0:
        before = cycle.cycles
        cycle = oscillation.step(p.cycling, cycle, now, voltage, command)
        if cycle.cycles != before and oscillation.sustained(cycle):
            text = (
                f"voltage oscillates at {oscillation.frequency(cycle):.3g} Hz with "
                f"{oscillation.amplitude(cycle):.2g} V: limit cycle of law and valve"
            )
            lasting = max(conditions.LATCH, 2.0 * cycle.length)
            said = conditions.latch(said, "oscillation", text, now, lasting)
    return saturated_for, cycle, said


def watched(fields: Sequence[str]) -> tuple[int, str] | None:
    """Which of the terms ``fields`` must stay below the one after it, and what is said if not.

    None: there is nothing to watch.
    """
    for i, (name, after) in enumerate(itertools.pairwise(fields)):
        if name in ASSUMPTIONS and after == f"{name}_bound":
            return i, ASSUMPTIONS[name]
    return None
