# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Searches the gains of a law: CMA-ES (pycma) at a few limits of the chatter, which together make a front.

Error and chatter of every set of gains that was tried are kept; those that no other one beats in both are the
front. Each run of CMA-ES makes the error small under one limit of the chatter. It may end in one of several
minima: a search begins at several places of the ranges, apart from each other, and twice goes on with the
better half of these runs. From the best of them begins a run with a larger population, which small minima do
not hold up. Where the budget is none for so many runs, as with the many gains of dcarc, there is one run
alone. Later runs, for the other parts of the front, begin at the best set that is known for their limit.

Whether the acceleration of the command is to have a part in its lead depends on the motions more than on the
other gains: it takes away error where they are smooth, and adds chatter where acceleration jumps. So a run
holds that share, and tries its best set with others now and then, when the other gains are no longer bad.

Margins come first: a set that misses them by far is not simulated, and what the others miss is a part of
their cost, so that the search sees on both sides of a margin where it gets better; that part grows as long as
the best sets of a run miss margins. Only those that keep all margins are results. One that would be the best
so far, or is on the front, has to come to rest after steps, on valves that have used up half of the margins.
Where such a set did not, those near the best are asked too for a while, so that a run sees where loops rest;
where all rest, that would take a third of a search and show nothing. The overshoot of steps is a wish, like
the chatter: beyond its limit it costs. It is measured where a set would be the best so far without that cost,
so the more it costs the more sets are measured. If no set is a result, the nearest one is known. Every set
that falls counts its reason. A search is repeatable by its seed, whatever the number of threads.
"""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy.stats

from valve_control.arrays import Floats
from valve_control.control.compiling import CompileError
from valve_control.control.laws.free import Free, present
from valve_control.control.laws.law import Law
from valve_control.control.laws.reshaping import LEAD_ACCEL
from valve_control.control.linear import margins
from valve_control.design import evolution
from valve_control.design.tuning import designs, limits, trial
from valve_control.design.tuning.trial import AHEAD, GainSet, Problem, Threads, TrialResult
from valve_control.parameter import ParameterError, Values

Told = Callable[[int], None]  # sets of gains tried so far
Judge = Callable[[Sequence[Floats], float, float], "Judged"]  # under a limit of the chatter, with a wall
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
FRONT_LIMITS = (0.2, 0.4, 0.1, 0.05)  # of the chatter, where none is asked for


class EvaluatedGains(NamedTuple):
    """One set of gains that keeps the margins, and what it reached in the search."""

    shares: tuple[float, ...]  # of the ranges
    gains: GainSet
    error: float  # V
    chatter: float
    saturated: float
    overshoot: float | None = None  # -  of steps, median of the valves; None: not measured

    def within(self, most: float) -> bool:
        """Whether the overshoot is at most ``most``, as far as there is such a limit."""
        return math.isinf(most) or (self.overshoot is not None and self.overshoot <= most)


class Phase(NamedTuple):
    """One run of the search."""

    chatter: float  # limit
    share: float  # of the budget


class Judged(NamedTuple):
    """What sets of gains cost."""

    costs: list[float]
    keep: list[bool]  # whether each keeps the margins


class SearchResult(NamedTuple):
    """Result of a search."""

    points: list[EvaluatedGains]  # all that keep the margins and stayed finite
    tried: int
    missed: int  # of them, the margins or rest
    counts: limits.Counts  # of the limits
    nearest: EvaluatedGains | None  # to a result, if there is none


def phases(chatter: float | None) -> list[Phase]:
    """Runs of a search, where ``chatter`` is the limit that is asked for, or None. The first is the main."""
    if chatter is None:
        main, *others = FRONT_LIMITS
        return [Phase(main, 0.55), *(Phase(limit, 0.45 / len(others)) for limit in others)]
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


class _Trials:
    """Sets of gains that were tried, and what came of them."""

    def __init__(
        self,
        law: Law,
        problem: Problem,
        free: Sequence[Free],
        threads: Threads,
        chatter: float | None = None,
    ) -> None:
        self.points: list[EvaluatedGains] = []
        self.tried = self.missed = 0
        self._law, self._problem, self._free, self._threads = law, problem, free, threads
        self.box = margins.prepared(problem.box)
        self._rested: dict[tuple[float, ...], float] = {}  # share of the valves on which a set does not rest
        self._alert_until = 0  # number of the set of gains up to which those near the best are asked too
        self._least: dict[float, tuple[int, float]] = {}  # by limit: points looked at, and their least cost
        self._most = problem.limits.overshoot
        self._overshot: dict[tuple[float, ...], float] = {}
        self.counts: limits.Counts = {}
        self._wanted = limits.asked(problem.limits, chatter)
        self.nearest: tuple[float, EvaluatedGains] | None = None  # to a result, and how far it is off

    def judged(self, several: Sequence[Floats], chatter: float, wall: float = WALL) -> Judged:
        """Costs of sets of gains under a limit of the chatter; ``wall`` is the cost of missing a margin."""
        costs = np.full(len(several), NOT_RUN)
        inside = [tuple(float(v) for v in np.clip(shares, 0.0, 1.0)) for shares in several]
        gains = [trial.gains_at(self._free, self._problem.values, shares) for shares in inside]
        violations = [self._violation(g) for g in gains]
        kept: list[int] = []  # that are simulated
        for i, missing in enumerate(violations):
            if missing is None:
                continue
            self.missed += missing > 0.0
            if missing > FAR:
                costs[i] = MISSED + missing
                untried = EvaluatedGains(inside[i], gains[i], math.inf, math.inf, math.inf)
                self._near(MISSED + missing, untried)
            else:
                kept.append(i)
        points: dict[int, EvaluatedGains] = {}
        if kept:
            outcomes = trial.run(self._law, self._problem, [gains[i] for i in kept], self._threads)
            for i, outcome in zip(kept, outcomes, strict=True):
                point = _point(inside[i], gains[i], outcome)
                missing = violations[i] or 0.0
                costs[i] = self._cost(point, chatter) + wall * missing
                points[i] = point
                self._count({"saturation": point.saturated, "chatter": point.chatter})
                if missing > 0.0 or not math.isfinite(point.error):
                    self._near(MISSED + missing, point)
        least = self._least_cost(chatter)
        most = least + (CLOSE if self.tried < self._alert_until else 0.0)
        if math.isfinite(self._most):
            able = [i for i in points if costs[i] < NOT_RUN and costs[i] <= most]
            for i, point in zip(able, self._measured([points[i] for i in able]), strict=True):
                points[i] = point
                costs[i] += overshoot_cost(point.overshoot, self._most)
        points = {i: point for i, point in points.items() if violations[i] == 0.0}
        asked = [i for i in points if costs[i] < NOT_RUN and costs[i] <= most]
        for i, share in zip(asked, self._restless([points[i] for i in asked]), strict=True):
            if share > 0.0:
                self._alert_until = self.tried + len(several) + ALERT
                self._near(share + 0.01 * costs[i], points[i])
                costs[i] = RESTLESS + share
                del points[i]
        self.points += [point for point in points.values() if math.isfinite(point.error)]
        self.tried += len(several)
        outside = [float(np.sum((s - np.clip(s, 0.0, 1.0)) ** 2)) for s in several]
        return Judged(
            [float(c) + o for c, o in zip(costs, outside, strict=True)], [v == 0.0 for v in violations]
        )

    def best(self, chatter: float) -> EvaluatedGains | None:
        """The point of least cost under a limit of the chatter. None if there is none."""
        known = [p for p in self.points if p.overshoot is not None or math.isinf(self._most)]
        return min(known or self.points, key=lambda p: self._cost(p, chatter), default=None)

    def front_at_rest(self) -> None:
        """Drop the points of the front on which a loop does not come to rest, until there are none.

        The front is of those within the limit of the overshoot. Where there is none, it is the best point.
        """
        layers = 0
        while True:
            within = [p for p in self.points if p.within(self._most)]
            unknown = [p for p in self.points if p.overshoot is None and not p.within(self._most)]
            able = front([*within, *(unknown if layers < LAYERS else [])])
            most = self._most if able else math.inf
            able = able or self._nearest_wish()
            untried = [p for p in able if p.shares not in self._rested]
            if not untried:
                return
            layers += 1
            if math.isfinite(self._most):
                known = {p.shares: p for p in self._measured(untried)}
                self.points = [known.get(p.shares, p) for p in self.points]
                self._least.clear()
                untried = [p for p in known.values() if p.within(most)]
            restless = set()
            for point, share in zip(untried, self._restless(untried), strict=True):
                if share > 0.0:
                    restless.add(point.shares)
                    self._near(share, point)
            self.points = [point for point in self.points if point.shares not in restless]
            self._least.clear()

    def _nearest_wish(self) -> list[EvaluatedGains]:
        """The point of least error and overshoot, if one is measured."""
        known = [p for p in self.points if p.overshoot is not None]
        if not known:
            return []
        return [min(known, key=lambda p: math.log(p.error) + overshoot_cost(p.overshoot, self._most))]

    def _measured(self, points: Sequence[EvaluatedGains]) -> list[EvaluatedGains]:
        """``points`` with their overshoot."""
        new = [p for p in points if p.shares not in self._overshot]
        for point, overshot in zip(new, self._values("overshoot", new), strict=True):
            self._overshot[point.shares] = overshot
        return [p._replace(overshoot=self._overshot[p.shares]) for p in points]

    def _values(self, name: str, points: Sequence[EvaluatedGains]) -> list[float]:
        """Measured and counted values of ``points`` for the limit of this ``name``."""
        measure = limits.BY_NAME[name].measure
        assert measure is not None
        gains = [point.gains for point in points]
        found = measure(self._law, self._problem, gains, self._threads) if gains else []
        for value in found:
            self._count({name: value})
        return found

    def _count(self, values: Mapping[str, float]) -> None:
        limits.count(self.counts, self._wanted, values)

    def _near(self, away: float, point: EvaluatedGains) -> None:
        """Keep the ``point``, ``away`` from a result, if none is nearer."""
        if self.nearest is None or away < self.nearest[0]:
            self.nearest = away, point

    def _least_cost(self, chatter: float) -> float:
        """The least cost of all points under a limit of the chatter; only new ones are looked at."""
        seen, least = self._least.get(chatter, (0, math.inf))
        for point in self.points[seen:]:
            if point.overshoot is not None or math.isinf(self._most):
                least = min(least, self._cost(point, chatter))
        self._least[chatter] = len(self.points), least
        return least

    def _cost(self, point: EvaluatedGains, chatter: float) -> float:
        own = cost(point, chatter, self._problem.limits.saturated)
        return own + overshoot_cost(point.overshoot, self._most)

    def _restless(self, points: Sequence[EvaluatedGains]) -> list[float]:
        """Share of the harder valves on which the loops of ``points`` do not come to rest.

        1.0 where the reference does not come back after a pause of the command.
        """
        new = [p for p in points if p.shares not in self._rested]
        for point, pause in zip(new, self._values("pause", new), strict=True):
            if math.isfinite(pause):
                self._rested[point.shares] = 1.0
                self.missed += 1
        new = [p for p in new if p.shares not in self._rested]
        for point, share in zip(new, self._values("not at rest", new), strict=True):
            self._rested[point.shares] = share
            self.missed += share > 0.0
        return [self._rested[point.shares] for point in points]

    def _violation(self, gains: GainSet) -> float | None:
        """By how much ``gains`` miss the margins; None: they are none."""
        try:
            params = trial.built(self._law, trial.values_with(self._problem, gains))
            found = margins.margins(self._law, params, self.box)
        except CompileError:
            raise
        except (ParameterError, ArithmeticError, np.linalg.LinAlgError):
            return None
        self._count(limits.of_margins(found))
        return trial.violation(self._problem.limits, found, 1.0 / BACK_OFF)

    def result(self) -> SearchResult:
        """What came of them. Without a result the nearest set is tried, however far it misses margins."""
        self.front_at_rest()
        nearest = None if self.points or self.nearest is None else self.nearest[1]
        return SearchResult(self.points, self.tried, self.missed, self.counts, nearest)


class _Run:
    """One run of CMA-ES. It does not move the gain at the index ``held``, but tries LEVELS of it at times."""

    def __init__(
        self, start: Floats, held: int | None, step: float, seed: int, population: int = POPULATION
    ) -> None:
        moved = start if held is None else np.delete(start, held)
        self._strategy = evolution.strategy(moved, step, seed, population)
        self.best, self.least = start, math.inf
        self._held, self._level = held, 0.0 if held is None else float(start[held])
        self._wall, self._since = WALL, EVERY // 2

    def go(self, judge: Judge, chatter: float, trials: _Trials, until: float, late: float) -> None:
        """Go on under a limit of the chatter ``until`` so many sets of gains were tried, or it has converged.

        LEVELS are tried from the set of the number ``late`` on.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            while trials.tried < until and not self._strategy.stop():
                asked = self._strategy.ask()
                whole = [self._with_level(shares, self._level) for shares in asked]
                judged = judge(whole, chatter, self._wall)
                self._keep_best(whole, judged)
                self._strategy.tell(asked, judged.costs)
                lowest = int(np.argmin(judged.costs))
                self._wall = max(WALL, self._wall * (LOWER if judged.keep[lowest] else HIGHER))
                self._since += len(asked)
                if self._held is not None and self._since >= EVERY and trials.tried >= late:
                    self._since = 0
                    self._try_levels(judge, chatter)

    def _try_levels(self, judge: Judge, chatter: float) -> None:
        """Go on with the share of LEAD_ACCEL that is best with the best gains."""
        assert self._held is not None
        rest = np.delete(self.best, self._held)
        others = [self._with_level(rest, level) for level in LEVELS if level != self._level]
        self._keep_best(others, judge(others, chatter, self._wall))
        self._level = float(self.best[self._held])

    def _with_level(self, moved: Floats, level: float) -> Floats:
        return moved if self._held is None else np.insert(moved, self._held, level)

    def _keep_best(self, whole: Sequence[Floats], judged: Judged) -> None:
        scores = np.where(judged.keep, judged.costs, np.add(judged.costs, BEYOND))
        i = int(np.argmin(scores))
        if scores[i] < self.least:
            self.best, self.least = np.clip(whole[i], 0.0, 1.0), float(scores[i])


