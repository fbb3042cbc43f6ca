# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tunes one law: search in each of its variants, choice of one point of the front, verification."""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from valve_control.control.laws.law import Law
from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import margins
from valve_control.control.parameters.table import CONTROLLER
from valve_control.design.tuning import search, verification
from valve_control.design.tuning.search import EvaluatedGains, Told
from valve_control.design.tuning.trial import Problem, Workers
from valve_control.design.tuning.verification import Verified
from valve_control.parameter import ParameterError, Value, Values, defaults, updated

TRIES = 8  # points of the front that are verified until one holds
APART = 0.02  # of error or chatter, by which a point has to differ from one that did not hold
NEAR = 0.97  # share of a limit up to which a point is taken; valves that were not seen differ
QUIET = (
    1.25  # times the least chatter, up to which gains are taken where a limit that may give way is not kept
)


class Aim(NamedTuple):
    """Which point of the front is wanted: both None: the knee."""

    chatter: float | None  # at most
    error: float | None  # V  at most
    firm: bool = True  # False: where no gains keep the limit of the chatter, the quieter ones are taken


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
    if aim.error is not None:
        most = NEAR * aim.error
        return sorted((p for p in front if p.error <= most), key=lambda p: p.chatter)
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
    workers: Workers = None,
    verifying: Told = lambda tried: None,
    known: Sequence[Values] = (),
) -> Tuned:
    """Tune ``law`` on ``problem`` with ``budget`` sets of gains in each variant, and verify on ``unseen``.

    The gains of the parameters ``known`` are among the first that are tried. ``told`` gets the sets of gains
    tried so far, ``verifying`` the number of points that were verified before the one that comes next. Raises
    ParameterError, one sentence, if no gains keep the margins, or none of those that do fits ``aim``.
    """
    points: list[tuple[Mapping[str, Value], EvaluatedGains]] = []
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
            workers,
            known,
        )
        points += [(variant, point) for point in found.points]
        tried, missed = tried + found.tried, missed + found.missed
    owner = {id(point): variant for variant, point in points}
    front = search.front([point for _, point in points])
    chosen: Chosen | None = None
    verified = itertools.count()
    for wanted in _aims(front, aim):
        refused: list[EvaluatedGains] = []
        for point in ranked(front, wanted):
            if any(_near(point, other) for other in refused):
                continue
            verifying(next(verified))
            variant = owner[id(point)]
            there = unseen._replace(values=updated(CONTROLLER, unseen.values, variant))
            judged = verification.verified(law, there, point.gains, wanted.chatter, workers)
            if chosen is None or not judged.reasons:
                chosen, aim = Chosen(variant, point, judged), wanted
            if chosen.holds:
                break
            refused.append(point)
            if len(refused) == TRIES:
                break
        if chosen is not None and (chosen.holds or not _too_loud(chosen, wanted)):
            break
    if chosen is None:
        raise ParameterError(_nothing(law, front, aim, tried, missed))
    return Tuned(law.name, [(owner[id(point)], point) for point in front], chosen, tried, missed, aim.chatter)


def _aims(front: Sequence[EvaluatedGains], aim: Aim) -> list[Aim]:
    """``aim``, and what takes its place where no gains keep a limit of the chatter that may give way."""
    if aim.firm or aim.chatter is None or not front:
        return [aim]
    least = min(point.chatter for point in front)
    return [aim, aim._replace(chatter=QUIET * max(aim.chatter, least))]


def _too_loud(chosen: Chosen, aim: Aim) -> bool:
    """Whether chatter on valves that were not seen is what speaks against ``chosen``."""
    return aim.chatter is not None and chosen.verified.seen.chatter > verification.SLACK * aim.chatter


def _near(a: EvaluatedGains, b: EvaluatedGains) -> bool:
    return abs(math.log(a.error / b.error)) < APART and abs(math.log(a.chatter / b.chatter)) < APART


def _nothing(law: Law, front: Sequence[EvaluatedGains], aim: Aim, tried: int, missed: int) -> str:
    if not front:
        return (
            f"{law.name}: none of {tried} sets of gains can be used ({missed} of them miss the margins in "
            "the box, do not come to rest, or do not bear a pause of the command); lower the limits of the "
            "margins, narrow the box, or give a larger --budget"
        )
    if aim.chatter is not None:
        least = min(point.chatter for point in front)
        return (
            f"{law.name}: no gains that keep the margins have a chatter of {aim.chatter:g} or less; the "
            f"least of {tried} sets is {least:.3g}"
        )
    least = min(point.error for point in front)
    return (
        f"{law.name}: no gains that keep the margins have an error of {aim.error:g} V or less; the least of "
        f"{tried} sets is {least:.3g} V"
    )


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
                "parameters": {**variant, **point.gains.changes},
            }
            for variant, point in result.front
        ],
        "verified": verification.as_dict(chosen.verified),
        "margins": worst,
        "accepted": chosen.holds,
        "reasons": chosen.verified.reasons,
        "chatter_limit": result.chatter,
        "tried": result.tried,
        "unusable": result.missed,
    }
