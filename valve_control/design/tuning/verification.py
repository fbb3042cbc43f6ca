# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Verifies gains on valves, noise and motions that the search did not see, before they are accepted."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats
from valve_control.control.laws.law import Law
from valve_control.control.linear import margins
from valve_control.design.tuning import checks, limits, trial
from valve_control.design.tuning.trial import GainSet, Problem, Threads, TrialResult, TuningMotion

SLOWER = 1.1  # times as long: a motion of the search, turned over, as one that it did not see
SLACK = 1.05  # times the limit of the chatter, which valves that were not seen may have


class Verified(NamedTuple):
    """What gains reach on valves that the search did not see."""

    seen: TrialResult  # on the motions of the search
    unseen: TrialResult  # on others
    margins: margins.Margins  # of each valve
    restless: npt.NDArray[np.int64]  # numbers of valves that do not rest after a step or a motion
    reasons: list[str]  # why the gains are not accepted, as sentences; []: they are
    notes: list[str]  # what else is not as it was asked for, as sentences
    overshoot: float = 0.0  # -  of steps, overshoot.typical
    settling: float = 0.0  # s  of steps; inf: not while they are held
    unsettled_share: float = 0.0  # share of the steps that are not settled then


def verified(
    law: Law,
    problem: Problem,
    gains: GainSet,
    chatter: float,
    threads: Threads = None,
    firm: Callable[[str], bool] = lambda limit: True,
) -> Verified:
    """Try ``gains`` on ``problem``, whose valves and seed are others than those of the search.

    ``chatter``: the limit that was asked for. ``firm``: whether gains that miss the limit of this
    name are not accepted; it is asked only where one is missed, and not for a margin.
    """
    wanted = limits.asked(problem.limits, chatter)
    params = law.build(trial.values_with(problem, gains))
    found = margins.margins(law, params, margins.prepared([*problem.box, *problem.plants]))
    seen = trial.run(law, problem, [gains], threads)[0]
    motions = []  # others of the same size that the valve can follow as well
    for motion in problem.motions:
        times = np.arange(round(len(motion.wanted) * SLOWER)) / SLOWER
        slower = -np.interp(times, np.arange(len(motion.wanted)), motion.wanted)
        motions.append(TuningMotion(f"{motion.name}, turned over and slower", slower))
    others = problem._replace(motions=motions, seed=problem.seed + 500_000)
    unseen = trial.run(law, others, [gains], threads)[0]
    restless = checks.after_all(law, others, gains, problem.plants, threads)
    reasons, notes = list[str](), list[str]()

    def missed(name: str, sentence: str) -> None:
        hard = limits.BY_NAME[name].margin or (name != "overshoot" and firm(name))
        (reasons if hard else notes).append(sentence)

    def check(name: str, value: float, slack: float = 1.0, before: str = "") -> None:
        if limits.BY_NAME[name].missed(value, slack * wanted[name]):
            missed(name, before + limits.BY_NAME[name].sentence(value, wanted[name]))

    for name, value in limits.worst(limits.of_margins(found)).items():
        check(name, value)
        if reasons and limits.BY_NAME[name].margin == "radius":
            break  # nothing else tells of an unstable loop
    if not np.all(np.isfinite(seen.e_rms)) or not np.all(np.isfinite(unseen.e_rms)):
        reasons.append("a run does not stay finite")
    if len(restless):
        missed(
            "not at rest",
            f"{len(restless)} of {len(problem.plants)} valves do not rest within {checks.HELD:g} s "
            "after a step or a motion",
        )
    for name in ("not at rest", "pause"):
        check(name, limits.BY_NAME[name].value(law, problem, gains, threads))
    for outcome, commands in ((seen, "the commands"), (unseen, "commands that were not seen")):
        check("saturation", float(np.mean(outcome.saturated)), before=f"on {commands} ")
    check("chatter", seen.chatter, SLACK)
    (answers,) = checks.answers(law, problem, [gains], threads)
    overshot, settling = (checks.typical(rows) for rows in answers)
    check("overshoot", overshot)
    return Verified(
        seen=seen,
        unseen=unseen,
        margins=found,
        restless=restless,
        reasons=reasons,
        notes=notes,
        overshoot=overshot,
        settling=settling,
        unsettled_share=float(np.mean(np.isinf(answers[1]))),
    )


def as_dict(v: Verified) -> dict[str, Any]:
    """For JSON: errors [V], geometric mean of the motions at median and 95th percentile of the valves."""

    def percentiles(errors: Floats) -> dict[str, float]:
        middle, tail = np.exp(np.mean(np.log(np.percentile(errors, [50, trial.TAIL], axis=1)), axis=1))
        return {"median": float(middle), "p95": float(tail)}

    return {
        "e_rms": percentiles(v.seen.e_rms),
        "e_max": percentiles(v.seen.e_max),
        "c_u": v.seen.chatter,
        "saturated": float(np.mean(v.seen.saturated)),
        "unseen_commands": {"e_rms": percentiles(v.unseen.e_rms), "c_u": v.unseen.chatter},
        "valves": v.seen.e_rms.shape[1],
        "overshoot": v.overshoot,
        "settling_s": v.settling,
        "restless": len(v.restless),
    }