def search(
    law: Law,
    problem: Problem,
    plan: Sequence[Phase],
    budget: int,
    seed: int,
    told: Told,
    threads: Threads = None,
    known: Sequence[Values] = (),
    chatter: float | None = None,
) -> SearchResult:
    """Try ``budget`` sets of gains of ``law``, those of the parameters ``known`` among the first.

    ``chatter``: limit of it beyond which sets are counted, None: none. Raises ParameterError for a law that
    has none to choose.
    """
    free = trial.free_numbers(law, problem.values, problem.preview, problem.scale)
    if not free:
        raise ParameterError(f"{law.name} has no gains to choose; there is nothing to tune")
    trials = _Trials(law, problem, free, threads, chatter)

    def judge(several: Sequence[Floats], chatter: float, wall: float = WALL) -> Judged:
        found = trials.judged(several, chatter, wall)
        told(min(trials.tried, budget))
        return found

    given = [problem.values, *known, *designs.starts(law, problem, trials.box)]
    first = [
        np.array([0.5 if f is AHEAD else f.to_share(present(f, values)) for f in free]) for values in given
    ]
    sobol = scipy.stats.qmc.Sobol(len(free), rng=np.random.default_rng(seed))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a number of points that is no power of two
        scattered = [*first, *sobol.random(min(SCATTERED, max(1, budget // 25)))]
    held = free.index(LEAD_ACCEL) if LEAD_ACCEL in free else None
    if held is not None:
        for shares in scattered[len(first) :]:
            shares[held] = scattered[0][held]
    costs = judge(scattered, plan[0].chatter).costs
    if len(free) == 1:  # no covariance to adapt
        judge(list(np.linspace(0.0, 1.0, max(2, budget - trials.tried))[:, None]), plan[0].chatter)
    else:
        _Search(trials, judge, plan, budget, seed, held).go(scattered, costs)
    return trials.result()


class _Search:
    """Runs of CMA-ES that share a budget."""

    def __init__(
        self, trials: _Trials, judge: Judge, plan: Sequence[Phase], budget: int, seed: int, held: int | None
    ) -> None:
        self._trials, self._judge, self._plan, self._budget = trials, judge, plan, budget
        self._seed, self._held = seed, held

    def go(self, scattered: Sequence[Floats], costs: Sequence[float]) -> None:
        """Search for all phases of the plan, from the sets of gains ``scattered`` on, of these ``costs``."""
        winner = self._begun(scattered, costs)
        self._let(winner, self._plan[0], self._plan[0].share * self._budget)
        until = 0.0
        for number, phase in enumerate(self._plan):
            until += phase.share * self._budget
            end = min(self._budget, round(until))
            restart = 0
            while self._trials.tried < end:
                self._trials.front_at_rest()
                best = self._trials.best(phase.chatter)
                place = winner.best if best is None else np.array(best.shares)
                again = _Run(place, self._held, LATER_STEP, self._seed + 100 * (number + 1) + restart)
                self._let(again, phase, end)
                if again.least < winner.least:
                    winner = again
                restart += 1

    def _begun(self, scattered: Sequence[Floats], costs: Sequence[float]) -> _Run:
        """The main run, from the best of a few places if the budget is large enough for these."""
        moved = len(scattered[0]) - (self._held is not None)
        fitting = self._budget // max(EACH, EACH_COVARIANCE * moved * moved)
        if fitting < STARTS:
            best = scattered[int(np.argmin(costs))]
            step, population = (LONE_STEP, LONE_POPULATION) if fitting else (FIRST_STEPS[0], POPULATION)
            return _Run(best, self._held, step, self._seed + 1, population)
        runs = [
            _Run(start, self._held, FIRST_STEPS[i % len(FIRST_STEPS)], self._seed + i + 1)
            for i, start in enumerate(_starts(scattered, costs, STARTS))
        ]
        for share in ROUNDS:
            if len(runs) == 1:
                break
            for run in runs:
                self._let(run, self._plan[0], self._trials.tried + share * self._budget)
            runs = sorted(runs, key=lambda run: run.least)[: len(runs) // 2]
        return _Run(runs[0].best, self._held, LAST_STEP, self._seed + STARTS + 1, LAST_POPULATION)

    def _let(self, run: _Run, phase: Phase, until: float) -> None:
        run.go(self._judge, phase.chatter, self._trials, until, LATE * self._budget)


def _starts(scattered: Sequence[Floats], costs: Sequence[float], count: int) -> list[Floats]:
    """Up to ``count`` of the places ``scattered``, the best first, that are APART from each other."""
    chosen: list[Floats] = []
    for i in np.argsort(costs):
        if all(math.sqrt(np.mean((scattered[i] - other) ** 2)) > APART for other in chosen):
            chosen.append(scattered[i])
        if len(chosen) == count:
            break
    return chosen


def _point(shares: tuple[float, ...], gains: GainSet, outcome: TrialResult) -> EvaluatedGains:
    return EvaluatedGains(
        shares,
        gains,
        outcome.error,
        outcome.chatter if math.isfinite(outcome.chatter) else math.inf,
        float(np.mean(outcome.saturated)),
    )


def front(points: Sequence[EvaluatedGains]) -> list[EvaluatedGains]:
    """The points that no other one beats in error and chatter, by falling chatter."""
    kept: list[EvaluatedGains] = []
    least = math.inf
    for point in sorted(points, key=lambda p: (p.chatter, p.error)):
        if point.error < least:
            kept.append(point)
            least = point.error
    return kept[::-1]


def knee(kept: Sequence[EvaluatedGains]) -> EvaluatedGains:
    """The point of a front that lies farthest below the line between its ends, both scales logarithmic."""
    x = np.log([p.chatter for p in kept])
    y = np.log([p.error for p in kept])
    if len(kept) < 3:
        return kept[int(np.argmin(x + y))]
    spans = np.ptp(x), np.ptp(y)
    away = (x - x.min()) / spans[0] + (y - y.min()) / spans[1]
    return kept[int(np.argmin(away))]
