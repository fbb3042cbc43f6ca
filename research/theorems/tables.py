# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Formats the results of the experiments as lines of text and as plain data for JSON."""

import math
from typing import Any

import numpy as np

from research.theorems import adaptive, bench, learning, loop, robust, sampling
from research.theorems.bench import Array

QUANTILES = (0.5, 0.9, 0.99)
FAST = 20.0  # Γ over the paper's, from which on a third of the cases is


def smallest(values: Array) -> float | None:
    """Smallest entry, or None."""
    return float(values.min()) if len(values) else None


def percent(part: int, whole: int) -> float:
    """Share of ``part`` in ``whole`` [%]; NaN of nothing."""
    return 100.0 * part / whole if whole else math.nan


def robust_data(experiment: robust.Experiment) -> dict[str, Any]:
    """Theorems 1 A and 2 A for JSON."""
    cells = []
    for c in experiment.cells:
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
    laws = dict.fromkeys(c.law for c in experiment.cells)
    return {
        "seed": experiment.seed,
        "valves": experiment.valves,
        "duration": experiment.duration,
        "cells": cells,
        "order_of_sampling_error": {law: experiment.scaling(law).order for law in laws},
    }


def robust_lines(experiment: robust.Experiment) -> list[str]:
    """Theorems 1 A and 2 A as a table."""
    lines = [
        f"Theorems 1 A, 2 A: V2 against its bound (25), (52); {experiment.valves} random valves, "
        f"{experiment.duration:g} s each; later: after {robust.SETTLED * 1e3:g} ms",
        "at start: saturated at the first sample, nothing to check; other columns: of the runs checked",
        f"{'':27}{'ΔT':>6}{'at start':>9}{'above':>7}{'later':>7}{'satu-':>9}{'V2/bound':>10}{'':>18}"
        f"{'later':>9}{'gain·ΔT':>9}",
        f"{'':27}{'[µs]':>6}{'%':>9}{'%':>7}{'%':>7}{'rated %':>9}{'median':>10}{'99 %':>9}{'worst':>9}"
        f"{'worst':>9}{'largest':>9}",
    ]
    for c in experiment.cells:
        lines.append(
            f"{robust.LAWS[c.law].text:27}{c.period * 1e6:6.0f}"
            f"{percent(c.saturated_at_start, experiment.valves):9.2f}{percent(c.breaches, c.checked):7.2f}"
            f"{percent(c.later_breaches, c.checked_later):7.2f}{percent(c.saturated_later, c.checked):9.2f}"
            f"{c.quantile(0.5):10.3f}{c.quantile(0.99):9.3f}{c.worst:9.3f}"
            f"{robust.largest(c.settled):9.3f}{robust.largest(c.loop_gain):9.2f}".replace("nan", "  -")
        )
    for c in experiment.cells:
        above = c.ratio > 1.0
        if above.any():
            gain = smallest(c.loop_gain[c.settled > 1.0])
            lines.append(
                f"{robust.LAWS[c.law].text} at {c.period * 1e6:.0f} µs: of {c.breaches} above the bound "
                f"{int(np.sum(c.saturated[above] > 0.0))} end in saturation, "
                f"{int(np.sum(c.adaptation[above] > FAST))} with Γ over {FAST:g} times the paper's"
                + (f"; later ones from gain·ΔT = {gain:.2f} on" if gain is not None else "")
            )
    for law in dict.fromkeys(c.law for c in experiment.cells):
        order = experiment.scaling(law).order
        if np.isfinite(order):
            lines.append(f"sampling error of one period goes as ΔT^{order:.2f}: {robust.LAWS[law].text}")
    return lines


def adaptive_data(experiment: adaptive.Experiment) -> dict[str, Any]:
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
        for c in experiment.cells
    ]
    pairs = dict.fromkeys((c.law, c.motion) for c in experiment.cells)
    return {
        "seed": experiment.seed,
        "valves": experiment.valves,
        "duration": experiment.duration,
        "window": experiment.window,
        "cells": cells,
        "order": [{"law": law, "motion": m, "order": experiment.order(law, m).order} for law, m in pairs],
    }


def adaptive_lines(experiment: adaptive.Experiment) -> list[str]:
    """Theorems 1 B and 2 B as a table."""
    lines = [
        f"Theorems 1 B, 2 B: parametric uncertainty only; medians over {experiment.valves} random valves, "
        f"{experiment.duration:g} s each",
        f"{'law':6}{'motion':13}{'ΔT [µs]':>8}{'|z1| first [V]':>16}{'left [V]':>11}{'rate [1/s]':>12}"
        f"{'‖θ̃‖ left':>11}",
    ]
    for c in experiment.cells:
        lines.append(
            f"{c.law:6}{c.motion:13}{c.period * 1e6:8.0f}{c.first:16.2e}{c.residual:11.2e}{c.rate:12.2f}"
            f"{c.estimate_error:10.4f}"
        )
    for law, motion in dict.fromkeys((c.law, c.motion) for c in experiment.cells):
        if motion != "rest":
            order = experiment.order(law, motion).order
            lines.append(f"what is left of z1 goes as ΔT^{order:.2f}: {law}, {motion}")
    return [line.replace("nan", "  -") for line in lines]


