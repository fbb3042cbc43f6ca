# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tunes the law for the fitted valve, and judges the run that verifies the gains on the running one."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats
from valve_control.control.analysis.indices import Indices, indices
from valve_control.control.laws import dcarc
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER, NODES, VALVE
from valve_control.control.plant.transfer_functions import scale_of
from valve_control.control.simulation import offline
from valve_control.design.commissioning import model, valve_fit
from valve_control.design.commissioning.bench import Fault, Plan, Progress, Record
from valve_control.design.commissioning.evaluation import Rest
from valve_control.design.commissioning.valve_fit import Plant
from valve_control.design.identification.first_gains import FRICTION_TERMS
from valve_control.design.tuning import box, trial, tuner
from valve_control.design.tuning.trial import Problem, TuningMotion
from valve_control.design.tuning.tuner import Tuned
from valve_control.parameter import Values, defaults, number, updated

WORSE = 1.5  # times error and chatter of the simulation, that the running valve may have
SLACK = 0.002  # V  of error beside that
BETTER = 0.9  # times the error of the new gains, below which those from before are better
CONTENDS = 1.5  # times the error of the gains of a search, up to which quieter ones are their rivals
LOUD = 1.1  # c_u of the simulated verification run over its limit, above which a quieter search follows
TOO_LOUD = 1.3  # likewise, above which quieter gains are taken whatever their error
HOME = 1.0  # s  before the approach of a verification run
PAUSE = 0.3  # s  after each motion of the verification run
REST = 0.7  # s  more at its end, in which a loop that swings at rest shows it
RECOVERY = 0.2  # s  after a late voltage or command, in which a run shows the machine and not the gains
SATURATED = 0.5  # share of samples at the limit of the voltage, from which on a simulated loop is unstable


class TunedGains(NamedTuple):
    """What tuning chose, and what it was chosen on."""

    tuned: Tuned
    motions: list[TuningMotion]
    valve: Values  # of the simulated valve, with the limit of the voltage that is in force
    changes: Values  # the controller's parameters that are set
    note: str = ""  # on another search


class VerifyingMotion(NamedTuple):
    """The motion of a verification run."""

    wanted: Floats  # V
    judged: int  # first sample that is judged
    stretches: tuple[int, ...] = ()  # samples, ``judged`` first, from which on the run can be repeated

    def since(self, stretch: int) -> "VerifyingMotion":
        """The run with the stretches from this number on."""
        if stretch == 0:
            return self
        left = self.stretches[stretch:]
        wanted = np.concatenate([self.wanted[: self.judged], self.wanted[left[0] :]])
        return VerifyingMotion(wanted, self.judged, tuple(s - left[0] + self.judged for s in left))


class Verification(NamedTuple):
    """The verification run, and what the simulation of the fitted valve says of it."""

    record: Record
    measured: Indices
    expected: Indices  # with the new gains
    former: Indices | None  # with the previous parameters, None if those are unstable
    reasons: list[str]  # why the gains are not accepted


class Task(NamedTuple):
    """What gains of one law are tuned on."""

    problem: Problem
    unseen: Problem  # other valves
    valve: Values  # of the simulated valve, with the limit of the voltage that is in force
    knowledge: Values  # what the law gets to know of the valve
    starts: Sequence[Values]  # values of the controller, whose gains are among the first that are tried


def task(plan: Plan, before: Values, fitted: Plant, known: model.Known, rest: Rest, wider: float) -> Task:
    """The task of tuning the law of ``plan`` for the fitted valve and a box around it.

    ``wider``: times as wide as usual. Beyond that a voltage that the controller reports as an oscillation
    counts even on a spool that swings by itself: the running one may have shown just that. Raises
    ParameterError.
    """
    limits, period = plan.limits, number(before, "sample_period")
    own = valve_fit.values(fitted, rest, period, limits.voltage, plan.sensor_delay)
    valve = updated(VALVE, defaults(VALVE), own)
    knowledge = _knowledge(before, known, plan.law)
    values = _limited(plan, before, {**knowledge, "controller": plan.law})
    source = {**defaults(NODES["command_source"]), "sample_period": period}
    settings = {"controller": values, "valve_simulator": valve, "command_source": source}
    quantities = model.box(fitted, period, wider, plan.sensor_delay)
    problem, unseen = box.problems(
        settings,
        quantities,
        plan.valves,
        plan.unseen,
        plan.seed,
        motions=model.motions(fitted, known, limits, period),
        limits=trial.USUAL,
        preview=False,
        strict=wider > 1.0,
        scale=scale_of(fitted.model),
    )
    return Task(problem, unseen, valve, knowledge, [before] if before["controller"] == plan.law else [])


