# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tunes one law: search in each of its variants, choice of one point of the front, verification."""

import functools
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from valve_control.control.analysis import steps
from valve_control.control.laws.law import Law
from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import margins
from valve_control.control.parameters.table import CONTROLLER
from valve_control.design.tuning import checks, limits, search, verification
from valve_control.design.tuning.search import EvaluatedGains, Told
from valve_control.design.tuning.trial import GainSet, Problem, Threads
from valve_control.design.tuning.verification import Verified
from valve_control.parameter import ParameterError, Value, Values, defaults, updated

TRIES = 8  # points of the front that are verified until one holds
APART = 0.02  # of error or chatter, by which a point has to differ from one that did not hold
NEAR = 0.97  # share of a limit up to which a point is taken; valves that were not seen differ
QUIET = 1.25  # times the least chatter, up to which gains are taken where the limit gives way


class Chosen(NamedTuple):
    """Gains, with the variant of the law that they belong to, and what verification says of them."""

    point: EvaluatedGains
    verified: Verified

    @property
    def changes(self) -> dict[str, Value]:
        """Parameters that are chosen."""
        return dict(self.point.gains.changes)

    @property
    def holds(self) -> bool:
        """Whether verification accepts them."""
        return not self.verified.reasons

    @property
    def order(self) -> tuple[bool, int]:
        """The better the smaller: gains that hold first, then those with the fewest notes."""
        return not self.holds, len(self.verified.notes)


class Tuned(NamedTuple):
    """Result for one law."""

    law: str
    front: list[EvaluatedGains]  # by falling chatter
    chosen: Chosen  # that holds, or the first of those that do not
    tried: int
    missed: int  # of them, the margins or rest
    chatter: float  # limit of it that was kept
    notes: Sequence[str] = ()  # on wishes that are missed
    limits: Sequence[Mapping[str, Any]] = ()  # how often each was missed: limits.as_rows


def variants(law: Law, values: Values) -> list[Mapping[str, Value]]:
    """Settings with each of which ``law`` is tuned: those that agree with what ``values`` choose."""
    usual = defaults(CONTROLLER)

    def contradicts(name: str, value: Value) -> bool:
        return isinstance(value, str) and values[name] not in (usual[name], value)

    fitting = [one for one in law.variants if not any(contradicts(*setting) for setting in one.items())]
    return fitting or [{}]


def ranked(front: Sequence[EvaluatedGains], chatter: float) -> list[EvaluatedGains]:
    """Points of a front with at most so much ``chatter``, the least error first. Empty if none fits."""
    return sorted((p for p in front if p.chatter <= NEAR * chatter), key=lambda p: p.error)


