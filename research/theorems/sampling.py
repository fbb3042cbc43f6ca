# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Finds how short the sample period of OARC must be, for several weights ρ of z2 (ρ = 1 is the print)."""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.optimize

from research.theorems import bench
from research.theorems.bench import Array, Progress
from valve_control.control.laws import oarc
from valve_control.control.linear import stability
from valve_control.control.parameters import build
from valve_control.control.parameters.table import NODES
from valve_control.control.simulation import offline
from valve_control.parameter import Values, defaults, number, updated

PERIODS = tuple(float(f"{v:.3g}") for v in np.geomspace(5e-5, 2e-3, 17))  # s
WEIGHTS = (1.0, 10.0, 100.0, 1e4, 1.44e6)  # 1/s²
LONGEST = 5e-3  # s; the reshaping's Euler step (11) is unstable a little above
CHATTER = 1.5  # c_u over that of the weight that chatters least, at the same ΔT


class Line(NamedTuple):
    """Results of OARC with one weight over the sample period; arrays have an entry per ΔT."""

    weight: float  # 1/s²  ρ
    periods: Array  # s
    c_u: Array  # -   (I5)
    e_rms: Array  # V   (I1)
    saturated: Array  # share of samples at ±u_max
    critical: float  # s   ΔT at which the sampled loop on the design model becomes unstable; NaN if none
    critical_margin: float  # s   the same with b0 2 dB above


class WeightResults(NamedTuple):
    """Results of all weights on one valve and one command."""

    valve: str
    duration: float  # s
    lines: tuple[Line, ...]

    def limit(self, weight: float) -> float:
        """Longest ΔT [s] up to which ``weight`` does not chatter; NaN if it always does.

        Chatter: c_u beyond CHATTER times that of the calmest weight at the same ΔT.
        """
        calmest = np.min([line.c_u for line in self.lines], axis=0)
        line = next(line for line in self.lines if line.weight == weight)
        calm = np.logical_and.accumulate(line.c_u < CHATTER * calmest)
        return float(line.periods[calm][-1]) if calm[0] else math.nan


class Task(NamedTuple):
    """Work for one process: one run."""

    weight: float  # 1/s²
    period: float  # s
    valve: str
    duration: float  # s


def _controller(weight: float, period: float) -> Values:
    changes = {"controller": "oarc", "sample_period": period, "oarc.z2_weight": weight}
    return updated(NODES["controller"], defaults(NODES["controller"]), changes)


def critical_period(weight: float, gain: float = 1.0) -> float:
    """Shortest ΔT [s] at which a pole of the sampled loop leaves the unit circle; NaN if none below LONGEST.

    The loop is OARC's with the paper's gains and θ̂(0), frozen, on that very model with b0 times ``gain``.
    """

    def excess(period: float) -> float:
        p = oarc.build(_controller(weight, period))
        own = stability.believed(oarc.LAW, p)
        return abs(stability.pole_of(oarc.LAW, p, own._replace(b=gain * own.b))) - 1.0

    grid = np.geomspace(PERIODS[0], LONGEST, 25)
    for before, after in itertools.pairwise(grid.tolist()):
        if excess(after) > 0.0:
            return float(scipy.optimize.brentq(excess, before, after, xtol=1e-7))
    return math.nan


def run_one(task: Task) -> tuple[float, float, float]:
    """c_u, e_rms [V] and share of saturated samples of one run."""
    setting = {"sample_period": task.period}
    valve = updated(
        NODES["valve_simulator"], defaults(NODES["valve_simulator"]), {"valve": task.valve, **setting}
    )
    source = updated(
        NODES["command_source"], defaults(NODES["command_source"]), {"duration": task.duration, **setting}
    )
    controller = _controller(task.weight, task.period)
    run = offline.simulate(controller, valve, build.commands(source))
    saturated = float(np.mean(np.abs(run.voltage) >= number(controller, "u_max")))
    return run.indices.c_u, run.indices.e_rms, saturated


def sample_period_limit(
    weights: Sequence[float] = WEIGHTS,
    periods: Sequence[float] = PERIODS,
    valve: str = "fourth_order",
    duration: float = 6.0,
    processes: int = 1,
    progress: Progress | None = None,
) -> WeightResults:
    """Simulate OARC with the paper's gains on the trajectory of Fig. 5, each weight ρ at each ΔT [s].

    ``progress(done, all)`` counts runs.
    """
    tasks = [Task(weight, period, valve, duration) for weight in weights for period in periods]
    rows = np.array(bench.work(run_one, tasks, processes, progress)).reshape(len(weights), len(periods), 3)
    lines = [
        Line(
            weight,
            np.array(periods),
            c_u=row[:, 0],
            e_rms=row[:, 1],
            saturated=row[:, 2],
            critical=critical_period(weight),
            critical_margin=critical_period(weight, stability.GAIN_MARGIN),
        )
        for weight, row in zip(weights, rows, strict=True)
    ]
    return WeightResults(valve, duration, tuple(lines))