def _knowledge(before: Values, known: model.Known, law: str) -> Values:
    """What ``law`` gets to know of the valve.

    Terms for an earlier friction, which the parameters ``before`` have, get their usual values. The form of
    the first gains is left out, so that each form is tuned, unless ``before`` chooses one.
    """
    usual = defaults(CONTROLLER)
    own = {name for name, value in before.items() if value != usual[name]}
    earlier = {name: usual[name] for name in FRICTION_TERMS if name.startswith(f"{law}.") and name in own}
    forms = {name for variant in LAWS[law].variants for name, v in variant.items() if isinstance(v, str)}
    values = {**earlier, **model.controller_values(known, law)}
    return {name: value for name, value in values.items() if name not in forms - own}


def learning_path(fitted: Plant, law: str, travel: float) -> Values:
    """Path after a start on which ``law`` does not adapt, if it has one.

    It is the distance between the two positions in which 0 V can leave the spool within its ``travel`` [V].
    The search does without it, since its simulated spools begin in the centre.
    """
    if law != dcarc.LAW.name:
        return {}
    farthest = abs(fitted.model.static_gain) * 0.5 * fitted.hysteresis
    return {"dcarc.learning_path": float(f"{2.0 * min(farthest, travel):.3g}")}


def tuned(
    plan: Plan, before: Values, fitted: Plant, known: model.Known, rest: Rest, wider: float, tell: Progress
) -> TunedGains:
    """Gains for the ``task`` of these; what ``tell`` raises ends the search. Raises ParameterError."""
    wanted, law = task(plan, before, fitted, known, rest, wider), LAWS[plan.law]
    total = plan.budget * len(tuner.variants(law, wanted.problem.values))
    tell(0.0, total)
    best = tuner.tuned(
        law, wanted.problem, wanted.unseen, plan.chatter, plan.budget, plan.seed,
        lambda sets: tell(min(sets, total), total), plan.threads, wanted.starts, plan.firm,
    )  # fmt: skip
    tell(total, total)
    late = learning_path(fitted, best.law, plan.limits.travel)
    changes = {**wanted.knowledge, **best.chosen.changes, **late, "controller": best.law}
    return TunedGains(best, list(wanted.problem.motions), wanted.valve, changes)


def loudness(plan: Plan, before: Values, candidate: TunedGains) -> float:
    """c_u of the simulated verification run with the gains of ``candidate``.

    The search knows the mean of valves and motions; a single run can have more. Raises ParameterError.
    """
    motion = verifying_motion(candidate, number(before, "sample_period"))
    return _simulated(_limited(plan, before, candidate.changes), candidate.valve, motion)[0].c_u


def verifying_motion(candidate: TunedGains, period: float) -> VerifyingMotion:
    """Commands of the verification run: the motions of the search, each with a pause behind it.

    First come a rest and the last motion. They free the spool and are not judged. Otherwise a law that adapts
    takes the force that holds the spool for other friction.
    """
    pause = np.zeros(round(PAUSE / period))
    approach = [np.zeros(round(HOME / period)), candidate.motions[-1].wanted, pause]
    parts = [part for motion in candidate.motions for part in (motion.wanted, pause)]
    whole = np.concatenate([*approach, *parts, np.zeros(round(REST / period))])
    judged = sum(len(part) for part in approach)
    lengths = [len(motion.wanted) + len(pause) for motion in candidate.motions[:-1]]
    return VerifyingMotion(whole, judged, tuple(judged + int(n) for n in np.cumsum([0, *lengths])))


def _simulated(
    values: Values, valve: Values, motion: VerifyingMotion, steady: npt.NDArray[np.bool_] | None = None
) -> tuple[Indices, bool]:
    """Indices of a controller with ``values`` on the ``valve``, from a spool at rest in the centre.

    And whether the run stays finite, and below the limit of the voltage most of the time. The motion [V]
    comes as points of a trajectory, as on the running valve. ``steady``: samples of the judged part that
    count, all if None.
    """
    wanted, judged = motion.wanted, motion.judged
    moved = build.derivatives(wanted, number(valve, "sample_period"))
    with np.errstate(over="ignore", invalid="ignore"):
        run = offline.simulate(values, valve, wanted, derivatives=moved)
        kept = None if steady is None else np.resize(steady, len(wanted) - judged)
        reached = indices((run.measurement - wanted)[judged:], run.voltage[judged:], run.period, kept)
    bounded = np.all(np.isfinite(run.measurement)) and np.mean(run.at_limit[judged:]) < SATURATED
    return reached, bool(bounded)


