# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Verifies gains on valves, noise and motions that the search did not see, before they are accepted."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats
from valve_control.control.analysis import steps
from valve_control.control.laws.law import Law
from valve_control.control.linear import margins, stability
from valve_control.control.simulation.delivery import Delivery
from valve_control.design.tuning import limit_cycles, limits, overshoot, pauses, trial
from valve_control.design.tuning.trial import GainSet, Problem, TrialResult, TuningMotion, Workers
from valve_control.parameter import number

SLOWER = 1.1  # times as long: a motion of the search, turned over, as one that it did not see
UNEVEN = 0.7  # sample periods, by which commands that nobody said how they come are early or late
OVERSHOT = 1.2  # times the limit of the overshoot, which valves that were not seen may have
SLACK = 1.05  # times the limit of the chatter, which valves that were not seen may have


class Verified(NamedTuple):
    """What gains reach on valves that the search did not see."""

    seen: TrialResult  # on the motions of the search
    unseen: TrialResult  # on others
    margins: margins.Margins  # of each valve
    restless: npt.NDArray[np.int64]  # numbers of valves that do not rest after a step or a motion
    pause_s: float | None  # pauses.shortest
    reasons: list[str]  # why the gains are not accepted, as sentences; []: they are
    notes: list[str]  # what else is not as it was asked for, as sentences
    overshoot: float = 0.0  # -  of steps, overshoot.typical; and
    worst_overshoot: float = 0.0  # -  in the worst step of each valve, median of the valves
    settling: float = 0.0  # s  of steps; inf: not while they are held
    unsettled_share: float = 0.0  # share of the steps that are not settled then
    uneven_chatter: float | None = None  # mean c_u where commands come UNEVEN; None: not looked at


def other_motions(motions: Sequence[TuningMotion]) -> list[TuningMotion]:
    """The ``motions`` turned over and slower: others of the same size that the valve can follow as well."""
    made = []
    for motion in motions:
        n = len(motion.wanted)
        times = np.arange(round(n * SLOWER)) / SLOWER
        slower = -np.interp(times, np.arange(n), motion.wanted)
        made.append(TuningMotion(f"{motion.name}, turned over and slower", slower))
    return made


def verified(
    law: Law,
    problem: Problem,
    gains: GainSet,
    chatter: float | None,
    workers: Workers = None,
    firm: Callable[[str], bool] = lambda limit: True,
) -> Verified:
    """Try ``gains`` on ``problem``, whose valves and seed are others than those of the search.

    ``chatter``: the limit that was asked for, None: none. ``firm``: whether gains that miss "saturation",
    "pause", "not at rest" or "chatter" are not accepted; it is asked only where one is missed.
    """
    params = law.build(trial.values_with(problem, gains))
    found = margins.margins(law, params, margins.prepared([*problem.box, *problem.plants]))
    seen = trial.run(law, problem, [gains], workers)[0]
    others = problem._replace(motions=other_motions(problem.motions), seed=problem.seed + 500_000)
    unseen = trial.run(law, others, [gains], workers)[0]
    restless = limit_cycles.after_all(law, others, gains, problem.plants, workers)
    reasons, notes = _margins_missed(problem.limits, margins.as_dict(margins.worst(found))), list[str]()

    def missed(limit: str, sentence: str) -> None:
        (reasons if firm(limit) else notes).append(sentence)

    if not np.all(np.isfinite(seen.e_rms)) or not np.all(np.isfinite(unseen.e_rms)):
        reasons.append("a run does not stay finite")
    if len(restless):
        missed(
            "not at rest",
            f"{len(restless)} of {len(problem.plants)} valves do not rest within {limit_cycles.HELD:g} s "
            "after a step or a motion",
        )
    (share,) = limit_cycles.restless_shares(law, problem, [gains], workers)
    if share > 0.0:
        missed(
            "not at rest",
            f"{100.0 * share:.2g} % of the valves in the box do not rest within {limit_cycles.HELD:g} s "
            "after a step when half of the margins is gone",
        )
    pause = pauses.shortest(law, problem, gains)
    if not pauses.borne(law, problem, gains):
        missed(
            "pause",
            f"after a pause of the command of {1e3 * problem.limits.pause_s:g} ms or less the reference does "
            "not come back while the motion lasts",
        )
    for outcome, what in ((seen, "the commands"), (unseen, "commands that were not seen")):
        share = float(np.mean(outcome.saturated))
        if share > problem.limits.saturated:
            missed("saturation", f"on {what} the amplifier saturates in {100.0 * share:.2g} % of the samples")
    if chatter is not None and not seen.chatter <= SLACK * chatter:
        missed("chatter", f"c_u is {seen.chatter:.3f} on valves that were not seen, above {chatter:g}")
    answers = overshoot.answers(law, problem, gains, workers)
    overshot, settling = (overshoot.typical(rows) for rows in answers)
    if overshot > OVERSHOT * problem.limits.overshoot:
        notes.append(
            f"steps are overshot by {100.0 * overshot:.2g} % on valves that were not seen, above "
            f"{100.0 * problem.limits.overshoot:g} %"
        )
    return Verified(
        seen=seen,
        unseen=unseen,
        margins=found,
        restless=restless,
        pause_s=pause,
        reasons=reasons,
        notes=notes,
        overshoot=overshot,
        worst_overshoot=float(np.median(np.max(answers[0], axis=0))),
        settling=settling,
        unsettled_share=float(np.mean(np.isinf(answers[1]))),
        uneven_chatter=_uneven_chatter(law, problem, gains, workers),
    )


