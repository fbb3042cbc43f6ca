"""Shadow replay: a controller sees the recorded command and LVDT and says which voltage it would have given.

With the recorded parameters this is the recorded controller once more, and gives its voltages bit for bit.
What it took in between two readings is known from source times; whether a command that was sent while a
reading was being answered came before or after is not: both are tried, and the recorded voltage decides.
"""

import math
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.bags.errors import BagError
from valve_control.parameters import build
from valve_control.parameters.table import CONTROLLER, ParameterError, Values, defaults, updated
from valve_control.recordings.cleaning import Samples, seconds
from valve_control.recordings.parameters import Change
from valve_control.recordings.recording import Valve
from valve_control.supervision.memory import agrees, recall
from valve_control.supervision.supervisor import Supervisor

Floats = npt.NDArray[np.float64]
Row = tuple[int, float, float, float]  # reading, command [V], recorded and shadow voltage [V]
TAKING = 60_000  # ns from taking commands to publishing the voltage, about
FIRST = 40  # voltages by which a beginning at rest is known
HOPELESS = 20  # samples in a row that differ, after which the recorded voltage no longer decides
QUEUE = 12  # readings, a little more than wait at most for a controller that stood still
HELD_BACK = 50  # commands that a reliable reader may hold back while it waits for a lost one
START = 40  # readings before the first voltage that it may answer
MOST = 45  # ways that are followed side by side
STOOD_STILL = "the controller's process stood still"
NEAR = 1e9  # ns, how far the reading after an account may be from it
REPORT = 10_000  # samples between two words of progress


class Shadow(NamedTuple):
    """Recorded and shadow voltage at each answered reading."""

    time: Floats  # s, from the first of them
    controller: str  # law at the beginning
    measurement: Floats  # V
    command: Floats  # V, the newest one taken, NaN before the first
    recorded: Floats  # V, NaN where the bag has no voltage
    voltage: Floats  # V
    faithful: bool  # whether the recorded parameters were used, all of them
    inferred: list[str]  # events that the bag does not hold and the voltage shows
    left_out: list[str]

    @property
    def differing(self) -> int:
        """Samples whose voltage is not that of the recording, bit for bit."""
        return int(np.count_nonzero(np.isfinite(self.recorded) & (self.voltage != self.recorded)))

    @property
    def first_difference(self) -> int | None:
        """The first of them."""
        where = np.flatnonzero(np.isfinite(self.recorded) & (self.voltage != self.recorded))
        return int(where[0]) if len(where) else None


def replay(valve: Valve, overrides: Mapping[str, Any], told: Callable[[int], None] | None = None) -> Shadow:
    """Shadow replay of one valve; ``overrides`` win over the recorded parameters.

    Raises BagError without readings or commands, ParameterError for parameters that do not fit together.
    """
    return _Replay(valve, overrides).run(told)


class Rows(NamedTuple):
    """Rows, newest first; ways share those that they have in common."""

    row: Row
    before: "Rows | None"

    def in_order(self) -> list[Row]:
        """Oldest first."""
        rows: list[Row] = []
        at: Rows | None = self
        while at is not None:
            rows.append(at.row)
            at = at.before
        return rows[::-1]


class Path(NamedTuple):
    """One way in which the recording can have come about."""

    reading: int  # the next one
    taken: int  # commands
    memory: Any  # of the supervisor
    rows: "Rows | None"  # since there is more than one way
    notes: tuple[str, ...]  # events that it supposes, likewise


class Attempt(NamedTuple):
    """What may have led to a voltage."""

    reading: int  # that it answers, -1 for none
    next: int  # the reading after it
    note: str  # an event that the bag does not hold
    act: Callable[[], float]