def _limited(plan: Plan, before: Values, changes: Values) -> Values:
    """The controller's parameters with ``changes`` and the limits of the commissioning."""
    limited = {"u_max": plan.limits.voltage, "command_limit": plan.limits.travel}
    return updated(CONTROLLER, before, {**changes, **limited})


def judged(
    plan: Plan,
    before: Values,
    candidate: TunedGains,
    motion: VerifyingMotion,
    record: Record,
    doubted: bool = False,
) -> Verification:
    """Judge the ``record`` of a verification run, its judged part, by the simulation of its ``motion``.

    Samples that are not ``steady`` count in neither. ``doubted``: the simulation is not believed where it
    says that the previous parameters are better. Raises ParameterError.
    """
    measured, kept = _indices(record), steady(record)
    expected, _ = _simulated(_limited(plan, before, candidate.changes), candidate.valve, motion, kept)
    former, bounded = _simulated(_limited(plan, before, {}), candidate.valve, motion, kept)
    reasons = []
    if not measured.e_rms <= WORSE * expected.e_rms + SLACK:
        reasons.append(
            f"the error is {1e3 * measured.e_rms:.3g} mV rms on the running valve, and "
            f"{1e3 * expected.e_rms:.3g} mV in simulation: the loop on the valve is not that of the model"
        )
    most_chatter = WORSE * max(plan.chatter, candidate.tuned.chatter, expected.c_u)
    if not measured.c_u <= most_chatter:
        reasons.append(f"c_u is {measured.c_u:.3g} on the running valve, above {most_chatter:.3g}")
    quiet = former.c_u <= max(WORSE * plan.chatter, expected.c_u)
    if bounded and not doubted and quiet and former.e_rms < BETTER * expected.e_rms:
        reasons.append(
            f"in simulation the previous parameters do better, {1e3 * former.e_rms:.3g} mV rms instead of "
            f"{1e3 * expected.e_rms:.3g} mV"
        )
    return Verification(record, measured, expected, former if bounded else None, reasons)


def judged_part(motion: VerifyingMotion, whole: Record, end: int) -> Record:
    """The part of a ``whole`` verification run, until the sample ``end``, that is judged.

    Raises Fault if it has no reading.
    """
    part = whole.part(motion.judged, end)
    wanted = motion.wanted[motion.judged : motion.judged + len(part.reading)]
    part = part._replace(command=np.pad(wanted, (0, len(part.reading) - len(wanted))))
    if not np.any(np.isfinite(part.reading) & np.isfinite(part.voltage) & np.isfinite(part.command)):
        raise Fault(
            f"no reading of the motions of the verification run came in {len(whole.reading)} samples; check "
            "the sensor and its clock"
        )
    return part


def steady(record: Record) -> npt.NDArray[np.bool_]:
    """Samples of ``record`` with neither a late voltage nor a late command, and not shortly after one.

    A loop with gains for a fast valve makes a kick after each, which shows the machine and not the gains.
    """
    disturbed = np.zeros(len(record.reading), dtype=np.bool_)
    length = round(RECOVERY / record.period)
    for at in np.flatnonzero(record.late):
        disturbed[at : at + length] = True
    return ~disturbed


def rivals(candidate: TunedGains, best: TunedGains) -> bool:
    """Whether ``candidate`` has about as little error as the ``best`` on valves that were not seen."""
    error, least = (trial.typical(one.tuned.chosen.verified.seen.e_rms) for one in (candidate, best))
    return error < CONTENDS * least


def latest(motion: VerifyingMotion, record: Record) -> float:
    """Largest share of a stretch of ``motion``, or of the rest at its end, without steady samples."""
    begins = [stretch - motion.judged for stretch in motion.stretches[1:]]
    parts = np.split(
        steady(record), [*begins, len(motion.wanted) - motion.judged - round(REST / record.period)]
    )
    return max(1.0 - float(np.mean(part)) for part in parts if len(part))


def about_late(record: Record) -> list[str]:
    """A sentence about late messages of a verification run."""
    share = 1.0 - float(np.mean(steady(record)))
    if share == 0.0:
        return []
    error = _indices(record, np.ones(len(record.reading), dtype=np.bool_)).e_rms
    return [
        f"late messages reach {share:.0%} of the verification run, which shows the machine there and does "
        f"not count; with it the error is {1e3 * error:.3g} mV rms"
    ]


def _indices(record: Record, counted: npt.NDArray[np.bool_] | None = None) -> Indices:
    known = np.isfinite(record.reading) & np.isfinite(record.voltage) & np.isfinite(record.command)
    known[list(record.begins[1:])] = False  # which follow no sample of the part before
    known &= steady(record) if counted is None else counted
    return indices(
        np.where(known, record.reading - record.command, 0.0),
        np.where(known, record.voltage, 0.0),
        record.period,
        known,
    )