def unsettled(v: Verified) -> list[str]:
    """A sentence, if the median valve has not settled while a step is held."""
    if math.isfinite(v.settling):
        return []
    return [
        f"{100.0 * v.unsettled_share:.2g} % of the steps are not settled to {100.0 * steps.BAND:g} % within "
        f"{overshoot.HELD:g} s"
    ]


def of_valves(law: Law, problem: Problem, saturated: Floats, workers: Workers = None) -> limits.Counts:
    """How many of the plants of ``problem`` miss each limit with its own gains, and the best of them.

    ``saturated``: share of saturated samples of each. Overshoot: of the worst step.
    """
    gains, counts = GainSet({}, 0.0), limits.Counts()
    params, wanted = law.build(problem.values), limits.asked(problem.limits)
    seen = [stability.behind_curve(problem.values, plant)[0] for plant in problem.plants]
    found = margins.margins(law, params, margins.prepared(seen)) if law.feedback else None
    restless = set(limit_cycles.after_all(law, problem, gains, problem.plants, workers).tolist())
    overshot = np.max(overshoot.answers(law, problem, gains, workers)[0], axis=0)
    for i, share in enumerate(saturated):
        values = {
            "saturation": float(share),
            "not at rest": float(i in restless),
            "overshoot": float(overshot[i]),
        }
        if found is not None:
            values |= limits.of_margins(margins.Margins(*(row[i : i + 1] for row in found)))
        limits.count(counts, wanted, values)
    return counts


def _uneven_chatter(law: Law, problem: Problem, gains: GainSet, workers: Workers) -> float | None:
    """c_u where commands come unevenly; None: the problem has a delivery of its own, or knows them ahead."""
    if problem.preview or problem.delivery is not None:
        return None
    period = number(problem.values, "sample_period")
    late = problem._replace(delivery=Delivery(period, UNEVEN * period, problem.seed))
    return trial.run(law, late, [gains], workers)[0].chatter


def _margins_missed(asked: trial.TuningLimits, worst: dict[str, float | None]) -> list[str]:
    if (worst["radius"] or 0.0) >= 1.0 + margins.EDGE:
        return [f"a valve of the box makes the loop unstable (largest pole {worst['radius']:.4f})"]
    texts = {
        "gain_db": ("gain margin", "dB", 1.0, asked.gain_db),
        "reduction_db": ("gain margin downwards", "dB", 1.0, asked.gain_db),
        "phase_deg": ("phase margin", "deg", 1.0, asked.phase_deg),
        "delay_s": ("delay margin", "ms", 1e3, asked.delay_s),
    }
    reasons = []
    for name, (text, unit, scale, limit) in texts.items():
        value = worst[name]
        if value is not None and value < limit:
            reasons.append(
                f"the {text} falls to {scale * value:.3g} {unit} in the box, below {scale * limit:g} {unit}"
            )
    peak = worst["sensitivity_db"]
    if not (math.inf if peak is None else peak) <= asked.sensitivity_db:
        shown = "without end" if peak is None else f"{peak:.3g} dB"
        reasons.append(f"the sensitivity peaks at {shown}, above {asked.sensitivity_db:g} dB")
    swing = worst["swing_v"]
    if not (math.inf if swing is None else swing) <= asked.swing:
        shown = "any size" if swing is None else f"{swing:.3g} V"
        reasons.append(f"in the loop friction sustains swings about rest of {shown}, above {asked.swing:g} V")
    return reasons


def as_dict(v: Verified) -> dict[str, Any]:
    """For JSON: errors [V], geometric mean of the motions at median and 95th percentile of the valves."""

    def percentiles(errors: Floats) -> dict[str, float | None]:
        if not np.all(np.isfinite(errors)):
            return {"median": None, "p95": None}
        middle, tail = np.exp(np.mean(np.log(np.percentile(errors, [50, trial.TAIL], axis=1)), axis=1))
        return {"median": float(middle), "p95": float(tail)}

    return {
        "e_rms": percentiles(v.seen.e_rms),
        "e_max": percentiles(v.seen.e_max),
        "c_u": v.seen.chatter if np.isfinite(v.seen.chatter) else None,
        "saturated": float(np.mean(v.seen.saturated)),
        "unseen_commands": {
            "e_rms": percentiles(v.unseen.e_rms),
            "c_u": v.unseen.chatter if np.isfinite(v.unseen.chatter) else None,
        },
        "valves": v.seen.e_rms.shape[1],
        "overshoot": v.overshoot if np.isfinite(v.overshoot) else None,
        "worst_overshoot": v.worst_overshoot if np.isfinite(v.worst_overshoot) else None,
        "settling_s": v.settling if np.isfinite(v.settling) else None,
        "uneven_c_u": v.uneven_chatter if v.uneven_chatter and np.isfinite(v.uneven_chatter) else None,
        "restless": len(v.restless),
        "pause_s": v.pause_s if v.pause_s is not None and np.isfinite(v.pause_s) else None,
    }
