# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tunes one law: search in each of its variants, choice of one point of the front, verification."""

import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from valve_control.control.laws.law import Law
from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import margins
from valve_control.control.parameters.table import CONTROLLER
from valve_control.design.tuning import limits, search, verification
from valve_control.design.tuning.search import EvaluatedGains, Told
from valve_control.design.tuning.trial import GainSet, Problem, Threads
from valve_control.design.tuning.verification import Verified
from valve_control.parameter import ParameterError, Value, Values, defaults, updated

TRIES = 8  # points of the front that are verified until one holds
APART = 0.02  # of error or chatter, by which a point has to differ from one that did not hold
NEAR = 0.97  # share of a limit up to which a point is taken; valves that were not seen differ
QUIET = 1.25  # times the least chatter, up to which gains are taken where the limit gives way


class Aim(NamedTuple):
    """Which point of the front is wanted: the least error at most so much chatter; None: the knee."""

    chatter: float | None
    firm: bool = True  # False: where no gains keep the limit of the chatter, the quieter ones are accepted


class Chosen(NamedTuple):
    """One variant of a law with gains, and what verification says of them."""

    variant: Mapping[str, Value]
    point: EvaluatedGains
    verified: Verified

    @property
    def changes(self) -> dict[str, Value]:
        """Parameters that are chosen."""
        return {**self.variant, **self.point.gains.changes}

    @property
    def holds(self) -> bool:
        """Whether verification accepts them."""
        return not self.verified.reasons


class Tuned(NamedTuple):
    """Result for one law."""

    law: str
    front: list[tuple[Mapping[str, Value], EvaluatedGains]]  # by falling chatter, with the variant
    chosen: Chosen  # that holds, or the first of those that do not
    tried: int
    missed: int  # of them, the margins or rest
    chatter: float | None = None  # limit of it that was kept
    notes: Sequence[str] = ()  # on wishes that are missed
    limits: Sequence[Mapping[str, Any]] = ()  # how often each was missed: limits.as_rows


def variants(law: Law, values: Values) -> list[Mapping[str, Value]]:
    """Settings with each of which ``law`` is tuned: those that agree with what ``values`` choose."""
    usual = defaults(CONTROLLER)
    fitting = [
        variant
        for variant in law.variants
        if all(
            values[name] in (usual[name], value) for name, value in variant.items() if isinstance(value, str)
        )
    ]
    return fitting or [{}]


def ranked(front: Sequence[EvaluatedGains], aim: Aim) -> list[EvaluatedGains]:
    """Points of a front in the order in which they are wanted. Empty if none fits ``aim``."""
    if not front:
        return []
    if aim.chatter is not None:
        limit = NEAR * aim.chatter
        return sorted((p for p in front if p.chatter <= limit), key=lambda p: p.error)
    best = search.knee(front)
    return sorted(
        front, key=lambda p: abs(math.log(p.error / best.error)) + abs(math.log(p.chatter / best.chatter))
    )


def tuned(
    law: Law,
    problem: Problem,
    unseen: Problem,
    aim: Aim,
    budget: int,
    seed: int,
    told: Told,
    threads: Threads = None,
    verifying: Told = lambda tried: None,
    known: Sequence[Values] = (),
) -> Tuned:
    """Tune ``law`` on ``problem`` with ``budget`` sets of gains in each variant, and verify on ``unseen``.

    The gains of the parameters ``known`` are among the first that are tried. ``told`` gets the sets of gains
    tried so far, ``verifying`` the number of points that were verified before the one that comes next.

    A result comes always. Where no gains keep what is asked for it is the nearest, which is accepted unless
    it misses a margin, or another limit that a set of the search or the gains from before it keep. Raises
    ParameterError for a law that has no gains to choose.
    """
    points: list[tuple[Mapping[str, Value], EvaluatedGains]] = []
    nearest: list[tuple[Mapping[str, Value], EvaluatedGains]] = []
    counts: list[limits.Counts] = []
    tried = missed = 0
    for variant in variants(law, problem.values):
        values = updated(CONTROLLER, problem.values, variant)
        found = search.search(
            law,
            problem._replace(values=values),
            search.phases(aim.chatter),
            budget,
            seed,
            lambda done, before=tried: told(before + done),  # type: ignore[misc]
            threads,
            known,
            aim.chatter,
        )
        points += [(variant, point) for point in found.points]
        nearest += [(variant, found.nearest)] if found.nearest is not None else []
        counts.append(found.counts)
        tried, missed = tried + found.tried, missed + found.missed
    if not points and not nearest:
        raise ParameterError(f"{law.name} cannot be built with any of {tried} sets of gains")
    owner = {id(point): variant for variant, point in [*points, *nearest]}
    usable, notes = _within(problem.limits.overshoot, [point for _, point in points], aim)
    front = search.front(usable) or [min((p for _, p in nearest), key=lambda p: p.error)]
    chosen: Chosen | None = None
    verified = itertools.count()
    kept = aim

    @functools.cache
    def firm(limit: str) -> bool:
        if limit == "chatter":
            return aim.firm
        able = [p for _, p in points if limit != "saturation" or p.saturated <= problem.limits.saturated]
        return bool(able) or _shipped_keep(limit, law, problem, threads)

    for wanted in _aims(front, aim):
        refused: list[EvaluatedGains] = []
        for point in ranked(front, wanted):
            if any(_near(point, other) for other in refused):
                continue
            verifying(next(verified))
            variant = owner[id(point)]
            there = unseen._replace(values=updated(CONTROLLER, unseen.values, variant))
            limit = aim.chatter if aim.firm else wanted.chatter
            judged = verification.verified(law, there, point.gains, limit, threads, firm)
            if chosen is None or _order(judged) < _order(chosen.verified):
                chosen, kept = Chosen(variant, point, judged), wanted
            if _order(judged) == (False, 0) or (judged.reasons == [] and notes):
                break
            refused.append(point)
            if len(refused) == TRIES:
                break
        if chosen is not None and (aim.firm or not _too_loud(chosen, wanted)):
            break
    assert chosen is not None, "the last of the aims fits a point"
    front_of = [(owner[id(point)], point) for point in front]
    wanted_limits = limits.asked(problem.limits, aim.chatter)
    rows = limits.as_rows(limits.together(counts), wanted_limits)
    notes += _wishes(front, aim, kept)
    if chosen.verified.reasons and not points:
        notes.append("valve-control margins --box shows where in the box a margin is missed")
    notes += chosen.verified.notes + verification.unsettled(chosen.verified)
    return Tuned(law.name, front_of, chosen, tried, missed, kept.chatter, notes, rows)


