# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Draws the results of the experiments as PNG or SVG files."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from research.theorems import adaptive, learning, loop, robust, sampling
from research.theorems.tables import percent
from valve_control.control.analysis.figures import COLOURS, LAW_COLOURS, save

PERIOD_AXIS = "sample period ΔT [ms]"
STYLES = {"rest": ":", "one sine": "--", "three sines": "-"}


def _new(columns: int, width: float) -> tuple[Any, Any]:
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams["svg.hashsalt"] = "valve_control"
    matplotlib.rcParams["svg.fonttype"] = "none"
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, columns, figsize=(width, 4.2))
    return figure, axes


def _finish(figure: Any, paths: Sequence[Path], plots: Sequence[Any]) -> None:
    """Give all ``plots`` a grid and a legend above them, and write the figure."""
    import matplotlib.pyplot as plt

    for axis in plots:
        axis.grid(True, alpha=0.3)
        axis.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
    figure.tight_layout()
    for path in paths:
        save(figure, path)
    plt.close(figure)


def draw_theorems(
    paths: Sequence[Path], bound: robust.Experiment, error: adaptive.Experiment, sample_period: float = 1e-4
) -> None:
    """Runs above the bound, sampling error, z1 over time at ``sample_period`` [s], z1 that is left.

    Raises OSError if a path cannot be written.
    """
    figure, (above, scaling, decay, left) = _new(4, 18.0)
    for law in dict.fromkeys(c.law for c in bound.cells):
        line, colour = "o--" if law == "arc_filtered" else "o-", LAW_COLOURS[law.partition("_")[0]]
        cells = [c for c in bound.cells if c.law == law]
        periods = [c.period * 1e3 for c in cells]
        share = [percent(c.breaches, c.checked) for c in cells]
        above.plot(periods, share, line, color=colour, label=robust.LAWS[law].text)
        s = bound.scaling(law)
        label = f"{robust.LAWS[law].text}: ΔT^{s.order:.2f}"
        scaling.loglog(s.periods * 1e3, s.shift, line, color=colour, label=label)
    above.set(xscale="log", ylabel="checked runs with V2 above its bound [%]", xlabel=PERIOD_AXIS)
    above.set_yscale("symlog", linthresh=0.1)
    above.set_ylim(-0.01, 110.0)
    scaling.set(ylabel="sampling error of one period, over ε", xlabel=PERIOD_AXIS)
    pairs = list(dict.fromkeys((c.law, c.motion) for c in error.cells))
    for law, motion in pairs:
        style = {"color": LAW_COLOURS[law], "ls": STYLES[motion]}
        label = f"{law.upper()}, {motion}"
        cell = error.cell(law, motion, sample_period)
        time = (np.arange(cell.z1.shape[1]) + 1.0) * error.window
        decay.semilogy(time, np.median(cell.z1, axis=0), **style, label=label)
        if motion != "rest":
            o = error.order(law, motion)
            label = f"{label}: ΔT^{o.order:.2f}"
            left.loglog(o.periods * 1e3, o.residual, marker="o", **style, label=label)
    decay.set(ylabel="largest |z1| in 0.5 s [V]", xlabel=f"time [s] at ΔT = {sample_period * 1e3:g} ms")
    left.set(ylabel="|z1| that is left [V]", xlabel=PERIOD_AXIS)
    _finish(figure, paths, (above, scaling, decay, left))


def draw_sample_period(paths: Sequence[Path], limits: sampling.WeightResults) -> None:
    """Control activity c_u and error e_rms over ΔT, a line for each ρ.

    Raises OSError if a path cannot be written.
    """
    figure, (effort, error) = _new(2, 11.0)
    for colour, line in zip(COLOURS, limits.lines, strict=False):
        label = f"ρ = {line.weight:g}" + (" (print)" if line.weight == 1.0 else "")
        effort.loglog(line.periods * 1e3, line.c_u, "o-", ms=3, color=colour, label=label)
        error.loglog(line.periods * 1e3, line.e_rms, "o-", ms=3, color=colour, label=label)
        if line.critical < line.periods[-1]:
            for axis in (effort, error):
                axis.axvline(line.critical * 1e3, color=colour, ls="--", lw=0.8)
    effort.set(ylabel="control variation c_u", xlabel=PERIOD_AXIS)
    error.set(ylabel="e_rms [V]", xlabel=PERIOD_AXIS)
    figure.suptitle(
        "OARC, gains of the paper, on model (3); dashed: sampled loop unstable from here", fontsize=10
    )
    _finish(figure, paths, (effort, error))


def draw_dcarc(paths: Sequence[Path], study: loop.Study, learned: learning.Experiment) -> None:
    """Unstable valves over the size of their box, poles over small-gain bound, error over speed of learning.

    Raises OSError if a path cannot be written.
    """
    figure, (broken, bound, speed) = _new(3, 15.0)
    for i, name in enumerate(dict.fromkeys(c.gains for c in study.cells)):
        cells = [c for c in study.cells if (c.gains, c.box) == (name, "wide")]
        for theta, line in (("learned", "o-"), ("worst", "o:")):
            share = [percent(c.unstable(theta), study.valves) for c in cells]
            text = f"{name}, θ1 {'learned' if theta == 'learned' else 'any'}"
            broken.plot([c.scale for c in cells], share, line, color=COLOURS[i], label=text)
        cell = cells[len(cells) // 2]
        text = f"{name}, {cell.scale:g} times"
        bound.plot(cell.bound, cell.learned, ".", ms=3, color=COLOURS[i], label=text)
    broken.set(xlabel="size of the wide box of valves", ylabel="unstable valves [%]")
    bound.axhline(1.0, color="k", lw=0.8)
    bound.axvline(1.0, color="k", lw=0.8)
    bound.set(xscale="log", xlabel="small-gain bound, below 1: proven", ylabel="largest modulus of the poles")
    for i, kind in enumerate(dict.fromkeys(c.kind for c in learned.cells)):
        chosen = [c for c in learned.cells if c.kind == kind]
        noises = [c.noise for c in chosen]
        for what, line in ((np.median, "o-"), (np.max, "o:")):
            text = f"{kind}, {'median' if what is np.median else 'worst'}"
            speed.loglog(noises, [what(c.ratio) for c in chosen], line, color=COLOURS[i], label=text)
    speed.axhline(1.0, color="k", lw=0.8)
    speed.set(xlabel="fit_noise over the shipped one (left: fast)", ylabel="error over that without learning")
    _finish(figure, paths, (broken, bound, speed))