def sampling_data(limits: sampling.WeightResults) -> dict[str, Any]:
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


def sampling_lines(limits: sampling.WeightResults) -> list[str]:
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


def loop_data(study: loop.Study) -> dict[str, Any]:
    """Stability of dcarc's loop for JSON."""
    cells = [
        {
            "gains": c.gains,
            "box": c.box,
            "scale": c.scale,
            "unstable": {name: c.unstable(name) for name in loop.THETAS},
            "largest_pole": {name: float(np.max(getattr(c, name))) for name in loop.THETAS},
            "proven_by_small_gain": int(np.sum(c.bound < 1.0)),
            "stable_but_for": c.rescued,
            "learns_up_to_hz": {
                "median": bench.quantile(c.teaching, 0.5),
                "least": smallest(c.teaching[np.isfinite(c.teaching)]),
            },
        }
        for c in study.cells
    ]
    return {"seed": study.seed, "valves": study.valves, "cells": cells}


def loop_lines(study: loop.Study) -> list[str]:
    """Stability of dcarc's loop as a table."""
    lines = [
        f"dcarc: poles of the sampled loop at 1 ms, weights at rest; {study.valves} random valves a row; "
        "box drawn so many times as large",
        "θ1: as at the start, as it makes good the valve's gain, any within its bounds; proven: small gain",
        f"{'gains':14}{'box':8}{'times':>6}{'unstable [%] with θ1':>31}{'proven':>9}{'learns up to [Hz]':>19}"
        "  unstable ones that would be stable but for",
        f"{'':28}{'start':>11}{'learned':>10}{'any':>10}{'%':>9}{'median':>11}{'least':>8}",
    ]
    for c in study.cells:
        shares = "".join(f"{percent(c.unstable(name), study.valves):10.1f}" for name in loop.THETAS)
        causes = sorted(((n, cause) for cause, n in c.rescued.items() if n), reverse=True)
        why = ", ".join(f"{cause} {n}" for n, cause in causes)
        proven = percent(int(np.sum(c.bound < 1.0)), study.valves)
        lines.append(
            f"{c.gains:14}{c.box:8}{c.scale:6.1f} {shares}{proven:9.1f}"
            f"{bench.quantile(c.teaching, 0.5):11.1f}{bench.quantile(c.teaching, 0.0):8.1f}  {why}".rstrip()
        )
    return lines


def learning_data(experiment: learning.Experiment) -> dict[str, Any]:
    """Speed of dcarc's learning for JSON."""
    cells = [
        {
            "kind": c.kind,
            "fit_noise": c.noise,
            "error_first": float(np.median(c.first)),
            "error_last": float(np.median(c.last)),
            "error_without": float(np.median(c.resting)),
            "ratio": {"median": float(np.median(c.ratio)), "largest": float(np.max(c.ratio))},
            "worse": c.worse,
            "lost": c.lost,
            "compensation_over_bound": float(np.max(c.compensation)),
        }
        for c in experiment.cells
    ]
    return {
        "seed": experiment.seed,
        "valves": experiment.valves,
        "duration": experiment.duration,
        "cells": cells,
    }


def learning_lines(experiment: learning.Experiment) -> list[str]:
    """Speed of dcarc's learning as a table."""
    lines = [
        f"dcarc: learning on {experiment.valves} random valves of the wide box, {experiment.duration:g} s "
        "each; fit_noise: over the shipped one, less is faster",
        f"{'valves':10}{'fit_noise':>10}{'error 2nd 0.5 s':>17}{'last [mV]':>11}{'without':>9}{'worst':>8}"
        f"{'harm':>6}{'lost':>6}{'|u_c|':>8}",
        f"{'':10}{'times':>10}{'median [mV]':>17}{'median':>11}{'median':>9}{'ratio':>8}{'%':>6}{'%':>6}"
        f"{'/bound':>8}",
    ]
    for c in experiment.cells:
        worse, lost = (percent(count, experiment.valves) for count in (c.worse, c.lost))
        lines.append(
            f"{c.kind:10}{c.noise:10g}{1e3 * np.median(c.first):17.1f}{1e3 * np.median(c.last):11.1f}"
            f"{1e3 * np.median(c.resting):9.1f}{np.max(c.ratio):8.2f}"
            f"{worse:6.1f}{lost:6.1f}{np.max(c.compensation):8.3f}"
        )
    return lines