def _order(judged: Verified) -> tuple[bool, int]:
    """The better the smaller: gains that hold first, then those with the fewest notes."""
    return bool(judged.reasons), len(judged.notes)


def _within(
    most: float, points: Sequence[EvaluatedGains], aim: Aim
) -> tuple[list[EvaluatedGains], list[str]]:
    """Those of ``points`` within ``most`` [-] of overshoot, or the nearest and a sentence about that.

    The limit may cost search.WORTH times the least error at the chatter that is asked for.
    """
    known = [point for point in points if point.within(most) or point.overshoot is not None]
    if math.isinf(most) or not known:
        return list(points), []
    quiet = [point for point in known if aim.chatter is None or point.chatter <= NEAR * aim.chatter] or known
    free = min(quiet, key=lambda p: p.error)
    worth = [point for point in quiet if point.error <= search.WORTH * free.error]
    least = min(worth, key=lambda p: (_overshoot(p), p.error))
    if _overshoot(least) <= most:
        return [point for point in known if point.within(most)], []
    nearest = min(quiet, key=lambda p: (_overshoot(p), p.error))
    note = (
        f"no set within {100.0 * most:g} % of overshoot at up to {search.WORTH:g} times the error: "
        f"the least is {100.0 * _overshoot(least):.2g} % (error {1e3 * least.error:.3g} mV); "
        f"without this limit {1e3 * free.error:.3g} mV"
    )
    if nearest != least:
        note += f"; {100.0 * _overshoot(nearest):.2g} % has {1e3 * nearest.error:.3g} mV"
    return [point for point in known if _overshoot(point) <= QUIET * _overshoot(least)], [note]


def _overshoot(point: EvaluatedGains) -> float:
    return math.inf if point.overshoot is None else point.overshoot


def _wishes(front: Sequence[EvaluatedGains], aim: Aim, kept: Aim) -> list[str]:
    """A sentence about a limit of the chatter that had to give way."""
    if kept == aim:
        return []
    least, wanted = min(point.chatter for point in front), f"c_u {aim.chatter:g}"
    return [f"no set within {wanted}: the least is {least:.3g}; those up to {kept.chatter:.3g} are taken"]


def _shipped_keep(name: str, law: Law, problem: Problem, threads: Threads) -> bool:
    """Whether ``law`` keeps the limit of this ``name`` with the gains that it had before the search."""
    limit = limits.BY_NAME[name]
    try:
        value = limit.value(law, problem, GainSet({}, 0.0), threads)
    except ParameterError:
        return False
    return not limit.missed(value, limit.asked(problem.limits))


def _aims(front: Sequence[EvaluatedGains], aim: Aim) -> list[Aim]:
    """``aim``, and what takes its place where no gains keep it."""
    if aim.chatter is None:
        return [aim]
    least = min(point.chatter for point in front)
    return [aim, aim._replace(chatter=QUIET * max(aim.chatter, least))]


def _too_loud(chosen: Chosen, aim: Aim) -> bool:
    """Whether chatter on valves that were not seen is what speaks against ``chosen``."""
    return aim.chatter is not None and chosen.verified.seen.chatter > verification.SLACK * aim.chatter


def _near(a: EvaluatedGains, b: EvaluatedGains) -> bool:
    return abs(math.log(a.error / b.error)) < APART and abs(math.log(a.chatter / b.chatter)) < APART


def parameters_of(law: str, values: Values, chosen: Chosen) -> Values:
    """What a parameter file needs: the chosen numbers, and what else of this law is not the default."""
    changed = updated(CONTROLLER, values, chosen.changes)
    usual = defaults(CONTROLLER)
    kept = {
        name: value
        for name, value in changed.items()
        if name in chosen.changes or (value != usual[name] and name.split(".")[0] not in set(LAWS) - {law})
    }
    return {**kept, "controller": law}


def as_dict(result: Tuned) -> dict[str, Any]:
    """For JSON: chosen parameters, front, what was verified and the margins in the box."""
    chosen = result.chosen
    worst = margins.as_dict(margins.worst(chosen.verified.margins))
    ahead = {"preview": chosen.point.gains.ahead} if chosen.point.gains.ahead else {}
    return {
        "chosen": {**chosen.changes, **ahead},
        "front": [
            {
                "error": point.error if math.isfinite(point.error) else None,
                "chatter": point.chatter if math.isfinite(point.chatter) else None,
                "overshoot": point.overshoot,
                "parameters": {**variant, **point.gains.changes},
            }
            for variant, point in result.front
        ],
        "verified": verification.as_dict(chosen.verified),
        "margins": worst,
        "accepted": chosen.holds,
        "reasons": chosen.verified.reasons,
        "notes": list(result.notes),
        "limits": list(result.limits),
        "chatter_limit": result.chatter,
        "tried": result.tried,
        "unusable": result.missed,
    }
