# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Goes through a commissioning step by step, and restores the previous parameters if it fails.

While it goes on, the controller itself keeps the limits: ``u_max`` is that of the voltage, ``lvdt.limit``
that of the travel, and a command that falls silent leads to neutral. So they hold whatever becomes of this
process.
"""

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np

from valve_control import interrupts
from valve_control.control.analysis.timing import Spread, spread
from valve_control.design import priority
from valve_control.design.commissioning import courses, evaluation, gains, model, valve_fit
from valve_control.design.commissioning.bench import Bench, Course, Fault, Mark, Pause, Plan, Record, Swings
from valve_control.design.commissioning.evaluation import Rest, Static
from valve_control.design.commissioning.gains import TunedGains, Verification, VerifyingMotion
from valve_control.design.commissioning.valve_fit import Plant
from valve_control.design.identification import dead_time, lvdt
from valve_control.design.identification.response import Response
from valve_control.design.identification.result import plain
from valve_control.design.tuning import limits, tuner, verification
from valve_control.design.tuning.tuner import Tuned
from valve_control.parameter import ParameterError, Value, Values, number

SPRING = 0.5  # s  in which the spring centres the spool
STILL, NOISE = 2.0, 2.0  # s and windows of readings that tell the noise: at rest, the larger of both
RATE = 0.4  # 1/s  times the limit of the voltage: rate of the triangle
TURNS = 4  # of the triangle
# Times as wide as usual, the boxes of valves around the model that gains are sought for: the second one where
# those for the first do not hold.
BOXES = (1.0, 2.0)
DOUBTED = (2.0, 3.0)  # likewise, where the model does not explain the readings
AGAIN = 3  # times that a stretch which a pause has spoiled is repeated
MOST_LATE = 0.7  # share of a stretch of a verification run that late messages may reach
RESTS = 10  # times that a rest is tried, which is no test
APART = 1.0  # s  between two reports of a pause, below which they are about the same one
SIMULATIONS = 600.0  # about, of the step "model"
REST, SLOW, SINE = "noise at rest", "slow triangle", "stepped sine"  # the tests
SEARCH, LAST = "search", "new gains"  # steps without a course, in which pauses are counted
TUNING, VERIFICATION = "tuning", "verification"  # steps: the first search, the run with its gains
Courses = Callable[[int, Mark], Course]  # the rest of a step from a stretch on, from rest
Records = Mapping[str, Record]  # by the name of the test
T = TypeVar("T")


class Tests(NamedTuple):
    """What the tests of a valve show, for any law."""

    rest: Rest
    slow: Record
    static: Static
    sine: Record
    response: Response
    plant: Plant


class Result(NamedTuple):
    """A whole commissioning."""

    plan: Plan
    before: Values
    tests: Tests
    tuned: Tuned
    applied: Values  # what is different from before, for good
    verification: Verification
    notes: list[str]
    seconds: dict[str, float]  # by step
    pauses: dict[str, int]  # by step
    way: Spread  # s  from a reading to its voltage in the tests; NaN: not known


class Refused(RuntimeError):
    """The user does not want to go on."""


class Steps(Protocol):
    """Who goes through the steps with the valve."""

    def confirm(self, text: str) -> bool:
        """Whether to go on with a step; ``text`` says what it does."""

    def progress(self, name: str, done: float, total: float) -> None:
        """``done`` of ``total`` of the step ``name`` are over."""

    def tested(self, records: Records) -> None:
        """These tests are whole; friction and noise could be evaluated."""

    def fitted(self, valve: Values) -> None:
        """The valve as parameters of the simulated one, as soon as it is known."""

    def refused(self, changes: Values, reason: str) -> None:
        """Gains that are not accepted, and why."""


class Reversal:
    """What became of the previous parameters when a commissioning ended early."""

    def __init__(self) -> None:
        self.restored = False  # all are in force again
        self.report: list[str] = []  # for the user


@contextmanager
def reversible(bench: Bench, before: Values, reversal: Reversal) -> Iterator[None]:
    """At whatever ends the block: 0 V at once, then the parameters ``before``, and active if it was."""
    active, report = bench.active, reversal.report.append
    try:
        yield
    except BaseException:
        with interrupts.held_back():
            try:
                bench.off()
                report("the controller was switched to 0 V")
            except Fault as fault:
                report(f"the controller could not be switched off: {fault}")
            restore(bench, before)
            reversal.restored = True
            report("all its parameters are as before")
            if active:
                try:
                    bench.on()
                    report("it is active, as before")
                except Fault as fault:
                    report(f"it was activated again, as before: {fault}")
        raise


def restore(bench: Bench, wanted: Values) -> int:
    """Set what differs from all the parameters ``wanted``; returns how many. Raises Fault."""
    changes = differences(bench.values(), wanted)
    if changes:
        bench.apply(changes)
        left = differences(bench.values(), wanted)
        if left:
            raise Fault(f"{', '.join(left)} could not be set")
    return len(changes)


def differences(present: Values, wanted: Values) -> dict[str, Value]:
    """What has to be set so that ``present`` becomes ``wanted``."""
    return {name: value for name, value in wanted.items() if present.get(name) != value}


class Commissioning:
    """One valve on its way from the parameters ``before`` to new ones.

    ``bench``: of the valve, whose controller has the parameters ``before``. Tests of which there are
    ``records`` are not made again.
    """

    def __init__(
        self, bench: Bench, plan: Plan, before: Values, steps: Steps, records: Records | None = None
    ) -> None:
        self._bench, self._plan, self._before, self._steps = bench, plan, before, steps
        self._records = dict(records or {})
        self._pauses: Counter[str] = Counter()
        self._paused = -math.inf  # s, the last report of one
        self._limits, self._period = plan.limits, number(before, "sample_period")
        self._seconds: dict[str, float] = {}
        self._still = max(STILL, NOISE * lvdt.WINDOW * self._period)  # s
        self._simulations = -1.0  # of the step "model"

    def run(self, tests: Tests | None = None) -> Result:
        """Commission; ``tests`` that were made of this valve within the same limits are not made again.

        Raises Fault, ParameterError (one sentence) or Refused; the controller then is as it was left: call it
        within ``reversible``.
        """
        before, u_max = self._before, number(self._before, "u_max")
        self._ask(
            f"0 V; the controller gets its limits (±{self._limits.voltage:g} V, reading within "
            f"±{self._limits.travel:g} V) and the law open_loop; then {self._still:g} s at 0 V"
        )
        self._bench.off()
        self._open_loop()
        if tests is None:
            tests = self._tested()
        with self._timed("model"):
            sensor = self._plan.sensor_delay
            self._steps.fitted(valve_fit.values(tests.plant, tests.rest, self._period, u_max, sensor))
            known = model.Known(tests.plant, tests.rest, self._period, u_max, self._plan.law, sensor)
            self._look()
            self._steps.progress("model", SIMULATIONS, SIMULATIONS)
        chosen, verified, refusals = self._accepted(tests, known)
        final = self._kept(chosen.changes)
        way = spread(np.concatenate([tests.slow.latency, tests.sine.latency]))
        notes = [
            *tests.response.notes,
            *known.notes,
            *refusals,
            *dead_time.way_notes(way),
            *gains.about_late(verified.record),
            *_notes(self._plan, tests, chosen.tuned, self._pauses),
        ]
        return Result(
            plan=self._plan,
            before=before,
            tests=tests,
            tuned=chosen.tuned,
            applied=differences(before, final),
            verification=verified,
            notes=notes,
            seconds=self._seconds,
            pauses=dict(self._pauses),
            way=way,
        )

    def _tested(self) -> Tests:
        """Noise, friction and response of the valve in open loop, and the plant that is fitted to them."""
        limits, period = self._limits, self._period
        still = self._test(REST, lambda first, mark: courses.rest(self._still, mark, first), self._still)
        rest = evaluation.at_rest(still)
        self._steps.tested(self._records)
        rate = RATE * limits.voltage
        slow = self._test(
            SLOW,
            lambda first, mark: courses.triangle(limits, rate, TURNS, mark, period, first),
            2.0 * TURNS * limits.voltage / rate,
            f"a slow triangle of the voltage up to ±{limits.voltage:g} V, turned at {courses.REACH:.0%} of "
            "the travel",
        )
        static = evaluation.slow(slow, rest)
        self._steps.tested(self._records)
        planned = evaluation.plan(limits, static, period)
        first_step, last_step = planned.steps[0], planned.steps[-1]
        sine = self._test(
            SINE,
            lambda first, mark: courses.stepped_sine(
                limits, planned.steps, planned.amplitude, planned.offset, mark, period, first
            ),
            last_step.end,
            f"{last_step.end:.0f} s of sines of {planned.amplitude:.2g} V from {first_step.frequency:g} to "
            f"{last_step.frequency:g} Hz",
        )

        self._steps.tested(self._records)

        def fit(tell: Callable[..., None]) -> tuple[Response, Plant]:
            linear, fits, friction = evaluation.linear(sine, planned, static, rest, tell)
            begin = [slow, sine], fits, friction, static.offset, rest, tell
            return linear, valve_fit.fitted(*begin, lambda: evaluation.higher(linear, evaluation.RICHER)[0])

        with self._timed("model"):
            self._modelled()
            response, fitted = self._background(fit, self._modelled)
            self._modelled()
        return Tests(rest, slow, static, sine, response, fitted)

    def _open_loop(self) -> None:
        """From inactive to 0 V: open loop within the limits, the other parameters as before."""
        restore(self._bench, {**self._before, **self._limits.applied(self._before)})
        self._at_rest(SPRING)
        self._bench.apply({"lvdt.limit": self._limits.travel})

    def _kept(self, changes: Values) -> Values:
        """Set ``changes`` for good, with the limits and the rest from before; returns all."""
        self._ask("the new gains stay; voltage and travel get their previous limits back")
        final = {**self._before, **changes}
        restore(self._bench, final)
        if self._look(voltage=number(final, "u_max"), travel=number(final, "lvdt.limit"), step=LAST):
            self._at_rest(SPRING)  # with the new gains: what has not ended with the pause ends this
        return final

    def _accepted(self, tests: Tests, known: model.Known) -> tuple[TunedGains, Verification, list[str]]:
        """Gains that hold, also on the valve, and notes on those that did not. Raises ParameterError."""
        refusals: list[str] = []
        doubted = tests.plant.error > valve_fit.EXPLAINED
        for wider in (boxes := DOUBTED if doubted else BOXES):
            candidate = self._tuned(tests, known, wider, refusals)
            reasons = candidate.tuned.chosen.verified.reasons
            if reasons:
                reasons = [*reasons, *limits.binding(candidate.tuned.limits, "sets of gains")]
            else:
                verified, reasons = self._verified(candidate, doubted)
                if verified is not None and not reasons:
                    notes = [f"gains were not accepted: {refusal}" for refusal in refusals]
                    return candidate, verified, notes + ([candidate.note] if candidate.note else [])
                self._bench.off()
                if wider != boxes[-1]:
                    self._open_loop()
            reason = "; ".join(reasons)
            self._steps.refused(candidate.changes, reason)
            refusals.append(f"{candidate.tuned.law} for a box {wider:g} times as wide: {reason}")
        raise ParameterError(f"the gains are not accepted: {'; '.join(refusals)}")

    def _tuned(self, tests: Tests, known: model.Known, wider: float, refusals: list[str]) -> TunedGains:
        """Gains of the law after these ``refusals``. Raises ParameterError."""
        text = f"{self._plan.budget} sets of gains of {self._plan.law} are tried in simulation"
        if refusals:
            text = f"gains are not accepted ({refusals[-1]}); {text}, for a box {wider:g} times as wide"
        self._ask(f"{text}; the valve stays at 0 V")
        with self._timed(TUNING):
            try:
                return self._searched(tests, known, wider)
            except ParameterError as error:
                if not refusals:
                    raise
                text = f"the gains are not accepted: {'; '.join(refusals)}; {error}"
                raise ParameterError(text) from error

    def _searched(self, tests: Tests, known: model.Known, wider: float) -> TunedGains:
        """Gains, of a quieter search if those of the first are loud. Raises ParameterError."""

        def search(plan: Plan, step: str) -> TunedGains:
            def tell(done: float, total: float) -> None:
                self._look()
                self._steps.progress(step, done, total)

            about = self._before, tests.plant, known, tests.rest, wider
            return self._background(lambda tell: gains.tuned(plan, *about, tell), tell)

        plan = self._plan
        usual = search(plan, TUNING)
        limit = usual.tuned.chatter
        if usual.tuned.chosen.verified.reasons:
            return usual
        loud = gains.loudness(plan, self._before, usual)
        if not gains.LOUD * limit < loud < math.inf:
            return usual
        try:
            again = search(plan._replace(chatter=limit * (limit / loud), firm=True), f"{TUNING} again")
        except ParameterError:  # the limit cannot be that low
            return usual
        quiet = gains.loudness(plan, self._before, again)
        better = gains.rivals(again, usual) or quiet <= gains.TOO_LOUD * limit < loud
        if again.tuned.chosen.verified.reasons or quiet >= loud or not better:
            return usual
        return again._replace(
            note=f"a quieter search of {plan.law} brought c_u of the simulated verification run from "
            f"{loud:.3g} to {quiet:.3g}"
        )

    def _verified(self, candidate: TunedGains, doubted: bool) -> tuple[Verification | None, list[str]]:
        """The verification run, None if it ended early, and why the gains are not accepted.

        ``doubted``: the model does not explain the readings.
        """
        motion = gains.verifying_motion(candidate, self._period)
        length = len(motion.wanted) * self._period
        self._ask(
            f"the new gains of {candidate.tuned.law} are set, and the valve moves for {length:.0f} s in "
            "closed loop"
        )
        course = {name: self._before[name] for name in ("reshaping.lead", "command.bridge")}
        self._bench.apply({**course, **candidate.changes, "command_limit": self._limits.travel})
        try:
            record = self._moved(motion)
        except Swings as fault:
            return None, [str(fault)]
        verified = gains.judged(self._plan, self._before, candidate, motion, record, doubted)
        return verified, verified.reasons

    def _moved(self, motion: VerifyingMotion) -> Record:
        """Record of the judged part of ``motion``, each stretch with its share of late ones. Raises Fault."""

        def course(first: int, mark: Mark) -> Course:
            rest = motion.since(first)
            return courses.motion(
                rest.wanted, self._period, rest.stretches[1:], lambda number, at: mark(first + number, at)
            )

        for _ in range(AGAIN):
            record = self._drive(
                VERIFICATION,
                course,
                len(motion.wanted) * self._period,
                lambda record, first, end: gains.judged_part(motion.since(first), record, end),
            )
            late = gains.latest(motion, record)
            if late <= MOST_LATE:
                return record
            self._pauses[VERIFICATION] += 1
        raise Fault(
            f"late messages reach {late:.0%} of a stretch of the verification run, {AGAIN} times: it shows "
            "the machine and not the gains; give controller and driver real-time priority (chrt -f 10), "
            "or this host less to do"
        )

    def _test(self, name: str, course: Courses, length: float, text: str = "") -> Record:
        """Record of the test ``name``, which is made unless there is one; ``text``: of the question."""
        if name not in self._records:
            if text:
                self._ask(text)
            self._records[name] = self._drive(name, course, length)
        return self._records[name]

    def _drive(
        self,
        name: str,
        course: Courses,
        length: float,
        chosen: Callable[[Record, int, int], Record] = lambda record, first, end: record.part(0, end),
    ) -> Record:
        """Record of the step ``name``, of which a stretch that a pause spoils is repeated.

        ``length`` [s]: about how long it takes; ``chosen``: of the record of a course that began with a
        stretch, what counts of it until a sample. Raises Fault.
        """
        parts: list[Record] = []
        marks: list[tuple[int, float]] = []  # stretches of a course and the times [s] at which they begin
        first, tries, over = 0, 0, 0.0

        def mark(stretch: int, at: float) -> None:
            marks.append((stretch, at))

        def progress(done: float) -> None:
            self._steps.progress(name, min(over + done, length), length)

        with self._timed(name):
            while True:
                marks[:] = [(first, 0.0)]
                try:
                    if tries:
                        self._bench.off()
                        self._at_rest(SPRING)
                    record = self._bench.drive(course(first, mark), self._limits, progress)
                    progress(math.inf)
                    return Record.joined([*parts, chosen(record, first, len(record.reading))])
                except Pause as pause:
                    self._pauses[name] += 1
                    stretch, at = marks[-1]
                    tries = tries + 1 if stretch == first else 1
                    if tries > AGAIN:
                        raise Fault(f"{pause}, {tries} times in one stretch of the step {name}") from pause
                    if pause.record is not None and stretch != first:
                        parts.append(chosen(pause.record, first, round(at / self._period)))
                        over += at
                    first = stretch

    def _at_rest(self, duration: float) -> None:
        """Let the controller work at 0 V for ``duration`` [s], whatever the travel. Raises Fault.

        Where the law from before, or a pause, left the spool is not the commissioning's doing.
        """
        for left in reversed(range(RESTS)):
            try:
                self._bench.on()
                limits = self._limits._replace(travel=np.inf)
                self._bench.drive(courses.rest(duration), limits, lambda done: None)
                return
            except Pause:
                self._pauses["rest"] += 1
                self._bench.off()
                if left == 0:
                    raise

    def _background(self, work: Callable[[Callable[..., None]], T], tell: Callable[..., None]) -> T:
        """What ``work`` returns; over ROS it gives way to the loop. ``tell`` gets its progress."""
        if self._plan.gives_way:
            return priority.in_background(work, tell)
        return work(tell)

    def _look(self, step: str = SEARCH, **limits: float) -> bool:
        """Look at what has come while no course is driven; whether there was a pause, which is counted.

        ``limits`` [V]: that are others than usual.
        """
        try:
            self._bench.watch(self._limits._replace(**limits))
        except Pause:
            now = time.monotonic()
            self._pauses[step] += now > self._paused + APART
            self._paused = now
            return True
        return False

    def _ask(self, text: str) -> None:
        if not self._steps.confirm(text):
            raise Refused("stopped by the user")

    def _modelled(self) -> None:
        """One more simulation or fit of the step "model" is over."""
        self._look()
        self._simulations = min(SIMULATIONS, self._simulations + 1.0)
        self._steps.progress("model", self._simulations, SIMULATIONS)

    @contextmanager
    def _timed(self, name: str) -> Iterator[None]:
        """Add the time of the block to that of the step ``name``."""
        began = time.monotonic()
        try:
            yield
        finally:
            self._seconds[name] = self._seconds.get(name, 0.0) + time.monotonic() - began


def _notes(plan: Plan, tests: Tests, tuned: Tuned, pauses: Mapping[str, int]) -> Iterator[str]:
    """Sentences on the model, on pauses, and on a c_u too high."""
    fitted = tests.plant
    if fitted.error > valve_fit.EXPLAINED:
        yield (
            f"the model misses the readings by {fitted.error:.2g} times what noise and "
            f"{valve_fit.MODEL_ERROR:.0%} of the motion allow: the gains are judged by the running valve, "
            f"and were sought for boxes {DOUBTED[0]:g} or {DOUBTED[-1]:g} times as wide as usual"
        )
    if fitted.magnet is not None:
        m = fitted.magnet
        yield (
            "a valve with solenoids describes the readings better than a linear one with friction: coil "
            f"{1e3 * m.coil:.2g} ms, hysteresis of the magnet {m.hysteresis:.2f} V, gains of the sides "
            f"{m.positive:.3g} and {m.negative:.3g} times {m.gain:.3g} V/V, overlap {m.overlap:z.2f} V"
        )
    elif fitted.presliding > 0.0:
        yield (
            "a linear valve whose friction has bristles describes the readings, and none without them: "
            f"presliding {1e3 * fitted.presliding:.2g} mV; such a spool may swing on its bristles"
        )
    if pauses:
        counts = ", ".join(f"{name} {count}" for name, count in pauses.items())
        yield f"readings, controller or host paused ({counts}): the stretches of tests were repeated"
    if tuned.chatter > plan.chatter:
        least = min(point.chatter for point in tuned.front)
        yield (
            f"no gains that hold have c_u of {plan.chatter:g} or less with {1e3 * tests.rest.noise:.2g} mV "
            f"of noise (least of {tuned.tried} sets: {least:.3g}); those of least error up to "
            f"{tuned.chatter:.3g} are taken; --max-chatter sets a limit that is kept in any case"
        )


def as_dict(result: Result) -> dict[str, Any]:
    """For JSON."""
    verified, tests = result.verification, result.tests
    valve = tests.plant
    return {
        "limits": plain(result.plan.limits),
        "rest": plain(tests.rest),
        "static": plain(tests.static),
        "response": tests.response.as_dict(),
        "valve": {
            **plain(valve.model),
            "static_gain": valve.model.static_gain,
            "delay_s": valve.delay,
            "offset": valve.offset,
            "friction": plain(valve.friction),
            "presliding": valve.presliding,
            "solenoids": plain(valve.magnet),
            "error": valve.error,
        },
        "chatter_limit": {"wanted": result.plan.chatter, "kept": result.tuned.chatter},
        "law": result.tuned.law,
        "tuned": tuner.as_dict(result.tuned),
        "applied": result.applied,
        "verification": {
            "measured": plain(verified.measured),
            "simulated": plain(verified.expected),
            "simulated_before": plain(verified.former),
            "unseen_valves": verification.as_dict(result.tuned.chosen.verified),
        },
        "notes": result.notes,
        "seconds": result.seconds,
        "pauses": result.pauses,
        "way_s": {"median": result.way.p50, "p99": result.way.p99},
    }
