"""The studies as lines of text and as plain data for JSON."""

import math
from typing import Any

import numpy as np

from valve_control.theorems import adaptive, robust, sampling
from valve_control.theorems.bench import Array

QUANTILES = (0.5, 0.9, 0.99)
FAST = 20.0  # Γ over the paper's, from which on a third of the cases is


def smallest(values: Array) -> float | None:
    """Smallest entry, or None."""
    return float(values.min()) if len(values) else None


def percent(part: int, whole: int) -> float:
    """Share of ``part`` in ``whole`` [%]; NaN of nothing."""
    return 100.0 * part / whole if whole else math.nan


def robust_data(study: robust.Study) -> dict[str, Any]:
    """Theorems 1 A and 2 A for JSON."""
    cells = []
    for c in study.cells:
        above = c.ratio > 1.0
        cells.append(
            {
                "law": c.law,
                "period": c.period,
                "saturated_at_start": c.saturated_at_start,
                "checked": c.checked,
                "checked_later": c.checked_later,
                "above_bound": c.breaches,
                "above_bound_later": c.later_breaches,
                "above_bound_then_saturated": int(np.sum(c.saturated[above] > 0.0)),
                "above_bound_by_disturbance": {
                    kind: int((above & (c.kinds == i)).sum()) for i, kind in enumerate(robust.KINDS)
                },
                "saturated_later": c.saturated_later,
                "ratio": {f"{q:g}": c.quantile(q) for q in QUANTILES} | {"worst": c.worst},
                "later_worst": robust.largest(c.settled),
                "excess_worst": robust.largest(c.excess),
                "loop_gain": {
                    "median": float(np.median(c.loop_gain[np.isfinite(c.ratio)])) if c.checked else None,
                    "largest": robust.largest(c.loop_gain),
                    "smallest_above_bound_later": smallest(c.loop_gain[c.settled > 1.0]),
                },
                "adaptation": {
                    "smallest_above_bound": smallest(c.adaptation[above]),
                    "fast_above_bound": int(np.sum(c.adaptation[above] > FAST)),
                    "fast_saturated_later": int(
                        np.sum(c.adaptation[(c.saturated > 0.0) & np.isfinite(c.ratio)] > FAST)
                    ),
                },
            }
        )
    laws = dict.fromkeys(c.law for c in study.cells)
    return {
        "seed": study.seed,
        "valves": study.valves,
        "duration": study.duration,
        "cells": cells,
        "order_of_sampling_error": {law: study.scaling(law).order for law in laws},
    }


def robust_lines(study: robust.Study) -> list[str]:
    """Theorems 1 A and 2 A as a table."""
    lines = [
        f"Theorems 1 A, 2 A: V2 against its bound (25), (52); {study.valves} random valves, "
        f"{study.duration:g} s each; later: after {robust.SETTLED * 1e3:g} ms",
        "at start: saturated at the first sample, nothing to check; other columns: of the runs checked",
        f"{'':27}{'ΔT':>6}{'at start':>9}{'above':>7}{'later':>7}{'satu-':>9}{'V2/bound':>10}{'':>18}"
        f"{'later':>9}{'gain·ΔT':>9}",
        f"{'':27}{'[µs]':>6}{'%':>9}{'%':>7}{'%':>7}{'rated %':>9}{'median':>10}{'99 %':>9}{'worst':>9}"
        f"{'worst':>9}{'largest':>9}",
    ]
    for c in study.cells:
        lines.append(
            f"{robust.LAWS[c.law].text:27}{c.period * 1e6:6.0f}"
            f"{percent(c.saturated_at_start, study.valves):9.2f}{percent(c.breaches, c.checked):7.2f}"
            f"{percent(c.later_breaches, c.checked_later):7.2f}{percent(c.saturated_later, c.checked):9.2f}"
            f"{c.quantile(0.5):10.3f}{c.quantile(0.99):9.3f}{c.worst:9.3f}"
            f"{robust.largest(c.settled):9.3f}{robust.largest(c.loop_gain):9.2f}".replace("nan", "  -")
        )
    for c in study.cells:
        above = c.ratio > 1.0
        if above.any():
            gain = smallest(c.loop_gain[c.settled > 1.0])
            lines.append(
                f"{robust.LAWS[c.law].text} at {c.period * 1e6:.0f} µs: of {c.breaches} above the bound "
                f"{int(np.sum(c.saturated[above] > 0.0))} end in saturation, "
                f"{int(np.sum(c.adaptation[above] > FAST))} with Γ over {FAST:g} times the paper's"
                + (f"; later ones from gain·ΔT = {gain:.2f} on" if gain is not None else "")
            )
    for law in dict.fromkeys(c.law for c in study.cells):
        order = study.scaling(law).order
        if np.isfinite(order):
            lines.append(f"sampling error of one period goes as ΔT^{order:.2f}: {robust.LAWS[law].text}")
    return lines


