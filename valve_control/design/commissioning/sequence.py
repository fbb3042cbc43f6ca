# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Goes through a commissioning step by step, and brings the parameters from before back if it fails.

While it goes on, the controller itself keeps the limits: ``u_max`` is that of the voltage, ``lvdt.limit``
that of the travel, and a command that falls silent leads to neutral. So they hold whatever becomes of this
process.
"""

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np

from valve_control import interrupts, priority
from valve_control.control.analysis.timing import Spread, spread
from valve_control.design.commissioning import backup, courses, gains, model, plant, small_signal, statics
from valve_control.design.commissioning.bench import (
    Begun,
    Bench,
    Course,
    Fault,
    Pause,
    Record,
    Swings,
    joined,
)
from valve_control.design.commissioning.gains import TunedGains, Verification, VerifyingMotion
from valve_control.design.commissioning.plan import Plan, limiting
from valve_control.design.commissioning.plant import Plant
from valve_control.design.commissioning.statics import Friction, Rest, Static
from valve_control.design.identification import dead_time, lvdt
from valve_control.design.identification.response import Response
from valve_control.design.tuning import tuner, verification
from valve_control.design.tuning.tuner import Tuned
from valve_control.parameter import ParameterError, Values, number

SPRING = 0.5  # s  in which the spring centres the spool
STILL, NOISE = 2.0, 2.0  # s and windows of readings that tell the noise: at rest, the larger of both
RATE = 0.4  # 1/s  times the limit of the voltage: rate of the triangle
TURNS = 4  # of the triangle
# Times as wide as usual, the boxes of valves around the model that gains are sought for: the second one where
# those for the first do not hold.
BOXES = (1.0, 2.0)
DOUBTED = (2.0, 3.0)  # likewise, where the model does not explain the readings
AGAIN = 3  # times that a stretch which a pause has spoiled is repeated
RESTS = 10  # times that a rest is tried, which is no test
APART = 1.0  # s  between two reports of a pause, below which they are about the same one
# Of both verification runs: limits, and that each command counts as it comes.
SAME = (
    "u_max", "lvdt.limit", "command_limit", "command_timeout", "command.bridge", "command.lag",
)  # fmt: skip
PID = "pid"  # that is tuned beside another law
QUIETER = ((1.0, "again"), (0.5, "once more"))  # power of what is too loud, by which the limit is lowered
NAMED = 3  # parts of the tests that a note names as not explained
# Of the step "model", in percent, what is done when the fits of the response are, and when the valve is.
RESPONSE, VALVE, WHOLE = 25.0, 95.0, 100.0
REST, SLOW, SINE = "noise at rest", "slow triangle", "stepped sine"  # the tests
SEARCH = "search"  # during which pauses are counted
T = TypeVar("T")


class Tests(NamedTuple):
    """What the tests of a valve told, for any law."""

    rest: Rest
    slow: Record
    static: Static
    sine: Record
    response: Response
    plant: Plant


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
    pauses: dict[str, int]  # by step
    way: Spread  # s  from a reading to its voltage in the tests; NaN: not known

    @property
    def tests(self) -> Tests:
        """What the tests told, with which another law may be commissioned."""
        return Tests(self.rest, self.slow, self.static, self.sine, self.response, self.plant)


AS_BEFORE = "all its parameters are as before"


class Refused(RuntimeError):
    """The user does not want to go on."""


class Steps(Protocol):
    """Who goes through the steps with the valve."""

    def confirm(self, text: str) -> bool:
        """Whether to go on with a step; ``text`` says what it does."""

    def progress(self, name: str, done: float, total: float) -> None:
        """``done`` of ``total`` of the step ``name`` are over."""

    def tested(self, name: str, record: Record) -> None:
        """The test ``name`` is whole."""

    def found(self, valve: Values) -> None:
        """The valve as parameters of the simulated one, as soon as it is known."""

    def refused(self, changes: Values, reason: str) -> None:
        """Gains that are not accepted, and why."""


@contextmanager
def reversible(bench: Bench, before: Values, said: Callable[[str], None]) -> Iterator[None]:
    """At whatever ends the block: 0 V at once, then the parameters ``before``, and active if it was.

    ``said`` gets what became of it.
    """
    active = bench.active
    try:
        yield
    except BaseException:
        with interrupts.held_back():
            try:
                bench.off()
                said("the controller was switched to 0 V")
            except Fault as fault:
                said(f"the controller could not be switched off: {fault}")
            restore(bench, before)
            said(AS_BEFORE)
            if active:
                try:
                    bench.on()
                    said("it is active, as before")
                except Fault as fault:
                    said(f"it was activated again, as before: {fault}")
        raise


def restore(bench: Bench, before: Values) -> int:
    """Set all parameters ``before``; returns how many differed. Raises Fault if they are not back."""
    return _bring_to(bench, before, "set back")


def _bring_to(bench: Bench, wanted: Values, done: str = "set") -> int:
    """Set what differs from all the parameters ``wanted``; returns how many. Raises Fault."""
    changes = backup.differences(bench.values(), wanted)
    if changes:
        bench.apply(changes)
        left = backup.differences(bench.values(), wanted)
        if left:
            raise Fault(f"{', '.join(left)} could not be {done}")
    return len(changes)


def run(
    bench: Bench,
    plan: Plan,
    before: Values,
    steps: Steps,
    tests: Tests | None = None,
    records: Mapping[str, Record] | None = None,
) -> Result:
    """Commission the valve of ``bench``, whose controller has the parameters ``before``.

    ``tests`` that were made of this valve within the same limits are not made again, nor are those of which
    there are ``records``.

    Raises Fault, ParameterError (one sentence) or Refused; the controller then is as it was left: call it
    within ``reversible``.
    """
    return _Commissioning(bench, plan, before, steps, records).run(tests)


class _Commissioning:
    """One valve on its way from the parameters ``before`` to new ones."""

    def __init__(
        self,
        bench: Bench,
        plan: Plan,
        before: Values,
        steps: Steps,
        records: Mapping[str, Record] | None = None,
    ) -> None:
        self._bench, self._plan, self._before, self._steps = bench, plan, before, steps
        self._records = dict(records or {})
        self._pauses: Counter[str] = Counter()
        self._paused = -math.inf  # s, the last report of one
        self._limits, self._period = plan.limits, number(before, "sample_period")
        self._seconds: dict[str, float] = {}
        self._still = max(STILL, NOISE * lvdt.WINDOW * self._period)  # s
        self._percent = 0.0  # of the step "model", that were told

    def run(self, tests: Tests | None) -> Result:
        period, before = self._period, self._before
        self._ask(
            f"0 V; the controller gets its limits (±{self._limits.voltage:g} V, reading within "
            f"±{self._limits.travel:g} V) and the law open_loop; then {self._still:g} s at 0 V"
        )
        self._bench.off()
        self._open_loop()
        if tests is None:
            tests = self._tested()
        rest, found = tests.rest, tests.plant
        with self._timed("model"):
            self._steps.found(
                plant.values(found, rest, period, number(before, "u_max"), self._plan.sensor_delay)
            )
            known = model.Known(
                found, rest, period, number(before, "u_max"), self._plan.law, self._plan.sensor_delay
            )
            self._modelled(WHOLE)
        made, verified, notes = self._gains(found, known, rest)
        self._ask("the new gains stay; voltage and travel get their limits from before back")
        final = {**before, **made.chosen}
        _bring_to(self._bench, final)
        self._bench.watch(
            self._limits._replace(voltage=number(before, "u_max"), travel=number(before, "lvdt.limit"))
        )
        answers = [record.latency for record in (tests.slow, tests.sine) if record is not None]
        way = spread(np.concatenate([np.empty(0), *answers]))
        notes = [
            *tests.response.notes,
            *_unexplained(found, tests.slow, tests.sine, self._planned(tests.rest, tests.static), rest),
            *known.notes,
            *notes,
            *_ended(verified),
            *dead_time.way_notes(way),
            *_paused(self._pauses),
        ]
        notes += _louder(self._plan, made.tuned, rest)
        return Result(
            plan=self._plan,
            before=before,
            rest=rest,
            slow=tests.slow,
            static=tests.static,
            friction=found.friction,
            sine=tests.sine,
            response=tests.response,
            plant=found,
            tuned=made.tuned,
            applied=backup.differences(before, final),
            verification=verified,
            notes=notes,
            seconds=self._seconds,
            pauses=dict(self._pauses),
            way=way,
        )

    def _tested(self) -> Tests:
        """Noise, friction and response of the valve in open loop, and the plant that is fitted to them."""
        still = self._test(
            REST,
            lambda first, begun: courses.rest(self._still, begun, first),
            lambda first, begun: self._still - first * courses.PIECE,
        )
        rest = statics.at_rest(still)
        slow = self._triangle()
        static = statics.slow(slow, rest, self._limits)
        planned = self._planned(rest, static)
        sine = self._sine(planned)
        with self._timed("model"):
            self._modelled(0.0)
            response, fits, friction = self._background(
                lambda told: small_signal.linear(
                    sine, planned, static, rest, lambda done, total: told(RESPONSE * done / total)
                ),
                self._modelled,
            )
            found = self._background(
                lambda told: plant.fitted(
                    [slow, sine], fits, friction, static.offset, rest,
                    lambda done, total: told(RESPONSE + (VALVE - RESPONSE) * done / total),
                    self._plan.threads, lambda: small_signal.richer(response),
                ),
                self._modelled,
            )  # fmt: skip
            self._modelled(VALVE)
        return Tests(rest, slow, static, sine, response, found)

    def _planned(self, rest: Rest, static: Static) -> small_signal.Plan:
        return small_signal.plan(self._limits, rest, static, self._period)

    def _open_loop(self) -> None:
        """From inactive to 0 V: open loop within the limits, the other parameters as before."""
        _bring_to(self._bench, {**self._before, **limiting(self._before, self._limits)})
        self._at_rest(SPRING)
        self._bench.apply({"lvdt.limit": self._limits.travel})

    def _triangle(self) -> Record:
        limits, rate = self._limits, RATE * self._limits.voltage
        return self._test(
            SLOW,
            lambda first, begun: courses.triangle(limits, rate, TURNS, begun, self._period, first),
            lambda first, turned: courses.triangle_time(limits, rate, TURNS - max(0, first - 1), turned),
            f"a slow triangle of the voltage up to ±{limits.voltage:g} V, turned at {courses.REACH:.0%} of "
            "the travel",
        )

    def _sine(self, planned: small_signal.Plan) -> Record:
        length = planned.steps[-1].end
        return self._test(
            SINE,
            lambda first, begun: courses.stepped_sine(
                self._limits, planned.steps, planned.amplitude, planned.offset, begun, self._period, first
            ),
            lambda first, begun: length - planned.steps[first].start,
            f"{length:.0f} s of sines of {planned.amplitude:.2g} V from {planned.steps[0].frequency:g} to "
            f"{planned.steps[-1].frequency:g} Hz",
        )

    def _gains(
        self, found: Plant, known: model.Known, rest: Rest
    ) -> tuple[TunedGains, Verification, list[str]]:
        """Gains that hold, also on the valve, and notes on those that did not. Raises ParameterError."""
        refusals: list[str] = []
        boxes = BOXES if found.error <= plant.EXPLAINED else DOUBTED
        for wider in boxes:
            several, missing = self._tuned(found, known, rest, wider, refusals)
            texts: list[str] = []
            for made in several:
                if texts and wider != boxes[-1] and not gains.rivals(made, several[0]):
                    break  # the law deserves its second search first
                reasons = made.tuned.chosen.verified.reasons
                if not reasons:
                    verified, reasons = self._verified(made, found.error > plant.EXPLAINED)
                    if verified is not None and not reasons:
                        told = [_taken_at_last(wider, text) for text in refusals]
                        told += [_taken_instead(made.tuned.law, text) for text in texts]
                        told += [made.note] if made.note else []
                        return made, verified, [*missing, *told, *gains.beside(several)]
                    self._bench.off()
                    if wider != boxes[-1] or made is not several[-1]:
                        self._open_loop()
                texts.append("; ".join(reasons))
                self._steps.refused(made.chosen, texts[-1])
            named = zip(several, texts, strict=False)
            refusals.append("; ".join(_of(self._plan.law, made, text) for made, text in named))
        raise ParameterError(_not_accepted(refusals, boxes[-1]))

    def _tuned(
        self, found: Plant, known: model.Known, rest: Rest, wider: float, refusals: list[str]
    ) -> tuple[list[TunedGains], list[str]]:
        """Gains of the law and of a PID beside it, the better first, and a sentence about each that failed.

        Raises ParameterError, where both failed.
        """
        tried = f"{self._plan.budget} sets of gains of {self._plan.law} are tried in simulation"
        if refusals:
            tried = (
                f"these gains are not accepted ({refusals[-1]}); {tried}, for valves {wider:g} times as far "
                "from the model"
            )
        self._ask(f"{tried}; the valve stays at 0 V")
        made: list[TunedGains] = []
        failed: dict[str, ParameterError] = {}
        for law in dict.fromkeys((self._plan.law, *([] if self._plan.alone else [PID]))):
            with self._timed("tuning"):
                try:
                    made.append(self._searched(law, found, known, rest, wider))
                except ParameterError as error:
                    failed[law] = error
        if not made:
            first = failed[self._plan.law]
            if not refusals:
                raise first
            raise ParameterError(_not_accepted([*refusals, str(first)], wider)) from first
        missing = [f"{law} has no gains: {error}" for law, error in failed.items()]
        return sorted(made, key=gains.promised), missing

    def _searched(self, law: str, found: Plant, known: model.Known, rest: Rest, wider: float) -> TunedGains:
        """Gains of ``law``, of a quieter search if those of the first are loud. Raises ParameterError."""
        step = "tuning" if law == self._plan.law else f"tuning {law}"

        def searched(plan: Plan, step: str) -> TunedGains:
            def told(done: float, total: float) -> None:
                self._look()
                self._steps.progress(step, done, total)

            return self._background(
                lambda told: gains.tuned(plan, self._before, found, known, rest, wider, told), told
            )

        plan = self._plan._replace(law=law)
        made = searched(plan, step)
        if made.tuned.chosen.verified.reasons:
            return made
        loud = gains.loudness(plan, self._before, made)
        limit = plan.chatter if made.tuned.chatter is None else made.tuned.chatter
        if not gains.LOUD * limit < loud < math.inf:
            return made
        too_loud = gains.TOO_LOUD * limit
        tried: list[tuple[float, TunedGains]] = []
        for share, name in QUIETER if loud > too_loud else QUIETER[:1]:
            lower = plan._replace(chatter=limit * (limit / loud) ** share, firm=True)
            try:
                again = searched(lower, f"{step} {name}")
            except ParameterError:  # the limit cannot be that low
                continue
            quiet = gains.loudness(plan, self._before, again)
            if again.tuned.chosen.verified.reasons or quiet >= loud:
                continue
            note = (
                f"a quieter search of {law} brought c_u of the simulated verification run from {loud:.3g} to "
            )
            again = again._replace(note=f"{note}{quiet:.3g}")
            if gains.rivals(again, made) and quiet <= too_loud:
                return again
            tried.append((quiet, again))
        return gains.quieter(made, loud, tried, too_loud)

    def _verified(self, made: TunedGains, doubted: bool) -> tuple[Verification | None, list[str]]:
        """The verification run, None if it ended early, and why the gains are not accepted.

        ``doubted``: the model does not explain the readings, so that the parameters from before are tried
        whatever the simulation says of them.
        """
        motion = gains.verifying_motion(made, self._period)
        length = len(motion.wanted) * self._period
        self._ask(
            f"the new gains of {made.tuned.law} are set, and the valve moves for {length:.0f} s in closed "
            "loop"
        )
        lead = {"reshaping.lead": self._before["reshaping.lead"]}  # of a law that chooses none
        self._bench.apply({**lead, **made.chosen, "command_limit": self._limits.travel})
        try:
            record = self._moved("verification", motion)
        except Swings as fault:
            return None, [str(fault)]
        verified = gains.judged(self._plan, self._before, made, motion, record)
        if not verified.reasons and gains.contends(self._plan, verified, doubted):
            verified = self._against_before(verified, motion)
        return verified, verified.reasons

    def _against_before(self, made: Verification, motion: VerifyingMotion) -> Verification:
        """``made`` judged by the same run with the parameters from before.

        Parameters that swing there, or do anything else that ends a run, are no rival. A fault that has
        another reason than them goes on with the new gains, and is raised then.
        """
        length = len(motion.wanted) * self._period
        self._ask(
            f"the parameters from before are set for {length:.0f} s of the same motion, because they may be "
            "as good as the new gains"
        )
        kept = self._bench.values()
        limits = {name: kept[name] for name in SAME}
        _bring_to(self._bench, {**self._before, **limits})
        try:
            record = self._moved("verification of before", motion)
        except Fault as fault:
            self._bench.off()
            _bring_to(self._bench, kept)
            self._bench.apply({"lvdt.limit": self._before["lvdt.limit"]})
            self._at_rest(STILL)
            self._bench.apply({"lvdt.limit": kept["lvdt.limit"]})
            return made._replace(ended=str(fault))
        _bring_to(self._bench, kept)
        return gains.against(self._plan, made, record)

    def _moved(self, name: str, motion: VerifyingMotion) -> Record:
        """Record of the judged part of ``motion``."""

        def course(first: int, begun: Begun) -> Course:
            rest = motion.since(first)
            return courses.motion(
                rest.wanted, self._period, rest.stretches[1:], lambda number, at: begun(first + number, at)
            )

        return self._drive(
            name,
            course,
            lambda first, begun: len(motion.since(first).wanted) * self._period,
            lambda record, first, end: gains.judged_part(motion.since(first), record, end),
        )

    def _test(
        self,
        name: str,
        course: Callable[[int, Begun], Course],
        about: Callable[[int, Sequence[float]], float],
        text: str = "",
    ) -> Record:
        """Record of the test ``name``, which is made unless there is one; ``text``: of the question."""
        if name not in self._records:
            if text:
                self._ask(text)
            self._records[name] = self._drive(name, course, about)
        self._steps.tested(name, self._records[name])
        return self._records[name]

    def _drive(
        self,
        name: str,
        course: Callable[[int, Begun], Course],
        about: Callable[[int, Sequence[float]], float],
        chosen: Callable[[Record, int, int], Record] = lambda record, first, end: record.part(0, end),
    ) -> Record:
        """Record of the step ``name``, of which a stretch that a pause spoils is repeated.

        ``course`` begins with a stretch, from rest; ``about``: how long [s] it takes from then on, by
        the times [s] at which stretches have begun; ``chosen``: of the record of a course that began with a
        stretch, what counts of it until a sample. Raises Fault.
        """
        parts: list[Record] = []
        first, tries, over = 0, 0, 0.0
        with self._timed(name):
            while True:
                marks = [(first, 0.0)]
                try:
                    if tries:
                        self._bench.off()
                        self._at_rest(SPRING)
                    record = self._driven(name, course, about, marks, over)
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
                    continue
                return joined([*parts, chosen(record, first, len(record.reading))])

    def _driven(
        self,
        name: str,
        course: Callable[[int, Begun], Course],
        about: Callable[[int, Sequence[float]], float],
        marks: list[tuple[int, float]],
        over: float,
    ) -> Record:
        """Record of a course; ``marks`` has its first stretch and gets the others. Raises Fault.

        ``over`` [s]: of the step before it.
        """
        first, _ = marks[0]

        def progress(done: float) -> None:
            total = over + about(first, [at for _, at in marks[1:]])
            self._steps.progress(name, min(over + done, total), total)

        begun = course(first, lambda stretch, at: marks.append((stretch, at)))
        record = self._bench.drive(begun, self._limits, progress)
        progress(math.inf)
        return record

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

    def _background(self, work: Callable[[Callable[..., None]], T], told: Callable[..., None]) -> T:
        """What ``work`` returns; over ROS it gives way to the loop. ``told`` gets its progress."""
        if self._plan.gives_way:
            return priority.in_background(work, told)
        return work(told)

    def _look(self) -> None:
        """Look at what has come during a search at 0 V; a pause is counted and nothing else."""
        try:
            self._bench.watch(self._limits)
        except Pause:
            now = time.monotonic()
            self._pauses[SEARCH] += now > self._paused + APART
            self._paused = now

    def _ask(self, text: str) -> None:
        if not self._steps.confirm(text):
            raise Refused("stopped by the user")

    def _modelled(self, percent: float) -> None:
        self._look()
        # A search that is longer than it was expected to be takes nothing back.
        self._percent = max(self._percent, percent)
        self._steps.progress("model", self._percent, WHOLE)

    @contextmanager
    def _timed(self, name: str) -> Iterator[None]:
        """Add the time of the block to that of the step ``name``."""
        began = time.monotonic()
        try:
            yield
        finally:
            self._seconds[name] = self._seconds.get(name, 0.0) + time.monotonic() - began


def _not_accepted(refusals: list[str], wider: float) -> str:
    """Why neither the first gains nor those for a box that is ``wider`` are accepted."""
    if len(refusals) == 1:
        return f"the gains are not accepted: {refusals[0]}"
    return (
        f"the gains are not accepted: {refusals[0]}; nor are those for valves {wider:g} times as far "
        f"from the model: {refusals[1]}"
    )


def _of(law: str, made: TunedGains, text: str) -> str:
    """``text`` about gains, with the name of another law than the one that is asked for."""
    return text if made.tuned.law == law else f"{made.tuned.law}: {text}"


def _taken_instead(law: str, refusal: str) -> str:
    return f"other gains promised more and were not accepted ({refusal}); those of {law} are in force"


def _taken_at_last(wider: float, refusal: str) -> str:
    return (
        f"the first gains were not accepted ({refusal}); those in force are for valves {wider:g} times as "
        "far from the model"
    )


def _unexplained(
    found: Plant, slow: Record, sine: Record, planned: small_signal.Plan, rest: Rest
) -> list[str]:
    """A sentence about what the model does not describe, and one about a spool that swings."""
    notes = []
    if found.error > plant.EXPLAINED:
        parts = [plant.Stretch("the slow triangle", 0, 0, len(slow.reading))]
        parts += [
            plant.Stretch(f"the sine of {one.frequency:.3g} Hz", 1, one.first, one.end)
            for one in small_signal.stretches(planned, sine)
        ]
        worst = plant.unexplained(found, [slow, sine], rest, parts)[:NAMED]
        told = ", ".join(f"{name} by {error:.2g} times" for name, error in worst)
        notes.append(
            f"the model misses the readings by {found.error:.2g} times what noise and "
            f"{plant.MODEL_ERROR:.0%} of the motion allow ({told}); models of second to fourth order with "
            "friction, offset and dead time were tried, and a valve with solenoids: the gains are judged "
            "by the running valve, and were "
            f"sought for valves {DOUBTED[0]:g} or {DOUBTED[-1]:g} times as far from the model as usual"
        )
    if found.magnet is not None:
        m = found.magnet
        notes.append(
            "a valve with solenoids describes the readings better than a linear one with friction: coil "
            f"{1e3 * m.coil:.2g} ms, hysteresis {m.hysteresis:.2g} V, gains of the sides "
            f"{m.positive:.3g} and {m.negative:.3g} times {m.gain:.3g} V/V, overlap {m.overlap:.2g} V"
        )
    elif found.presliding > 0.0:
        notes.append(
            "a linear valve whose friction has bristles describes the readings, and none without them: "
            f"presliding {1e3 * found.presliding:.2g} mV; such a spool may swing on its bristles"
        )
    return notes


def _paused(pauses: Mapping[str, int]) -> list[str]:
    """A sentence about pauses."""
    if not pauses:
        return []
    told = ", ".join(f"{name} {count}" for name, count in pauses.items())
    return [f"readings, controller or host paused ({told}): the stretches of tests were repeated"]


def _ended(made: Verification) -> list[str]:
    """A sentence about parameters from before that misbehaved."""
    if not made.ended:
        return []
    return [f"with the parameters from before the same motion was ended ({made.ended}): they are no rival"]


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
            "coherence": result.response.coherence,
        },
        "valve": {
            "numerator": list(found.model.numerator),
            "denominator": list(found.model.denominator),
            "static_gain": found.model.static_gain,
            "delay_s": found.delay,
            "offset": found.offset,
            "friction": found.friction._asdict(),
            "presliding": found.presliding,
            "solenoids": None if found.magnet is None else found.magnet._asdict(),
            "error": found.error,
        },
        "chatter_limit": {"wanted": result.plan.chatter, "kept": result.tuned.chatter},
        "law": result.tuned.law,
        "tuned": tuner.as_dict(result.tuned),
        "applied": result.applied,
        "verification": {
            "measured": made.measured._asdict(),
            "simulated": made.expected._asdict(),
            "measured_before": None if made.before is None else made.before._asdict(),
            "simulated_before": None if made.former is None else made.former._asdict(),
            "unseen_valves": verification.as_dict(result.tuned.chosen.verified),
        },
        "notes": result.notes,
        "seconds": result.seconds,
        "pauses": result.pauses,
        "way_s": {"median": result.way.p50, "p99": result.way.p99},
    }
