# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Searches for the valve of least cost: CMA-ES (pycma) with growing populations in plausible ranges.

The cost is rugged, since noise and friction decide about single extreme errors: on this problem CMA-ES came
to half the cost at which scipy's differential evolution and simplices stayed. A search is repeatable by its
seed whatever the number of processes.
"""

import contextlib
import math
import time
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import scipy.stats

from research import running
from research.calibration import objective
from research.calibration.objective import Table
from research.calibration.space import Dimension, Settings, changed, values_at
from valve_control.arrays import Floats
from valve_control.control.analysis.indices import Indices
from valve_control.design.tuning.search import strategy as evolution_strategy
from valve_control.parameter import ParameterError

Told = Callable[[int, float], None]  # evaluations so far, best cost
SCATTERED = 9  # log2 of the points of the beginning
MOST = 128  # valves of a generation
STEP = 0.25  # first standard deviation, as share of the ranges


class Problem(NamedTuple):
    """What is calibrated: settings, free quantities, measured table."""

    base: Settings  # what stays
    table: Table
    dimensions: Sequence[Dimension]
    seeds: Sequence[int]  # of the LVDT's noise


class CalibrationResult(NamedTuple):
    """Result of a search: the best point and its cost."""

    point: Floats  # in the unit cube
    cost: float
    evaluations: int
    seconds: float


def runs_at(problem: Problem, point: Floats) -> dict[str, list[Indices]] | None:
    """Indices of each controller with each seed at ``point`` of the unit cube, None if it cannot be run."""
    values = values_at(problem.dimensions, np.clip(point, 0.0, 1.0))
    try:
        settings = changed(problem.base, problem.dimensions, values)
        return objective.run(settings, list(problem.table), problem.seeds)
    except (ParameterError, ArithmeticError):
        return None


def cost_at(problem: Problem, point: Floats) -> float:
    """Cost at ``point``; outside of the unit cube it rises with the distance.

    Half of it is that of the mean over the seeds, half that of the first: extreme errors scatter by some per
    cent from seed to seed, and a fit to one seed alone would pick one by which they are small.
    """
    outside = float(np.sum((point - np.clip(point, 0.0, 1.0)) ** 2))
    runs = runs_at(problem, point)
    if runs is None:
        return objective.NOT_RUN.cost + outside
    mean = objective.fit(runs, problem.table).cost
    if len(problem.seeds) == 1:
        return mean + outside
    first = objective.fit({name: found[:1] for name, found in runs.items()}, problem.table).cost
    return 0.5 * (mean + first) + outside


def search(
    problem: Problem,
    seed: int,
    evaluations: int,
    population: int,
    processes: int,
    told: Told,
) -> CalibrationResult:
    """Find the best point with ``evaluations`` valves; after Ctrl-C, the best one so far.

    ``population``: of the first CMA-ES, doubled by each restart.
    """
    began = time.monotonic()
    n = len(problem.dimensions)
    evaluate = partial(cost_at, problem)
    evaluate(np.full(n, 0.5))  # compiles before the processes part
    count, cost, best = 0, np.inf, np.full(n, 0.5)
    with running.pool(processes) as pool, contextlib.suppress(KeyboardInterrupt):

        def judged(points: Sequence[Floats]) -> list[float]:
            nonlocal count, cost, best
            costs = list(pool.map(evaluate, points, chunksize=max(1, len(points) // (4 * processes))))
            count += len(points)
            i = int(np.argmin(costs))
            if costs[i] < cost:
                cost, best = costs[i], np.clip(points[i], 0.0, 1.0)
            told(count, cost)
            return costs

        power = min(SCATTERED, int(math.log2(evaluations)))
        judged(list(scipy.stats.qmc.Sobol(n, rng=np.random.default_rng(seed)).random_base2(power)))
        restart = 0
        while count < evaluations:
            larger = min(MOST, population * 2**restart)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                strategy = evolution_strategy(best, STEP, seed + restart + 1, larger)
                while count < evaluations and not strategy.stop():
                    points = strategy.ask()
                    strategy.tell(points, judged(points))
            restart += 1
    if count == 0:
        raise KeyboardInterrupt
    return CalibrationResult(best, cost, count, time.monotonic() - began)