class _Replay:
    def __init__(self, valve: Valve, overrides: Mapping[str, Any]) -> None:
        for part in ("spool_position", "spool_command"):
            if part not in valve.recorded or len(valve.recorded[part].time) == 0:
                raise BagError(f"{valve.name} has no {part}, so no controller can be replayed on it")
        self._left_out: list[str] = []
        self._valve = valve
        self._overrides = dict(overrides)
        self._readings = valve.recorded["spool_position"]
        self._commands = valve.recorded["spool_command"]
        self._voltages = valve.recorded.get("valve_voltage")
        self._inferred: list[str] = []
        self._supervisor = Supervisor()
        self._values = self._initial_values()
        self._changes = list(valve.controller.changes) if valve.controller is not None else []
        node = valve.controller
        known = node is not None and node.missing == 0 and not self._left_out
        self._faithful = known and not overrides and self._voltages is not None
        if not known:
            self._left_out.append(
                "not all of the recorded controller's parameters are known: defaults stand for the others"
            )
        self._law = build.word(self._values, "controller")
        self._lockstep = self._values["lockstep"] is True
        self._stamps = self._readings.time.tolist()
        self._values_read = self._readings.value.tolist()
        self._numbers = self._readings.sequence.tolist()
        self._numbered = bool(np.any(self._readings.sequence))
        self._command_stamps = self._commands.time.tolist()
        self._command_values = self._commands.value.tolist()
        self._sent = self._voltages.time.tolist() if self._voltages is not None else []
        self._taken = 0  # commands
        self._wrong = 0  # voltages in a row that are not the recorded ones
        self._silences = 0
        self._adopted = 0  # accounts that no way led to, though the voltages agreed
        self._current: Any = None  # what the supervisor remembers now, if that is known
        self._events = (
            ("the upper level left", self._supervisor.command_gone),
            ("~/reset was called", self._supervisor.reset),
            ("the controller began anew", self._supervisor.start),
        )
        self._u_max = build.number(self._values, "u_max")
        self._period_ns = build.number(self._values, "sample_period") * 1e9

    def _initial_values(self) -> Values:
        node = self._valve.controller
        values = defaults(CONTROLLER)
        if node is not None:
            values, refused = node.table_values(node.initial)
            self._left_out += refused
        elif "sample_period" not in self._overrides:
            values["sample_period"] = self._valve.period
        return updated(CONTROLLER, values, self._overrides)

    def run(self, told: Callable[[int], None] | None) -> Shadow:
        self._supervisor.apply(self._values, build.law_params(self._values))
        rows = list(self._with_voltages(told) if self._sent else self._without_voltages(told))
        if not rows:
            raise BagError(f"{self._valve.name}: no voltage answers any reading")
        if self._wrong >= HOPELESS:
            self._left_out.append(
                f"{HOPELESS} voltages in a row differ from the recording: from there on commands are taken "
                "by their source times alone, until the controller's next account of what it remembers"
            )
        if self._silences:
            self._left_out.append(
                f"{self._silences} voltages answer no reading (0 V while the LVDT was silent)"
            )
        if self._adopted:
            self._left_out.append(
                f"{self._adopted} times the controller's account told more than the voltages: taken from it"
            )
        used = np.array([row[0] for row in rows])
        unseen = int(np.sum(np.diff(used) - 1))
        if unseen:
            self._left_out.append(f"{unseen} readings were not seen by the controller")
        command, recorded, voltage = (np.array([row[i] for row in rows]) for i in (1, 2, 3))
        time = seconds(self._readings.time[used], int(self._readings.time[used[0]]))
        if self._lockstep:
            time = np.arange(len(used), dtype=np.float64) * build.number(self._values, "sample_period")
        return Shadow(
            time,
            self._law,
            self._readings.value[used],
            command,
            recorded,
            voltage,
            self._faithful,
            self._inferred,
            self._left_out,
        )

    def _newest_command(self) -> float:
        return self._command_values[self._taken - 1] if self._taken else np.nan

    def _without_voltages(self, told: Callable[[int], None] | None) -> Iterator[Row]:
        """Each reading in turn, when it was sent."""
        for reading, moment in enumerate(self._stamps):
            for change in self._changes_before(moment):
                self._apply(change)
            self._give(self._sent_before(moment))
            voltage = self._supervisor.sample(self._values_read[reading], self._number(reading))
            yield reading, self._newest_command(), np.nan, voltage
            if told is not None and reading % REPORT == REPORT - 1:
                told(REPORT)

    def _with_voltages(self, told: Callable[[int], None] | None) -> Iterator[Row]:
        """The reading that each recorded voltage answers, when it was answered."""
        assert self._voltages is not None
        begin, paths = self._beginning()
        accounts = deque(account for account in self._valve.memories if account[0] > self._sent[begin])
        wanted = self._voltages.value.tolist()
        last = self._sent[begin]
        for k in range(begin, len(wanted)):
            moment = self._sent[k]
            changes = self._changes_before(moment)
            elapsed = 0.0 if self._lockstep else (moment - last) * 1e-9
            last = moment
            paths = self._step(paths, changes, moment, elapsed, wanted[k])
            until = self._sent[k + 1] if k + 1 < len(wanted) else math.inf
            while accounts and accounts[0][0] < until:
                time, text = accounts.popleft()
                if time > moment and self._faithful:
                    paths = self._compared(paths, time, text)
            if len(paths) == 1:
                yield from self._settled(paths[0])
                paths = [paths[0]._replace(rows=None, notes=())]
            if told is not None and k % REPORT == REPORT - 1:
                told(REPORT)
        yield from self._settled(paths[0])

    def _compared(self, paths: list[Path], time: int, text: str) -> list[Path]:
        """The way that agrees with the account of ``time`` [ns]; if none does, the account itself."""
        for path in paths:
            self._supervisor.restore(path.memory)
            if agrees(self._supervisor, text):
                recall(self._supervisor, text)
                memory = self._current = self._supervisor.snapshot()
                return [path._replace(memory=memory)]
        self._supervisor.restore(paths[0].memory)
        self._current = paths[0].memory
        if not recall(self._supervisor, text):
            return paths
        self._adopted += self._wrong == 0
        self._wrong = 0
        return [self._path_from(time)._replace(rows=paths[0].rows, notes=paths[0].notes)]

    def _beginning(self) -> tuple[int, list[Path]]:
        """The first voltage to answer and how it may have come about: at rest, or after an account."""
        assert self._voltages is not None
        at_rest = self._paths_at_rest()
        if not self._faithful or self._explains_the_first(at_rest):
            return 0, at_rest
        changes, values = list(self._changes), self._values
        complete = max(map(self._complete_from, (self._readings, self._voltages, self._commands)))
        for time, text in self._valve.memories:
            begin = bisect_left(self._sent, time)
            if time < complete or begin == len(self._sent):
                continue
            for change in self._changes_before(time):
                self._apply(change)
            if recall(self._supervisor, text) and self._has_next_reading():
                self._left_out.append(
                    f"{begin} voltages come before the controller's first account of what it remembers, and "
                    "not from its beginning"
                )
                return begin, [self._path_from(time)]
        self._left_out.append(
            f"the recording begins with voltage {self._voltages.sequence[0]} of the controller; what it "
            "remembered then is not known"
        )
        self._changes, self._values, self._current = changes, values, None
        return 0, at_rest

    def _complete_from(self, samples: Samples) -> int:
        """Since when [ns] nothing is missing of a topic whose first messages may not have been recorded."""
        first = int(samples.time[0])
        return 0 if samples is self._commands and samples.sequence[0] <= 1 else first

    def _has_next_reading(self) -> bool:
        """Whether the reading after the one that the supervisor had last is in the bag."""
        number, _ = self._supervisor.last_inputs
        return not self._numbered or number is None or number + 1 >= self._numbers[0]

    def _paths_at_rest(self) -> list[Path]:
        memory = self._current = self._supervisor.snapshot()
        newest = max(0, bisect_left(self._stamps, self._sent[0]) - 1)
        oldest = max(0, newest - START) if self._faithful and not self._lockstep else newest
        return [Path(reading, 0, memory, None, ()) for reading in range(newest, oldest - 1, -1)]

    def _explains_the_first(self, paths: list[Path]) -> bool:
        """Whether a controller that begins at rest gives the first voltages."""
        assert self._voltages is not None
        begin, changes, values, last = paths[0].memory, list(self._changes), self._values, self._sent[0]
        for moment, wanted in zip(self._sent[:FIRST], self._voltages.value[:FIRST].tolist(), strict=True):
            elapsed = 0.0 if self._lockstep else (moment - last) * 1e-9
            last = moment
            paths = self._step(paths, self._changes_before(moment), moment, elapsed, wanted)
        wrong, self._wrong, self._changes, self._values = self._wrong, 0, changes, values
        self._supervisor.restore(begin)
        self._current = begin
        return wrong == 0

    def _path_from(self, time: int) -> Path:
        """Where the supervisor is now, which has just recalled what it remembered at ``time`` [ns]."""
        number, command = self._supervisor.last_inputs
        reading = bisect_left(self._stamps, time)
        if self._numbered and number is not None:
            after = bisect_right(self._numbers, number)
            if abs(self._time(after) - time) < NEAR:  # numbers begin anew with the node that gives them
                reading = after
        taken = self._sent_before(time)
        while taken > 0 and command is not None and self._command_values[taken - 1] != command:
            taken -= 1
        memory = self._current = self._supervisor.snapshot()
        return Path(reading, 0 if command is None else taken, memory, None, ())

    def _settled(self, path: Path) -> Iterator[Row]:
        """What is certain of a path."""
        for row in path.rows.in_order() if path.rows is not None else ():
            if row[0] >= 0:
                yield row
            else:
                self._silences += 1
        for note in path.notes:
            if note and (not self._inferred or self._inferred[-1].partition(": ")[2] != note):
                self._inferred.append(f"before sample {self._supervisor.samples}: {note}")

    def _step(
        self, paths: list[Path], changes: list[Change], moment: int, elapsed: float, wanted: float
    ) -> list[Path]:
        """All that ``paths`` can become under inputs that give ``wanted`` [V]; the likeliest first."""
        decides = self._faithful and self._wrong < HOPELESS
        # A law that takes over gives the voltage of the one before, whatever it is told.
        tells = wanted != 0.0 and abs(wanted) < self._u_max and not changes
        found: dict[tuple[Any, ...], Path] = {}

        def follow(path: Path, attempt: Attempt) -> Path:
            now, voltage = self._tried(path, changes, attempt, wanted)
            if voltage == wanted:
                found.setdefault((now.reading, now.taken, now.notes), now)
            return now

        plain = [follow(path, self._plain(path, moment, elapsed)) for path in paths]
        if not decides:
            return plain[:1]
        for path in paths:
            # A controller may be deaf for the first commands, which shows when they begin to move.
            if path.taken == 0 < self._likely(path, moment) and self._time(path.reading) < moment:
                follow(path, self._answer(path.reading, 0, elapsed))
        # Where there are several ways already, or the voltage tells, only what these leave open is tried.
        clear = tells or len(paths) > 1 or self._time(paths[0].reading + 1) >= moment
        if len(paths) > 1 and not tells:
            # Each of them may have lost a reading more.
            for path in paths:
                if self._time(path.reading + 1) < moment and len(found) < MOST:
                    follow(path, self._answer(path.reading + 1, self._likely(path, moment), elapsed))
        if not (found and clear):
            others = ((path, attempt) for path in paths for attempt in self._others(path, moment, elapsed))
            for path, attempt in others:
                follow(path, attempt)
                if len(found) >= MOST or (found and tells):
                    break
        if found:
            self._wrong = 0
            return list(found.values())[:MOST]
        self._wrong += 1
        return plain[:1]

    def _tried(
        self, path: Path, changes: list[Change], attempt: Attempt, wanted: float
    ) -> tuple[Path, float]:
        supervisor = self._supervisor
        if self._current is not path.memory:
            supervisor.restore(path.memory)
        self._taken = path.taken
        for change in changes:
            self._apply(change)
        voltage = attempt.act()
        memory = self._current = supervisor.snapshot()
        row = (attempt.reading, self._newest_command(), wanted, voltage)
        notes = (*path.notes, attempt.note) if attempt.note and attempt.note not in path.notes else path.notes
        return Path(attempt.next, self._taken, memory, Rows(row, path.rows), notes), voltage

    def _plain(self, path: Path, moment: int, elapsed: float) -> Attempt:
        """What happened most likely."""
        reading = path.reading
        queue = QUEUE * self._period_ns
        while (
            not self._lockstep and moment - self._time(reading) > queue and self._time(reading + 1) < moment
        ):
            reading += 1
        if self._time(reading) >= moment:
            return Attempt(-1, reading, "", partial(self._supervisor.silence, elapsed))
        return self._answer(reading, self._likely(path, moment), elapsed)

    def _likely(self, path: Path, moment: int) -> int:
        """How many commands had been taken."""
        return max(self._sent_before(moment if self._lockstep else moment - TAKING), path.taken)

    def _others(self, path: Path, moment: int, elapsed: float) -> Iterator[Attempt]:
        """What else may have happened: more or fewer commands, readings that were not seen, events."""
        silence, reading = self._supervisor.silence, path.reading
        stood_still = partial(silence, elapsed, stalled=True)
        waiting = min(bisect_left(self._stamps, moment) - reading, QUEUE)
        if waiting < 1:
            return
        most, likely = max(self._sent_before(moment), path.taken), self._likely(path, moment)
        for count in (path.taken, *range(most, max(path.taken, most - HELD_BACK), -1)):
            if count != likely:
                yield self._answer(reading, count, elapsed)
        yield Attempt(reading, reading + 1, STOOD_STILL, stood_still)
        for later in range(reading + 1, reading + waiting):
            yield self._answer(later, likely, elapsed)
            yield Attempt(later, later + 1, STOOD_STILL, stood_still)
        yield Attempt(-1, reading, "", partial(silence, elapsed))
        for note, event in self._events:
            yield Attempt(
                reading, reading + 1, note, partial(self._sample_after, event, likely, reading, elapsed)
            )

    def _answer(self, reading: int, count: int, elapsed: float) -> Attempt:
        return Attempt(reading, reading + 1, "", partial(self._sample, count, reading, elapsed))

    def _sample(self, count: int, reading: int, elapsed: float) -> float:
        self._give(count)
        return self._supervisor.sample(self._values_read[reading], self._number(reading), elapsed)

    def _sample_after(self, event: Callable[[], None], count: int, reading: int, elapsed: float) -> float:
        event()
        return self._sample(count, reading, elapsed)

    def _time(self, reading: int) -> float:
        return self._stamps[reading] if reading < len(self._stamps) else math.inf

    def _number(self, reading: int) -> int | None:
        return self._numbers[reading] if self._numbered else None

    # What the controller took in before a reading

    def _changes_before(self, moment: int) -> list[Change]:
        due = []
        while self._changes and self._changes[0].time < moment:
            due.append(self._changes.pop(0))
        return due

    def _apply(self, change: Change) -> None:
        wanted = {name: value for name, value in change.values.items() if name not in self._overrides}
        known = {parameter.name for parameter in CONTROLLER}
        try:
            values = updated(CONTROLLER, self._values, {k: v for k, v in wanted.items() if k in known})
            self._supervisor.apply(values, build.law_params(values))
        except ParameterError as error:
            self._left_out.append(f"recorded change not used: {error}")
            return
        self._values = values

    def _sent_before(self, moment: int) -> int:
        return bisect_left(self._command_stamps, moment)

    def _give(self, count: int) -> None:
        """Hand on commands until ``count`` of them are taken."""
        while self._taken < count:
            self._supervisor.command(self._command_values[self._taken])
            self._taken += 1
