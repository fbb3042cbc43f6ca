"""Goes through a commissioning step by step, and brings the parameters from before back if it fails.

While it goes on, the controller itself keeps the limits: ``u_max`` is that of the voltage, ``lvdt.limit``
that of the travel, and a command that falls silent leads to neutral. So they hold whatever becomes of this
process.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from valve_control import interrupts
from valve_control.analysis.indices import Indices, indices
from valve_control.commissioning import backup, courses, model, plant, small_signal, statics
from valve_control.commissioning.bench import Bench, Course, Fault, Limits, Record
from valve_control.commissioning.plant import Plant
from valve_control.commissioning.statics import Friction, Rest, Static
from valve_control.identification import rational
from valve_control.identification.rational import Fit
from valve_control.identification.response import Response
from valve_control.laws.registry import LAWS
from valve_control.parameter import ParameterError, Value, Values, defaults, number, updated
from valve_control.parameters.table import CONTROLLER, NODES
from valve_control.simulation import offline
from valve_control.tuning import box, trial, tuner, verification
from valve_control.tuning.trial import Problem
from valve_control.tuning.tuner import Aim, Tuned

SPRING = 0.5  # s  in which the spring centres the spool
STILL = 2.0  # s  at rest
RATE = 0.4  # 1/s  times the limit of the voltage: rate of the triangle
TURNS = 4  # of the triangle
ROUNDS = 3  # of friction and lag
HIGHER = (
    (3, 0),
    (4, 2),
)  # orders beside the second, and their zeros: a lag of solenoid or amplifier has none
SILENCE = 0.5  # s  of the command, after which the controller leads to neutral
UNSEEN_SEED = 1_000_003  # added to the seed for valves that the search does not see
WORSE = 2.0  # times error and chatter of the simulation, that the running valve may have
SLACK = 0.002  # V  of error beside that
# Of the step "model", in percent, what is done when the fits of the response are, and when the valve is.
RESPONSE, VALVE, WHOLE = 25.0, 95.0, 100.0
VERIFYING = 3.5  # sets of gains in the search, that verification of one set takes on as many valves

Confirm = Callable[[str], bool]  # whether to go on with a step
Progress = Callable[[str, float, float], None]  # name of the step, done, of


class Plan(NamedTuple):
    """What is wanted of a commissioning."""

    limits: Limits
    law: str
    chatter: float  # limit of c_u
    budget: int  # sets of gains
    valves: int  # that are simulated in the search
    unseen: int  # on which gains are verified
    seed: int
    threads: int
    firm: bool = True  # False: where no gains keep the limit of c_u, the quieter ones are taken


class Verification(NamedTuple):
    """The verification run, and what the simulation of the fitted valve says of it."""

    record: Record
    measured: Indices
    expected: Indices  # with the new gains
    former: Indices | None  # with the parameters from before, None if those saturate or are unstable
    reasons: list[str]  # why the gains are not accepted


class Result(NamedTuple):
    """All that a commissioning found, as far as it came."""

    plan: Plan
    before: Values
    rest: Rest
    slow: Record
    static: Static
    friction: Friction
    sine: Record
    response: Response
    plant: Plant
    tuned: Tuned
    applied: Values  # what is different from before, for good
    verification: Verification
    notes: list[str]
    seconds: dict[str, float]  # by step


class Refused(RuntimeError):
    """The user does not want to go on."""


def limiting(before: Values, limits: Limits) -> Values:
    """What keeps the ``limits`` on the controller, while the voltage is commanded."""
    timeout = number(before, "command_timeout")
    return {
        "controller": "open_loop",
        "open_loop.static_gain": 1.0,
        "u_max": limits.voltage,
        "command_limit": limits.voltage,
        "command_timeout": SILENCE if timeout == 0.0 else min(timeout, SILENCE),
        "command.interpolation": "hold",
        "reshaping.lead": 0.0,
    }


def check(plan: Plan, values: Values) -> None:
    """Raise ParameterError unless ``plan`` fits a controller with these ``values``."""
    u_max, lvdt_limit = number(values, "u_max"), number(values, "lvdt.limit")
    if not 0.1 <= plan.limits.voltage <= u_max:
        raise ParameterError(
            f"--max-voltage is {plan.limits.voltage:g} V; it must lie between 0.1 V and u_max, {u_max:g} V"
        )
    if not 0.2 <= plan.limits.travel <= min(lvdt_limit, number(values, "command_limit")):
        most = min(lvdt_limit, number(values, "command_limit"))
        raise ParameterError(
            f"--travel is {plan.limits.travel:g} V; it must lie between 0.2 V and the smaller of lvdt.limit "
            f"and command_limit, {most:g} V"
        )
    if values["lockstep"]:
        raise ParameterError("the controller runs in lockstep; a valve is commissioned on the wall clock")
    if not LAWS[plan.law].free:
        raise ParameterError(f"{plan.law} has no gains to choose; there is nothing to tune")
    updated(CONTROLLER, values, limiting(values, plan.limits))


@contextmanager
def reversible(bench: Bench, before: Values, said: Callable[[str], None]) -> Iterator[None]:
    """At whatever ends the block: 0 V at once, then the parameters ``before``.

    ``said`` gets what became of it.
    """
    try:
        yield
    except BaseException:
        with interrupts.held_back():
            try:
                bench.off()
                said("the controller is inactive and gives 0 V")
            except Fault as fault:
                said(f"the controller could not be switched off: {fault}")
            restore(bench, before)
            said("all its parameters are as before")
        raise


def restore(bench: Bench, before: Values) -> int:
    """Set all parameters ``before``; returns how many differed. Raises Fault if they are not back."""
    changes = backup.differences(bench.values(), before)
    if changes:
        bench.apply(changes)
        left = backup.differences(bench.values(), before)
        if left:
            raise Fault(f"{', '.join(left)} could not be set back")
    return len(changes)


def run(bench: Bench, plan: Plan, before: Values, confirm: Confirm, progress: Progress) -> Result:
    """Commission the valve of ``bench``, whose controller has the parameters ``before``.

    Raises Fault, ParameterError (one sentence) or Refused; the controller then is as it was left: call it
    within ``reversible``.
    """
    limits, period = plan.limits, number(before, "sample_period")
    seconds: dict[str, float] = {}

    def drive(name: str, course: Course, about: Callable[[], float]) -> Record:
        began = time.monotonic()
        record = bench.drive(course, limits, lambda done: progress(name, min(done, about()), about()))
        progress(name, about(), about())
        seconds[name] = time.monotonic() - began
        return record

    def ask(text: str) -> None:
        if not confirm(text):
            raise Refused("stopped by the user")

    ask(
        f"0 V; the controller gets its limits (±{limits.voltage:g} V, reading within ±{limits.travel:g} V) "
        f"and the law open_loop; then {STILL:g} s at 0 V"
    )
    bench.off()
    bench.apply(limiting(before, limits))
    bench.on()
    # Where the law from before left the spool is not the commissioning's doing.
    bench.drive(courses.rest(SPRING), limits._replace(travel=np.inf), lambda done: None)
    bench.apply({"lvdt.limit": limits.travel})
    rest = statics.at_rest(drive("noise at rest", courses.rest(STILL), lambda: STILL))
    ask(
        f"a slow triangle of the voltage up to ±{limits.voltage:g} V, turned at {courses.REACH:.0%} of the "
        "travel"
    )
    rate = RATE * limits.voltage
    turned: list[float] = []
    slow = drive(
        "slow triangle",
        courses.triangle(limits, rate, TURNS, turned.append),
        lambda: courses.triangle_time(limits, rate, TURNS, turned),
    )
    static = statics.slow(slow, rest, limits)
    planned = small_signal.plan(limits, rest, static, period)
    length = planned.steps[-1].end
    ask(
        f"{length:.0f} s of sines of {planned.amplitude:.2g} V from {planned.steps[0].frequency:g} to "
        f"{planned.steps[-1].frequency:g} Hz"
    )
    course = courses.stepped_sine(limits, planned.steps, planned.amplitude, planned.offset)
    sine = drive("stepped sine", course, lambda: length)
    began = time.monotonic()

    def modelled(percent: float) -> None:
        bench.watch(limits)
        progress("model", percent, WHOLE)

    modelled(0.0)
    response, fits, friction = _linear(
        sine, planned, static, rest, lambda done, total: modelled(RESPONSE * done / total)
    )
    found = plant.fitted(
        [slow, sine], fits, friction, static.offset, rest,
        lambda done, total: modelled(RESPONSE + (VALVE - RESPONSE) * done / total),
    )  # fmt: skip
    modelled(VALVE)
    known = model.Known(found, rest, period, number(before, "u_max"), plan.law)
    modelled(WHOLE)
    seconds["model"] = time.monotonic() - began
    ask(f"{plan.budget} sets of gains of {plan.law} are tried in simulation; the valve stays at 0 V")
    began = time.monotonic()
    tuned, motions, valve_values, own = _tuned(bench, plan, before, found, known, rest, progress)
    seconds["tuning"] = time.monotonic() - began
    if not tuned.chosen.holds:
        raise ParameterError(f"the gains are not accepted: {'; '.join(tuned.chosen.verified.reasons)}")
    chosen = _chosen(before, own, tuned)
    wanted = np.concatenate([np.concatenate([m.wanted, np.zeros(round(0.3 / period))]) for m in motions])
    ask(
        f"the new gains of {plan.law} are set, and the valve moves for {len(wanted) * period:.0f} s in "
        "closed loop"
    )
    bench.apply({**chosen, "command_limit": limits.travel})
    record = drive("verification", courses.motion(wanted, period), lambda: len(wanted) * period)
    limit = plan.chatter if tuned.chatter is None else tuned.chatter
    verified = _verified(plan, limit, before, chosen, valve_values, record)
    if verified.reasons:
        raise ParameterError(f"the gains are not accepted: {'; '.join(verified.reasons)}")
    ask("the new gains stay; voltage and travel get their limits from before back")
    final = {**before, **chosen}
    bench.apply(backup.differences(bench.values(), final))
    left = backup.differences(bench.values(), final)
    if left:
        raise Fault(f"{', '.join(left)} could not be set")
    bench.watch(limits._replace(voltage=number(before, "u_max"), travel=number(before, "lvdt.limit")))
    notes = [*response.notes, *_unexplained(found), *known.notes, *_louder(plan, tuned, rest)]
    return Result(
        plan, before, rest, slow, static, found.friction, sine, response, found, tuned,
        backup.differences(before, final), verified, notes, seconds,
    )  # fmt: skip


def _unexplained(found: Plant) -> list[str]:
    """A sentence about a model that does not describe the readings, and one about a spool that swings."""
    notes = []
    if found.error > plant.EXPLAINED:
        notes.append(
            f"the model misses the readings by {found.error:.2g} times what noise and "
            f"{plant.MODEL_ERROR:.0%} of the motion allow"
        )
    if found.presliding > 0.0:
        notes.append(
            "the spool swings on the bristles of its friction: without them no model describes the readings; "
            f"the one that does has a presliding of {1e3 * found.presliding:.2g} mV"
        )
    return notes


def _louder(plan: Plan, tuned: Tuned, rest: Rest) -> list[str]:
    """A sentence about a limit of c_u that had to give way."""
    if tuned.chatter is None or tuned.chatter <= plan.chatter:
        return []
    least = min(point.chatter for _, point in tuned.front)
    return [
        f"no gains that hold have c_u of {plan.chatter:g} or less with {1e3 * rest.noise:.2g} mV of noise "
        f"(least of {tuned.tried} sets: {least:.3g}); those of least error up to {tuned.chatter:.3g} are "
        "taken; --max-chatter sets a limit that is kept in any case"
    ]


def _linear(
    sine: Record,
    planned: small_signal.Plan,
    static: Static,
    rest: Rest,
    told: plant.Told = lambda done, total: None,
) -> tuple[Response, list[Fit], Friction]:
    """Response without friction, its fits, and friction without the valve's own lag.

    ``told`` gets the fits that are done, and of how many. Raises ParameterError.
    """
    friction = Friction(static.friction, 1.0)
    total = float(ROUNDS + len(HIGHER))
    for done in range(ROUNDS):
        told(float(done), total)
        response = small_signal.measured(sine, planned, friction.coulomb)
        second = rational.fit(response, 2)
        lag = second.model.denominator[1] / second.model.denominator[2] + second.delay
        friction = statics.friction(static, lag, rest)
    fits = [second]
    for done, (order, zeros) in enumerate(HIGHER, ROUNDS):
        told(float(done), total)
        try:
            fits.append(rational.fit(response, order, zeros))
        except ParameterError as error:
            response = response._replace(notes=(*response.notes, f"no model of order {order}: {error}"))
    return response, fits, friction


def _tuned(
    bench: Bench,
    plan: Plan,
    before: Values,
    found: Plant,
    known: model.Known,
    rest: Rest,
    progress: Progress,
) -> tuple[Tuned, list[Any], Values, Values]:
    """Gains for the fitted valve and its box, motions, the simulated valve, the law's model.

    Raises ParameterError.
    """
    limits, period = plan.limits, number(before, "sample_period")
    valve_values = updated(
        NODES["valve_simulator"],
        defaults(NODES["valve_simulator"]),
        plant.values(found, rest, period, limits.voltage),
    )
    own = model.controller_values(known, plan.law)
    values = updated(
        CONTROLLER,
        before,
        {**own, "controller": plan.law, "u_max": limits.voltage, "command_limit": limits.travel},
    )
    motions = model.motions(found, known, limits, period)
    settings = {
        "controller": values,
        "valve_simulator": valve_values,
        "command_source": updated(
            NODES["command_source"], defaults(NODES["command_source"]), {"sample_period": period}
        ),
    }
    quantities = model.box(found, period)
    seen, other = (
        box.study_of(settings, quantities, count, seed)
        for count, seed in ((plan.valves, plan.seed), (plan.unseen, plan.seed + UNSEEN_SEED))
    )
    problem = Problem(
        values, motions, box.drawn(seen), box.bounding(seen), trial.USUAL, False, False, plan.seed
    )
    unseen = problem._replace(plants=box.drawn(other), box=box.bounding(other), seed=plan.seed + UNSEEN_SEED)
    law = LAWS[plan.law]
    total = plan.budget * len(tuner.variants(law, values))
    verifying = VERIFYING * plan.unseen / plan.valves

    def told(done: float, verifications: int = 1) -> None:
        bench.watch(limits)
        progress("tuning", done, total + verifications * verifying)

    told(0.0)
    tuned = tuner.tuned(
        law, problem, unseen, Aim(plan.chatter, None, plan.firm), plan.budget, plan.seed, told, plan.threads,
        lambda tried: told(total + tried * verifying, tried + 1),
    )  # fmt: skip
    told(total + verifying)
    return tuned, motions, valve_values, own


def _chosen(before: Values, own: Values, tuned: Tuned) -> dict[str, Value]:
    """What the controller gets for good."""
    return {**own, **tuned.chosen.changes, "controller": tuned.law}


def _verified(
    plan: Plan, chatter: float, before: Values, chosen: Values, valve_values: Values, record: Record
) -> Verification:
    """Judge the verification run by the simulation of the same commands; ``chatter``: limit of c_u.

    Raises ParameterError.
    """
    measured = _indices(record)
    limited = {"u_max": plan.limits.voltage, "command_limit": plan.limits.travel}
    made = offline.simulate(updated(CONTROLLER, before, {**chosen, **limited}), valve_values, record.command)
    former: Indices | None = None
    with np.errstate(over="ignore", invalid="ignore"):
        old = offline.simulate(updated(CONTROLLER, before, limited), valve_values, record.command)
    if np.all(np.isfinite(old.measurement)):
        former = old.indices
    reasons = []
    most = WORSE * made.indices.e_rms + SLACK
    if not measured.e_rms <= most:
        reasons.append(
            f"the error is {1e3 * measured.e_rms:.3g} mV rms on the running valve, and "
            f"{1e3 * made.indices.e_rms:.3g} mV in simulation: the model does not describe this valve"
        )
    most_chatter = WORSE * max(chatter, made.indices.c_u)
    if not measured.c_u <= most_chatter:
        reasons.append(f"c_u is {measured.c_u:.3g} on the running valve, above {most_chatter:.3g}")
    if former is not None and former.e_rms < measured.e_rms and former.c_u < chatter:
        reasons.append(
            f"in simulation the parameters from before do better, {1e3 * former.e_rms:.3g} mV rms instead of "
            f"{1e3 * measured.e_rms:.3g} mV"
        )
    return Verification(record, measured, made.indices, former, reasons)


def _indices(record: Record) -> Indices:
    known = np.isfinite(record.reading) & np.isfinite(record.voltage) & np.isfinite(record.command)
    return indices(
        np.where(known, record.reading - record.command, 0.0),
        np.where(known, record.voltage, 0.0),
        record.period,
        known,
    )


def valve_values(result: Result) -> Values:
    """The valve that was found, as parameters of the simulated one with the limits from before."""
    before = result.before
    return plant.values(result.plant, result.rest, number(before, "sample_period"), number(before, "u_max"))


def as_dict(result: Result) -> dict[str, Any]:
    """For JSON."""
    made, found = result.verification, result.plant
    return {
        "limits": {"voltage": result.plan.limits.voltage, "travel": result.plan.limits.travel},
        "rest": result.rest._asdict(),
        "static": result.static._asdict(),
        "response": {
            "frequency_hz": result.response.frequency,
            "real": result.response.value.real,
            "imaginary": result.response.value.imag,
            "deviation": result.response.deviation,
        },
        "valve": {
            "numerator": list(found.model.numerator),
            "denominator": list(found.model.denominator),
            "static_gain": found.model.static_gain,
            "delay_s": found.delay,
            "offset": found.offset,
            "friction": found.friction._asdict(),
            "presliding": found.presliding,
            "error": found.error,
        },
        "chatter_limit": {"wanted": result.plan.chatter, "kept": result.tuned.chatter},
        "law": result.tuned.law,
        "tuned": tuner.as_dict(result.tuned),
        "applied": result.applied,
        "verification": {
            "measured": made.measured._asdict(),
            "simulated": made.expected._asdict(),
            "simulated_before": None if made.former is None else made.former._asdict(),
            "unseen_valves": verification.as_dict(result.tuned.chosen.verified),
        },
        "notes": result.notes,
        "seconds": result.seconds,
    }