def adaptive_data(study: adaptive.Study) -> dict[str, Any]:
    """Theorems 1 B and 2 B for JSON."""
    cells = [
        {
            "law": c.law,
            "motion": c.motion,
            "period": c.period,
            "z1_first": c.first,
            "z1_left": c.residual,
            "rate": c.rate,
            "estimate_error": c.estimate_error,
            "saturated": float(c.saturated.mean()),
        }
        for c in study.cells
    ]
    pairs = dict.fromkeys((c.law, c.motion) for c in study.cells)
    return {
        "seed": study.seed,
        "valves": study.valves,
        "duration": study.duration,
        "window": study.window,
        "cells": cells,
        "order": [{"law": law, "motion": m, "order": study.order(law, m).order} for law, m in pairs],
    }


def adaptive_lines(study: adaptive.Study) -> list[str]:
    """Theorems 1 B and 2 B as a table."""
    lines = [
        f"Theorems 1 B, 2 B: parametric uncertainty only; medians over {study.valves} random valves, "
        f"{study.duration:g} s each",
        f"{'law':6}{'motion':13}{'ΔT [µs]':>8}{'|z1| first [V]':>16}{'left [V]':>11}{'rate [1/s]':>12}"
        f"{'‖θ̃‖ left':>11}",
    ]
    for c in study.cells:
        lines.append(
            f"{c.law:6}{c.motion:13}{c.period * 1e6:8.0f}{c.first:16.2e}{c.residual:11.2e}{c.rate:12.2f}"
            f"{c.estimate_error:10.4f}"
        )
    for law, motion in dict.fromkeys((c.law, c.motion) for c in study.cells):
        if motion != "rest":
            order = study.order(law, motion).order
            lines.append(f"what is left of z1 goes as ΔT^{order:.2f}: {law}, {motion}")
    return [line.replace("nan", "  -") for line in lines]


def sampling_data(limits: sampling.Limits) -> dict[str, Any]:
    """Sample period over ρ for JSON."""
    return {
        "valve": limits.valve,
        "duration": limits.duration,
        "lines": [
            {
                "z2_weight": line.weight,
                "period": line.periods.tolist(),
                "c_u": line.c_u.tolist(),
                "e_rms": line.e_rms.tolist(),
                "saturated": line.saturated.tolist(),
                "critical_period": line.critical,
                "critical_period_b0_2_db": line.critical_margin,
                "longest_calm_period": limits.limit(line.weight),
            }
            for line in limits.lines
        ],
    }


def sampling_lines(limits: sampling.Limits) -> list[str]:
    """Sample period over ρ as a table."""
    lines = [
        f"OARC on model {limits.valve}: sample period over the weight ρ of z2",
        f"{'ρ':>10}{'calm up to [ms]':>17}{'unstable from [ms]':>20}{'with b0 2 dB up':>17}"
        f"{'e_rms at 0.1 ms':>17}{'at 1 ms [V]':>13}",
    ]
    for line in limits.lines:
        short, long = (float(line.e_rms[abs(line.periods - t).argmin()]) for t in (1e-4, 1e-3))
        lines.append(
            f"{line.weight:10g}{limits.limit(line.weight) * 1e3:17.2f}{line.critical * 1e3:20.3f}"
            f"{line.critical_margin * 1e3:17.3f}{short:17.4f}{long:13.4f}"
        )
    return [line.replace("nan", "  -") for line in lines]
