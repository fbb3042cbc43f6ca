"""Search for the valve: differential evolution over the plausible ranges, then simplices from the best point.

Both are scipy's, and repeatable by the seed whatever the number of processes.
"""

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.optimize

from valve_control.calibration import objective
from valve_control.calibration.objective import FAILED, Fit, Table
from valve_control.calibration.space import Dimension, Settings, changed, values_at
from valve_control.parameters.table import ParameterError

Array = npt.NDArray[np.float64]
Told = Callable[[int, float], None]  # evaluations so far, best cost


class Problem(NamedTuple):
    """What is to be calibrated."""

    base: Settings  # what stays
    table: Table
    dimensions: Sequence[Dimension]
    seeds: Sequence[int]  # of the LVDT's noise; the mean over them counts


class Found(NamedTuple):
    """Result of a search."""

    point: Array  # in the unit cube
    cost: float
    evaluations: int
    seconds: float


def fit_at(problem: Problem, point: Array) -> Fit:
    """How near the table is at ``point`` of the unit cube."""
    values = values_at(problem.dimensions, np.clip(point, 0.0, 1.0))
    try:
        settings = changed(problem.base, problem.dimensions, values)
        found = objective.run(settings, list(problem.table), problem.seeds)
    except (ParameterError, ArithmeticError):
        return Fit(FAILED, FAILED, 0)
    return objective.fit(found, problem.table)


def cost_at(problem: Problem, point: Array) -> float:
    """Cost at ``point``; outside of the unit cube it rises."""
    outside = float(np.sum(np.abs(point - np.clip(point, 0.0, 1.0))))
    return fit_at(problem, point).cost + outside


def search(
    problem: Problem,
    seed: int,
    generations: int,
    simplex: int,
    processes: int,
    told: Told,
    start: Array | None = None,
) -> Found:
    """Best point found. ``simplex``: evaluations of the last stage; ``start``: a first guess."""
    began = time.monotonic()
    count = 0
    best = np.inf
    evaluate = partial(cost_at, problem)
    cost_at(problem, np.full(len(problem.dimensions), 0.5))  # compiles before the processes part

    def tell(number: int, cost: float) -> None:
        nonlocal count, best
        count += number
        best = min(best, cost)
        told(count, best)

    with ProcessPoolExecutor(processes) as pool:

        def together(_: Any, points: Any) -> list[float]:
            points = list(points)
            costs = list(pool.map(evaluate, points, chunksize=max(1, len(points) // (4 * processes))))
            tell(len(costs), min(costs))
            return costs

        result = scipy.optimize.differential_evolution(
            evaluate,
            [(0.0, 1.0)] * len(problem.dimensions),
            maxiter=generations,
            popsize=5,
            init="sobol",
            x0=start,
            mutation=(0.3, 0.9),
            recombination=0.8,
            tol=0.0,
            polish=False,
            updating="deferred",
            workers=together,
            rng=np.random.default_rng(seed),
        )
        point, cost = result.x, float(result.fun)
        if simplex > 0:
            starts = [(point, seed + i) for i in range(processes)]
            work = partial(_descend, problem, simplex)
            for polished, value, number in pool.map(work, starts):
                tell(number, value)
                if value < cost:
                    point, cost = polished, value
    return Found(np.clip(point, 0.0, 1.0), cost, count, time.monotonic() - began)


def _descend(problem: Problem, evaluations: int, start: tuple[Array, int]) -> tuple[Array, float, int]:
    """Simplices of shrinking size, one after the other, from one point."""
    point, seed = start
    random = np.random.default_rng(seed)
    cost, used, size = cost_at(problem, point), 1, 0.1
    while used < evaluations:
        n = len(point)
        corners = np.vstack([point, point + size * random.standard_normal((n, n))])
        result = scipy.optimize.minimize(
            partial(cost_at, problem),
            point,
            method="Nelder-Mead",
            options={
                "initial_simplex": np.clip(corners, 0.0, 1.0),
                "maxfev": min(60 * n, evaluations - used),
                "adaptive": True,
                "xatol": 1e-5,
                "fatol": 1e-6,
            },
        )
        used += int(result.nfev)
        if result.fun < cost:
            point, cost = result.x, float(result.fun)
        else:
            size = max(0.005, 0.6 * size)
    return point, cost, used
