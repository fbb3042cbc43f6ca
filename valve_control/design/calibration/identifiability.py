# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Shows how well a table of indices determines each parameter of the valve, one profile for each."""

import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np

from valve_control import interrupts
from valve_control.arrays import Floats
from valve_control.design.calibration import objective
from valve_control.design.calibration.objective import Fit
from valve_control.design.calibration.search import Problem, cost_at, runs_at
from valve_control.design.calibration.space import changed, values_at

T = TypeVar("T")
Done = Callable[[], None]
SHARES = (0.0, 0.15, 0.35, 0.65, 0.85, 1.0)  # of a range, at which its profile is taken
SIZE = 0.05  # first step, as share of the ranges
# What an effect is when it is not there.
ABSENT = {
    "flow_force": 0.0,
    "disturbance.offset": 0.0,
    "friction.coulomb": 0.0,
    "friction.static_ratio": 1.0,
    "friction.presliding": 0.0,
    "lvdt.noise": 0.0,
    "lvdt.resolution": 0.0,
    "lvdt.delay": 0.0,
    "offset": 0.0,
}


class Profile(NamedTuple):
    """Cost over one quantity, for each value of which all others are optimised again."""

    name: str
    values: list[float]
    costs: list[float]

    def interval(self, limit: float) -> tuple[float, float]:
        """Between which values the cost stays below ``limit`` (linear between the points)."""
        x, y = np.array(self.values), np.array(self.costs)
        best = int(np.argmin(y))
        ends = []
        for order in (range(best, -1, -1), range(best, len(x))):
            indices = list(order)
            end = x[indices[-1]]
            for inner, outer in zip(indices, indices[1:], strict=False):
                if y[outer] > limit >= y[inner]:
                    end = x[inner] + (limit - y[inner]) / (y[outer] - y[inner]) * (x[outer] - x[inner])
                    break
            ends.append(float(end))
        return ends[0], ends[1]


class Absence(NamedTuple):
    """The best fit without one effect, all other quantities optimised again."""

    name: str
    fit: Fit


def _refined(problem: Problem, start: Floats, evaluations: int) -> tuple[Floats, float]:
    """Best point near ``start`` in the quantities that are not held."""
    import cma

    options = {"seed": 1, "maxfevals": evaluations, "verbose": -9, "tolflatfitness": 20}
    best, cost = start, cost_at(problem, start)
    if len(start) < 2:  # no covariance to adapt
        for point in np.linspace(0.0, 1.0, evaluations)[:, None] if len(start) else ():
            value = cost_at(problem, point)
            if value < cost:
                best, cost = point, value
        return best, cost
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        strategy = cma.CMAEvolutionStrategy(start, SIZE, options)
        while not strategy.stop():
            points = strategy.ask()
            costs = [cost_at(problem, point) for point in points]
            strategy.tell(points, costs)
            i = int(np.argmin(costs))
            if costs[i] < cost:
                best, cost = np.clip(points[i], 0.0, 1.0), costs[i]
    return best, cost


def _held(problem: Problem, point: Floats, index: int, value: float) -> tuple[Problem, Floats]:
    """The problem with quantity ``index`` held at ``value``, and the rest of ``point``."""
    dimension = problem.dimensions[index]
    base = changed(problem.base, [dimension], {dimension.name: value})
    others = [d for i, d in enumerate(problem.dimensions) if i != index]
    return problem._replace(base=base, dimensions=others), np.delete(point, index)


def _profile(problem: Problem, point: Floats, evaluations: int, index: int) -> Profile:
    dimension = problem.dimensions[index]
    own = float(point[index])
    found = {own: cost_at(problem, point)}
    for shares in (
        sorted((s for s in SHARES if s < own), reverse=True),
        sorted(s for s in SHARES if s > own),
    ):
        others = np.delete(point, index)
        for share in shares:
            reduced, _ = _held(problem, point, index, dimension.from_unit(share))
            others, found[share] = _refined(reduced, others, evaluations)
    ordered = sorted(found)
    return Profile(dimension.name, [dimension.from_unit(s) for s in ordered], [found[s] for s in ordered])


def profiles(problem: Problem, point: Floats, evaluations: int, processes: int, done: Done) -> list[Profile]:
    """Compute the profile of each quantity, with ``evaluations`` valves for each of its points."""
    work = partial(_profile, problem, point, evaluations)
    return _together(work, range(len(problem.dimensions)), processes, done)


def _absence(problem: Problem, point: Floats, evaluations: int, index: int) -> Absence:
    name = problem.dimensions[index].name
    reduced, others = _held(problem, point, index, ABSENT[name])
    others, _ = _refined(reduced, others, evaluations)
    runs = runs_at(reduced, others)
    return Absence(name, objective.NOT_RUN if runs is None else objective.fit(runs, problem.table))


def absences(problem: Problem, point: Floats, evaluations: int, processes: int, done: Done) -> list[Absence]:
    """Compute the best fit without each effect that can be absent."""
    which = [i for i, d in enumerate(problem.dimensions) if d.name in ABSENT]
    return _together(partial(_absence, problem, point, evaluations), which, processes, done)


def _together(work: Callable[[int], T], indices: Sequence[int], processes: int, done: Done) -> list[T]:
    with interrupts.pool(processes) as pool:
        results = []
        for result in pool.map(work, indices):
            results.append(result)
            done()
    return results


def scatter(problem: Problem, point: Floats, seeds: Sequence[int]) -> dict[str, Floats]:
    """Standard deviation of the log indices over ``seeds`` of the noise, by controller."""
    settings = changed(problem.base, problem.dimensions, values_at(problem.dimensions, point))
    found = objective.run(settings, list(problem.table), seeds)
    return {name: np.std(np.log(np.array(runs, dtype=float)), axis=0) for name, runs in found.items()}
