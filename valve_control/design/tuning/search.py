# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Searches the gains of a law: CMA-ES (pycma) at a few limits of the chatter, which together make a front.

Error and chatter of every set of gains that was tried are kept; those that no other one beats in both are the
front. docs/explanation/tuning.md says why the search begins at several places and tries the lead by the
acceleration late.

Margins come first: a set that misses them by far is not simulated, and what the others miss is a part of
their cost, which grows as long as the best sets of a run miss margins. Only those that keep all margins are
results. One that would be the best so far, or is on the front, has to come to rest after steps, on valves
that have used up half of the margins. Where such a set did not, those near the best are asked too for a
while. The overshoot is a wish, like the chatter: beyond its limit it costs. It is measured where a set would
be the best so far without that cost. If no set is a result, the nearest one is known. A search is repeatable
by its seed, whatever the number of threads.
"""

import math
import warnings
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import cma
import numpy as np
import scipy.stats

from valve_control.arrays import Floats
from valve_control.control.compiling import CompileError, LawError
from valve_control.control.laws.free import present
from valve_control.control.laws.law import Law
from valve_control.control.laws.reshaping import LEAD_ACCEL
from valve_control.control.linear import margins
from valve_control.design.tuning import designs, limits, trial
from valve_control.design.tuning.trial import AHEAD, GainSet, Problem, Threads
from valve_control.parameter import ParameterError, Values

Told = Callable[[int], None]  # sets of gains tried so far
POPULATION, LONE_POPULATION = 12, 20  # the other one of a single run that has the time to use it
SCATTERED = 120  # sets of gains all over the ranges at the beginning, at most
STARTS = 4  # places at which a search begins, at most
EACH, EACH_COVARIANCE = 1000, 8  # sets of gains of the budget for each, and times n² of n gains that move
APART = 0.17  # of the ranges, by which they are apart, root mean square over the gains
FIRST_STEPS, LATER_STEP = (0.15, 0.25), 0.08  # of the ranges; those of the places alternate
LONE_STEP = 0.25
LEVELS, EVERY = (0.0, 0.5, 1.0), 100  # shares of LEAD_ACCEL, and sets after which a run tries all of them
LATE = 0.5  # of the budget, before which it does not
ROUNDS = (0.06, 0.06)  # of the budget, for each run, after which the worse half of them ends
LAST_POPULATION, LAST_STEP = 24, 0.15  # of the run that goes on from the best of them
BACK_OFF = 0.9  # share of the limit of saturation, and 1/share of those of the margins, that the search keeps
QUIETER = 0.96  # share of the limit of the chatter that it keeps
PRICE = 6.0  # logarithm of the error for one of the chatter beyond its limit
WORTH = 2.0  # times the error, that the limit of the overshoot may cost
HALF = 0.5  # logarithm of the overshoot over its limit, each with LITTLE more, that costs half of it
LITTLE = 0.01  # -  of overshoot
LAYERS = 4  # of the front, that are measured for their overshoot where none keeps its limit
WALL = 2.0  # logarithm of the error for missing one margin by all of it, at least
HIGHER, LOWER = 1.2, 0.95  # factors of that after each generation whose best set misses one, or does not
FAR = 0.5  # by which the margins may be missed together, as parts of them, to be simulated
MISSED = 20.0  # cost of margins that are missed by more, before what they are missed by
RESTLESS = 10.0  # cost of a loop that does not come to rest, before the share of valves on which it does not
BEYOND = 10.0  # by which a set of gains that misses a margin counts for more when runs are compared
CLOSE = 0.1  # of the logarithm of the error, by which a set may miss the best to be asked whether it rests
ALERT = 100  # sets of gains, for which those are asked after one that did not rest
NOT_RUN = 100.0  # cost of gains that are none


class EvaluatedGains(NamedTuple):
    """One set of gains that keeps the margins, and what it reached in the search."""

    shares: tuple[float, ...]  # of the ranges
    gains: GainSet
    error: float = math.inf  # V
    chatter: float = math.inf
    saturated: float = math.inf
    overshoot: float | None = None  # -  of steps, median of the valves; None: not measured

    def within(self, most: float) -> bool:
        """Whether the overshoot is at most ``most``, as far as there is such a limit."""
        return math.isinf(most) or (self.overshoot is not None and self.overshoot <= most)


class Phase(NamedTuple):
    """One run of the search."""

    chatter: float  # limit
    share: float  # of the budget


class SearchResult(NamedTuple):
    """Result of a search."""

    points: list[EvaluatedGains]  # all that keep the margins and stayed finite
    tried: int
    missed: int  # of them, the margins or rest
    values: Mapping[str, list[float]]  # that were measured, by the name of their limit
    nearest: EvaluatedGains | None  # to a result, if there is none


def phases(chatter: float) -> list[Phase]:
    """Runs of a search, where ``chatter`` is the limit that is asked for. The first is the main."""
    return [Phase(chatter, 0.85), Phase(0.5 * chatter, 0.075), Phase(2.0 * chatter, 0.075)]


def cost(point: EvaluatedGains, chatter: float, saturated: float) -> float:
    """What a run of the search makes small, under limits of ``chatter`` and ``saturated``."""
    if not math.isfinite(point.error) or point.error <= 0.0:
        return NOT_RUN
    beyond = max(0.0, math.log(max(point.chatter, 1e-9) / (QUIETER * chatter)))
    return math.log(point.error) + PRICE * (beyond + max(0.0, point.saturated - BACK_OFF * saturated))


def overshoot_cost(overshot: float | None, most: float) -> float:
    """What an overshoot beyond ``most`` costs beside; nothing before it is measured."""
    if overshot is None or math.isinf(most):
        return 0.0
    if math.isinf(overshot):
        return math.log(WORTH)
    beyond = max(0.0, math.log((overshot + LITTLE) / (BACK_OFF * most + LITTLE)))
    return math.log(WORTH) * beyond / (beyond + HALF)


def strategy(start: Floats, step: float, seed: int, population: int) -> Any:
    """A CMAEvolutionStrategy, quiet, that begins at ``start`` with the standard deviation ``step``.

    It stops when the costs of its generations agree to 1e-4. ``seed`` is that of numpy's global generator,
    which pycma draws from: the same calls in the same order give the same points.
    """
    tolerances = {"tolfun": 1e-4, "tolfunhist": 1e-4, "tolflatfitness": 20}
    options = {"seed": seed, "popsize": population, "verbose": -9, **tolerances}
    return cma.CMAEvolutionStrategy(start, step, options)


class _Search:
    """A search: sets of gains that were tried, and runs of CMA-ES that share a budget."""

    def __init__(
        self, law: Law, problem: Problem, budget: int, seed: int, progress: Told, threads: Threads
    ) -> None:
        self.points: list[EvaluatedGains] = []
        self.tried = self.missed = 0
        self.values = defaultdict[str, list[float]](list)  # measured, by the name of the limit
        self.nearest: tuple[float, EvaluatedGains] | None = None  # to a result, and how far it is off
        self.box = margins.prepared(problem.box)
        self.free = trial.free_numbers(law, problem.values, problem.preview, problem.scale)
        self.held = self.free.index(LEAD_ACCEL) if LEAD_ACCEL in self.free else None
        self.budget, self._seed, self._progress = budget, seed, progress
        self._law, self._problem, self._threads = law, problem, threads
        self._most = problem.limits.overshoot
        self._measured = defaultdict[str, dict[tuple[float, ...], float]](dict)  # by limit, then by shares
        self._alert_until = 0  # number of the set of gains up to which those near the best are asked too

    def judged(
        self, several: Sequence[Floats], chatter: float, wall: float = WALL
    ) -> tuple[list[float], list[bool]]:
        """Costs of sets of gains under a limit of the chatter, and whether each keeps the margins.

        ``wall`` is the cost of missing a margin.
        """
        costs = np.full(len(several), NOT_RUN)
        points: dict[int, EvaluatedGains] = {}
        missing: dict[int, float] = {}  # of the margins
        for i, shares in enumerate(several):
            inside = tuple(np.clip(shares, 0.0, 1.0).tolist())
            gains = trial.gains_at(self.free, self._problem.values, inside)
            if (away := self._violation(gains)) is None:
                continue
            missing[i], points[i] = away, EvaluatedGains(inside, gains)
            self.missed += away > 0.0
            if away > FAR:
                costs[i] = MISSED + away
                self._near(costs[i], points.pop(i))
        gains_of = [point.gains for point in points.values()]
        outcomes = trial.run(self._law, self._problem, gains_of, self._threads) if points else []
        for i, outcome in zip(points, outcomes, strict=True):
            points[i] = point = points[i]._replace(
                error=outcome.error,
                chatter=outcome.chatter if math.isfinite(outcome.chatter) else math.inf,
                saturated=float(np.mean(outcome.saturated)),
            )
            costs[i] = self._cost(point, chatter) + wall * missing[i]
            self.values["saturation"].append(point.saturated)
            self.values["chatter"].append(point.chatter)
            if missing[i] > 0.0 or not math.isfinite(point.error):
                self._near(MISSED + missing[i], point)
        most = min((self._cost(p, chatter) for p in self._comparable()), default=math.inf)
        most += CLOSE if self.tried < self._alert_until else 0.0

        def able() -> list[int]:
            return [i for i in points if costs[i] < NOT_RUN and costs[i] <= most]

        if math.isfinite(self._most):
            for i, point in zip(able(), self._with_overshoot([points[i] for i in able()]), strict=True):
                points[i] = point
                costs[i] += overshoot_cost(point.overshoot, self._most)
        points = {i: point for i, point in points.items() if missing[i] == 0.0}
        for i, share in zip(able(), self._restless([points[i] for i in able()]), strict=True):
            if share > 0.0:
                self._alert_until = self.tried + len(several) + ALERT
                self._near(share + 0.01 * costs[i], points.pop(i))
                costs[i] = RESTLESS + share
        self.points += [point for point in points.values() if math.isfinite(point.error)]
        self.tried += len(several)
        self._progress(min(self.tried, self.budget))
        outside = [float(np.sum((s - np.clip(s, 0.0, 1.0)) ** 2)) for s in several]
        keep = [missing.get(i) == 0.0 for i in range(len(several))]
        return [float(c) + o for c, o in zip(costs, outside, strict=True)], keep

    def _violation(self, gains: GainSet) -> float | None:
        """By how much ``gains`` miss the margins; None: they are none."""
        try:
            params = trial.built(self._law, trial.values_with(self._problem, gains))
            measured = margins.margins(self._law, params, self.box)
        except CompileError:
            raise
        except (ParameterError, LawError, ArithmeticError, np.linalg.LinAlgError):
            return None
        for name, value in limits.worst(limits.of_margins(measured)).items():
            self.values[name].append(value)
        return limits.violation(self._problem.limits, measured, 1.0 / BACK_OFF)

    def _comparable(self) -> list[EvaluatedGains]:
        """The points whose whole cost is known."""
        return [p for p in self.points if p.overshoot is not None or math.isinf(self._most)]

    def front_at_rest(self) -> None:
        """Drop the points of the front on which a loop does not come to rest, until there are none.

        The front is of those within the limit of the overshoot. Where there is none, it is the point of least
        error and overshoot, if one is measured.
        """
        layers = 0
        while True:
            unknown = layers < LAYERS
            able = front(
                [p for p in self.points if p.within(self._most) or (unknown and p.overshoot is None)]
            )
            most = self._most if able else math.inf
            if not able:
                known = [p for p in self.points if p.overshoot is not None]
                able = sorted(
                    known, key=lambda p: math.log(p.error) + overshoot_cost(p.overshoot, self._most)
                )[:1]
            untried = [p for p in able if p.shares not in self._measured["pause"]]
            if not untried:
                return
            layers += 1
            if math.isfinite(self._most):
                measured = {p.shares: p for p in self._with_overshoot(untried)}
                self.points = [measured.get(p.shares, p) for p in self.points]
                untried = [p for p in measured.values() if p.within(most)]
            restless = set()
            for point, share in zip(untried, self._restless(untried), strict=True):
                if share > 0.0:
                    restless.add(point.shares)
                    self._near(share, point)
            self.points = [point for point in self.points if point.shares not in restless]

    def _with_overshoot(self, points: Sequence[EvaluatedGains]) -> list[EvaluatedGains]:
        values = self._values("overshoot", points)
        return [point._replace(overshoot=value) for point, value in zip(points, values, strict=True)]

    def _restless(self, points: Sequence[EvaluatedGains]) -> list[float]:
        """Share of the harder valves on which the loops of ``points`` do not come to rest.

        1.0 where the reference does not come back after a pause of the command.
        """
        borne = [math.isinf(value) for value in self._values("pause", points)]
        rest = iter(self._values("not at rest", [p for p, good in zip(points, borne, strict=True) if good]))
        return [next(rest) if good else 1.0 for good in borne]

    def _values(self, name: str, points: Sequence[EvaluatedGains]) -> list[float]:
        """Values of ``points`` for the limit of this ``name``; new ones are measured and counted."""
        limit, known = limits.BY_NAME[name], self._measured[name]
        assert limit.measure is not None
        new = [p for p in points if p.shares not in known]
        values = limit.measure(self._law, self._problem, [p.gains for p in new], self._threads) if new else []
        self.values[name] += values
        known.update(zip([p.shares for p in new], values, strict=True))
        if limit.rank is limits.KEPT:
            self.missed += sum(limit.missed(value, limit.asked(self._problem.limits)) for value in values)
        return [known[p.shares] for p in points]

    def _near(self, away: float, point: EvaluatedGains) -> None:
        """Keep the ``point``, ``away`` from a result, if none is nearer."""
        if self.nearest is None or away < self.nearest[0]:
            self.nearest = away, point

    def _cost(self, point: EvaluatedGains, chatter: float) -> float:
        own = cost(point, chatter, self._problem.limits.saturated)
        return own + overshoot_cost(point.overshoot, self._most)

    def go(self, plan: Sequence[Phase], scattered: Sequence[Floats], costs: Sequence[float]) -> None:
        """Search for all phases of the ``plan``, from the sets ``scattered`` on, of these ``costs``."""
        winner = self._first_run(plan[0].chatter, scattered, costs)
        winner.go(plan[0].chatter, plan[0].share * self.budget)
        until = 0.0
        for number, phase in enumerate(plan, 1):
            until += phase.share * self.budget
            end, restart = min(self.budget, round(until)), 0
            while self.tried < end:
                self.front_at_rest()
                known = self._comparable() or self.points
                best = min(known, key=lambda p: self._cost(p, phase.chatter), default=None)
                place = winner.best if best is None else np.array(best.shares)
                again = _Run(self, place, LATER_STEP, self._seed + 100 * number + restart)
                again.go(phase.chatter, end)
                if again.least < winner.least:
                    winner = again
                restart += 1

    def _first_run(self, chatter: float, scattered: Sequence[Floats], costs: Sequence[float]) -> "_Run":
        """The main run, from the best of a few places if the budget is large enough for these."""
        moved = len(self.free) - (self.held is not None)
        fitting = self.budget // max(EACH, EACH_COVARIANCE * moved * moved)
        places: list[Floats] = []  # the best first
        for i in np.argsort(costs):
            if all(math.sqrt(np.mean((scattered[i] - other) ** 2)) > APART for other in places):
                places.append(scattered[i])
            if len(places) == STARTS:
                break
        if fitting < STARTS:
            step, population = (LONE_STEP, LONE_POPULATION) if fitting else (FIRST_STEPS[0], POPULATION)
            return _Run(self, scattered[int(np.argmin(costs))], step, self._seed + 1, population)
        runs = [
            _Run(self, start, FIRST_STEPS[i % len(FIRST_STEPS)], self._seed + i + 1)
            for i, start in enumerate(places)
        ]
        for share in ROUNDS:
            if len(runs) == 1:
                break
            for run in runs:
                run.go(chatter, self.tried + share * self.budget)
            runs = sorted(runs, key=lambda run: run.least)[: len(runs) // 2]
        return _Run(self, runs[0].best, LAST_STEP, self._seed + STARTS + 1, LAST_POPULATION)


class _Run:
    """One run of CMA-ES. It does not move the gain that is held, but tries LEVELS of it at times."""

    def __init__(
        self, search: _Search, start: Floats, step: float, seed: int, population: int = POPULATION
    ) -> None:
        self._search, self._held = search, search.held
        moved = start if self._held is None else np.delete(start, self._held)
        self._strategy = strategy(moved, step, seed, population)
        self.best, self.least = start, math.inf
        self._level = 0.0 if self._held is None else float(start[self._held])
        self._wall, self._since = WALL, EVERY // 2

    def go(self, chatter: float, until: float) -> None:
        """Go on under a limit of the chatter ``until`` so many sets were tried, or it has converged."""
        search = self._search
        while search.tried < until and not self._strategy.stop():
            asked = self._strategy.ask()
            costs, keep = self._judged([self._whole(shares, self._level) for shares in asked], chatter)
            self._strategy.tell(asked, costs)
            self._wall = max(WALL, self._wall * (LOWER if keep[int(np.argmin(costs))] else HIGHER))
            self._since += len(asked)
            late = search.tried >= LATE * search.budget
            if self._held is not None and self._since >= EVERY and late:
                self._since = 0
                rest = np.delete(self.best, self._held)
                self._judged([self._whole(rest, one) for one in LEVELS if one != self._level], chatter)
                self._level = float(self.best[self._held])

    def _whole(self, moved: Floats, level: float) -> Floats:
        return moved if self._held is None else np.insert(moved, self._held, level)

    def _judged(self, whole: Sequence[Floats], chatter: float) -> tuple[list[float], list[bool]]:
        """Costs of the sets ``whole``, and which keep the margins; the best of all is kept."""
        costs, keep = self._search.judged(whole, chatter, self._wall)
        scores = np.where(keep, costs, np.add(costs, BEYOND))
        i = int(np.argmin(scores))
        if scores[i] < self.least:
            self.best, self.least = np.clip(whole[i], 0.0, 1.0), float(scores[i])
        return costs, keep


def search(
    law: Law,
    problem: Problem,
    plan: Sequence[Phase],
    budget: int,
    seed: int,
    progress: Told,
    threads: Threads = None,
    known: Sequence[Values] = (),
) -> SearchResult:
    """Try ``budget`` sets of gains of ``law``, those of the parameters ``known`` among the first.

    Raises ParameterError for a law that has none to choose.
    """
    run = _Search(law, problem, budget, seed, progress, threads)
    free, held = run.free, run.held
    if not free:
        raise ParameterError(f"{law.name} has no gains to choose; there is nothing to tune")
    first = [
        np.array([0.5 if f is AHEAD else f.to_share(present(f, values)) for f in free])
        for values in (problem.values, *known, *designs.starts(law, problem, run.box))
    ]
    sobol = scipy.stats.qmc.Sobol(len(free), rng=np.random.default_rng(seed))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of pycma, and of a number of points that is no power of two
        scattered = sobol.random(min(SCATTERED, max(1, budget // 25)))
        if held is not None:
            scattered[:, held] = first[0][held]
        costs, _ = run.judged([*first, *scattered], plan[0].chatter)
        if len(free) == 1:  # no covariance to adapt
            run.judged(list(np.linspace(0.0, 1.0, max(2, budget - run.tried))[:, None]), plan[0].chatter)
        else:
            run.go(plan, [*first, *scattered], costs)
    run.front_at_rest()
    nearest = None if run.points or run.nearest is None else run.nearest[1]
    return SearchResult(run.points, run.tried, run.missed, run.values, nearest)


def front(points: Sequence[EvaluatedGains]) -> list[EvaluatedGains]:
    """The points that no other one beats in error and chatter, by falling chatter."""
    kept: list[EvaluatedGains] = []
    least = math.inf
    for point in sorted(points, key=lambda p: (p.chatter, p.error)):
        if point.error < least:
            kept.append(point)
            least = point.error
    return kept[::-1]