def tuned(
    law: Law,
    problem: Problem,
    unseen: Problem,
    chatter: float,
    budget: int,
    seed: int,
    told: Told,
    threads: Threads = None,
    known: Sequence[Values] = (),
    firm: bool = True,
) -> Tuned:
    """Tune ``law`` on ``problem`` with ``budget`` sets of gains in each variant, and verify on ``unseen``.

    ``chatter``: limit of it. Where no gains keep it and it is not ``firm`` the quieter ones are accepted. The
    gains of the parameters ``known`` are among the first that are tried. ``told`` gets the sets of gains
    tried so far, before each verification too.

    A result comes always. Where no gains keep what is asked for it is the nearest, which is accepted unless
    it misses a margin, or another limit that a set of the search or the gains from before it keep. Raises
    ParameterError for a law that has no gains to choose.
    """
    points: list[EvaluatedGains] = []
    nearest: list[EvaluatedGains] = []
    measured = defaultdict[str, list[float]](list)
    tried = missed = 0
    for variant in variants(law, problem.values):
        there = problem._replace(values=updated(CONTROLLER, problem.values, variant))
        one = search.search(
            law, there, search.phases(chatter), budget, seed,
            lambda done, before=tried: told(before + done),  # type: ignore[misc]
            threads, known,
        )  # fmt: skip
        points += _of_variant(variant, one.points)
        nearest += _of_variant(variant, [one.nearest] if one.nearest else [])
        for name, values in one.values.items():
            measured[name] += values
        tried, missed = tried + one.tried, missed + one.missed
    if not points and not nearest:
        raise ParameterError(f"{law.name} cannot be built with any of {tried} sets of gains")
    usable, notes = _within(problem.limits.overshoot, points, chatter)
    front = search.front(usable) or [min(nearest, key=lambda p: p.error)]
    chosen: Chosen | None = None
    least, kept = min(point.chatter for point in front), chatter
    wishes = [chatter, QUIET * max(chatter, least)]  # the other one where no gains keep it

    @functools.cache
    def hard(name: str) -> bool:
        if name == "chatter":
            return firm
        if any(name != "saturation" or p.saturated <= problem.limits.saturated for p in points):
            return True
        limit = limits.BY_NAME[name]
        try:  # the gains from before
            value = limit.value(law, problem, GainSet({}, 0.0), threads)
        except ParameterError:
            return False
        return not limit.missed(value, limit.asked(problem.limits))

    for wanted in wishes:
        refused: list[EvaluatedGains] = []
        for point in ranked(front, wanted):
            if len(refused) == TRIES:
                break
            apart = ((point.error / other.error, point.chatter / other.chatter) for other in refused)
            if any(abs(math.log(e)) < APART and abs(math.log(c)) < APART for e, c in apart):
                continue
            told(tried)
            limit = chatter if firm else wanted
            judged = verification.verified(law, unseen, point.gains, limit, threads, hard)
            candidate = Chosen(point, judged)
            if chosen is None or candidate.order < chosen.order:
                chosen, kept = candidate, wanted
            if not judged.reasons and (notes or not judged.notes):
                break
            refused.append(point)
        if chosen is not None and (firm or not chosen.verified.seen.chatter > verification.SLACK * wanted):
            break
    assert chosen is not None, "the last of the wishes fits a point"
    if kept != chatter and math.isfinite(least):
        notes.append(
            f"no set within c_u {chatter:g}: the least is {least:.3g}; those up to {kept:.3g} are taken"
        )
    if chosen.verified.reasons and not points:
        notes.append("margins with --box shows where in the box a margin is missed")
    notes += chosen.verified.notes
    if math.isinf(chosen.verified.settling):
        share, band = 100.0 * chosen.verified.unsettled_share, 100.0 * steps.BAND
        notes.append(f"{share:.2g} % of the steps are not settled to {band:g} % within {checks.HELD:g} s")
    rows = limits.as_rows(measured, limits.asked(problem.limits, chatter))
    if chosen.verified.reasons:
        notes += limits.binding(rows, "sets of gains")
    return Tuned(law.name, front, chosen, tried, missed, kept, notes, rows)


def _of_variant(variant: Mapping[str, Value], points: Sequence[EvaluatedGains]) -> list[EvaluatedGains]:
    changes = [{**variant, **point.gains.changes} for point in points]
    return [p._replace(gains=p.gains._replace(changes=own)) for p, own in zip(points, changes, strict=True)]


def _within(
    most: float, points: Sequence[EvaluatedGains], chatter: float
) -> tuple[list[EvaluatedGains], list[str]]:
    """Those of ``points`` within ``most`` [-] of overshoot, or the nearest and a sentence about that.

    The limit may cost search.WORTH times the least error at the chatter that is asked for.
    """
    known = [point for point in points if point.within(most) or point.overshoot is not None]
    if math.isinf(most) or not known:
        return list(points), []
    quiet = [point for point in known if point.chatter <= NEAR * chatter] or known
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
                "error": point.error,
                "chatter": point.chatter,
                "overshoot": point.overshoot,
                "parameters": point.gains.changes,
            }
            for point in result.front
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
