"""Shadow replay: a controller sees the recorded command and LVDT and says which voltage it would have given.

The controller's journal tells which reading it answered under which command, and all else that it took in:
with the recorded parameters a shadow is that controller once more, and gives its voltages bit for bit.
Without a journal, commands are taken by the times at which they were sent.
"""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Mapping
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.bags.errors import BagError
from valve_control.parameters import build
from valve_control.parameters.table import CONTROLLER, ParameterError, Values, defaults, updated
from valve_control.recordings.cleaning import Samples, seconds
from valve_control.recordings.parameters import Change
from valve_control.recordings.recording import Valve
from valve_control.supervision.journal import COLUMNS, Block, Event, observe
from valve_control.supervision.memory import recall, remember, row_of
from valve_control.supervision.supervisor import Supervisor

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Row = tuple[int, float, float, float, float]  # time [ns], command, reading, recorded and shadow voltage [V]
EVENT, COMMAND, READING, NUMBER, ELAPSED, VOLTAGE = range(1, len(COLUMNS))
TAKING = 60_000  # ns from taking commands to publishing the voltage, about
PUBLISHED = 50_000_000  # ns after which new parameters have been published
END = np.iinfo(np.int64).max  # ns
REPORT = 10_000  # samples between two words of progress


class Shadow(NamedTuple):
    """Recorded and shadow voltage at each step of the controller."""

    time: Floats  # s, from the first of them
    controller: str  # law at the beginning
    measurement: Floats  # V, NaN where the LVDT was silent
    command: Floats  # V, the newest one taken, NaN before the first
    recorded: Floats  # V, NaN where the bag has no voltage
    voltage: Floats  # V
    faithful: bool  # whether the recorded parameters were used, all of them
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
    """Shadow replay of one valve, loaded with its journal; ``overrides`` win over the recorded parameters.

    Raises BagError without readings or commands, ParameterError for parameters that do not fit together.
    """
    for part in ("spool_position", "spool_command"):
        if part not in valve.recorded or len(valve.recorded[part].time) == 0:
            raise BagError(f"{valve.name} has no {part}, so no controller can be replayed on it")
    return (_ByJournal if valve.journal else _ByTimes)(valve, overrides).run(told)


class _Replay:
    """A supervisor with the parameters of each moment."""

    def __init__(self, valve: Valve, overrides: Mapping[str, Any]) -> None:
        self._left_out: list[str] = []
        self._valve = valve
        self._overrides = dict(overrides)
        self._commands = valve.recorded["spool_command"]
        self._voltages = valve.recorded.get("valve_voltage")
        self._values = self._initial_values()
        self._supervisor = self._at_rest()
        node = valve.controller
        self._changes = list(node.changes) if node is not None else []
        known = node is not None and node.missing == 0 and not self._left_out
        self._faithful = known and not overrides
        if not known:
            self._left_out.append(
                "not all of the recorded controller's parameters are known: defaults stand for the others"
            )
        self._law = self._supervisor.name

    def _initial_values(self) -> Values:
        node = self._valve.controller
        values = defaults(CONTROLLER)
        if node is not None:
            values, refused = node.table_values(node.initial)
            self._left_out += refused
        elif "sample_period" not in self._overrides:
            values["sample_period"] = self._valve.period
        return updated(CONTROLLER, values, self._overrides)

    def _at_rest(self) -> Supervisor:
        supervisor = Supervisor()
        supervisor.apply(self._values, build.law_params(self._values))
        return supervisor

    def run(self, told: Callable[[int], None] | None) -> Shadow:
        rows: list[Row] = []
        for row in self._rows():
            rows.append(row)
            if told is not None and len(rows) % REPORT == 0:
                told(REPORT)
        if not rows:
            raise BagError(f"{self._valve.name}: nothing can be replayed: {'; '.join(self._left_out)}")
        stamp = np.array([row[0] for row in rows], dtype=np.int64)
        command, measurement, recorded, voltage = (np.array(c) for c in list(zip(*rows, strict=True))[1:])
        time = seconds(stamp, int(stamp[0]))
        if self._values["lockstep"] is True:
            time = np.arange(len(rows), dtype=np.float64) * build.number(self._values, "sample_period")
        faithful = self._faithful and bool(np.any(np.isfinite(recorded)))
        return Shadow(time, self._law, measurement, command, recorded, voltage, faithful, self._left_out)

    def _rows(self) -> Iterator[Row]:
        raise NotImplementedError

    def _apply_changes(self, until: int) -> int:
        """Take the changes before ``until`` [ns] into use; returns how many there were."""
        due: list[Change] = []
        while self._changes and self._changes[0].time < until:
            due.append(self._changes.pop(0))
        names = {parameter.name for parameter in CONTROLLER}
        for change in due:
            wanted = {
                name: value
                for name, value in change.values.items()
                if name in names and name not in self._overrides
            }
            try:
                values = updated(CONTROLLER, self._values, wanted)
                self._supervisor.apply(values, build.law_params(values))
            except ParameterError as error:
                self._left_out.append(f"recorded change not used: {error}")
                continue
            self._values = values
        return len(due)


class _ByJournal(_Replay):
    """What the controller's journal says that it took in, in that order."""

    def _rows(self) -> Iterator[Row]:
        blocks = self._valve.journal
        self._applied = np.concatenate([b.time[b.rows[:, EVENT] == Event.PARAMETERS] for b in blocks])
        self._known = False  # whether the supervisor is where the recorded one was
        self._newest = np.nan  # V, command taken
        self._begun = 0  # ns, when the process did
        self._gap = END  # ns, after the last row that comes before some that are missing
        self._unlike = self._lost_changes = compared = 0
        gaps = _ends(blocks)
        before: Block | None = None
        for i, block in enumerate(blocks):
            self._gap = gaps[i]
            self._enter(block, before)
            after = blocks[i + 1] if i + 1 < len(blocks) else None
            end = END if after is None else int(after.time[0])
            times = block.time.tolist()
            for time, row, recorded in zip(
                times, block.rows.tolist(), self._recorded(block, end), strict=True
            ):
                voltage = self._step(time, row) if self._known or not self._faithful else None
                if voltage is not None:
                    compared += not math.isnan(recorded)
                    yield time, self._newest, row[READING], recorded, voltage
            before = block
        self._say(compared)

    def _enter(self, block: Block, before: Block | None) -> None:
        """Begin anew where the controller did, and after a gap with its account of what it remembers."""
        begin, earliest = int(block.time[0]), 0 if before is None else int(before.time[-1])
        if block.first == 0:
            self._apply_changes(self._next_change(begin))
            self._supervisor, self._begun = self._at_rest(), begin
            self._known, self._newest = True, math.nan
        elif _apart(before, block):
            self._known = False
        if not self._faithful:
            return
        accounts, moment = self._valve.accounts, itemgetter(0)
        first = bisect_left(accounts, earliest, key=moment)
        for _, text in accounts[first : bisect_right(accounts, int(block.time[-1]), key=moment)]:
            if row_of(text) != block.first:
                continue
            if self._known and remember(self._supervisor, block.first) == text:
                continue
            self._unlike += self._known
            self._apply_changes(begin)
            if recall(self._supervisor, text):
                self._known = True
                command = self._supervisor.command_in_force
                self._newest = math.nan if command is None else command

    def _step(self, time: int, row: list[float]) -> float | None:
        """Give the supervisor what ``row`` tells; the voltage [V], None if the row has none."""
        supervisor, event = self._supervisor, Event(int(row[EVENT]))
        if event is Event.COMMAND or not math.isnan(row[COMMAND]):
            self._newest = row[COMMAND]
            supervisor.command(row[COMMAND])
        match event:
            case Event.READING:
                return supervisor.sample(row[READING], int(row[NUMBER]), row[ELAPSED])
            case Event.SILENCE | Event.STALL:
                voltage = supervisor.silence(row[ELAPSED], event is Event.STALL)
                return voltage if supervisor.begun else None
            case Event.PARAMETERS:
                if time != self._begun:
                    self._change(time)
            case Event.START:
                supervisor.start()
            case Event.RESET:
                supervisor.reset()
            case Event.COMMAND_GONE:
                supervisor.command_gone()
            case Event.COMMAND_PUBLISHERS | Event.LVDT_PUBLISHERS:
                observe(supervisor, event, int(row[NUMBER]))
        return None

    def _change(self, time: int) -> None:
        """Parameters that came into use at ``time`` [ns] and were published between then and the next."""
        until = self._next_change(time)
        self._lost_changes += not self._apply_changes(until) and until - time > PUBLISHED

    def _next_change(self, time: int) -> int:
        """When [ns] the next parameters after ``time`` came into use, or may have, since rows are missing."""
        after = int(np.searchsorted(self._applied, time, side="right"))
        return min(int(self._applied[after]) if after < len(self._applied) else END, self._gap)

    def _recorded(self, block: Block, end: int) -> list[float]:
        """The voltage on the topic [V] after each row and before the next, which comes at ``end`` [ns]."""
        given = self._voltages
        if given is None or len(given.time) == 0:
            return [math.nan] * len(block.rows)
        if not given.has_source_time:
            return list(block.rows[:, VOLTAGE])
        first = np.searchsorted(given.time, block.time)
        at = np.minimum(first, len(given.time) - 1)
        own = (first == at) & (given.time[at] < np.append(block.time[1:], end))
        return list(np.where(own, given.value[at], np.nan))

    def _say(self, compared: int) -> None:
        given = 0 if self._voltages is None else len(self._voltages.time)
        if self._faithful and given > compared:
            self._left_out.append(
                f"{given - compared} of {given} recorded voltages are not compared: they come before the "
                "first account or after the last part of the controller's journal in the bag, or in its gaps"
            )
        if self._lost_changes:
            self._left_out.append(
                f"parameters changed {self._lost_changes} times, and the bag does not hold to what"
            )
        if self._unlike:
            self._left_out.append(
                f"{self._unlike} times the controller remembered something else than the shadow, which "
                "went on from its account"
            )
        lost = self._supervisor.counts["lvdt_lost"]
        if lost:
            self._left_out.append(f"{lost} readings did not reach the controller")


def _apart(before: Block | None, after: Block | None) -> bool:
    """Whether rows are missing between two blocks, or one of these."""
    return before is None or after is None or after.first != before.first + len(before.rows)


def _ends(blocks: list[Block]) -> list[int]:
    """For each block the time [ns] after the last row that follows it without a gap."""
    ends: list[int] = []
    for before, after in zip(reversed(blocks), [None, *reversed(blocks[1:])], strict=True):
        ends.append(int(before.time[-1]) + 1 if _apart(before, after) else ends[-1])
    return ends[::-1]


class _ByTimes(_Replay):
    """Each reading in turn, under the newest command sent before it was answered, as far as times tell."""

    def _rows(self) -> Iterator[Row]:
        self._left_out.append(
            "the bag has no ~/journal of a controller: what it took in is known to a sample or so, from times"
        )
        readings, commands = self._valve.recorded["spool_position"], self._commands
        answered, recorded = self._answers(readings)
        taken, last = 0, int(readings.time[0])
        newest = math.nan
        columns = (
            readings.time,
            readings.value,
            readings.sequence,
            np.searchsorted(commands.time, answered),
            recorded,
        )
        for time, reading, number, count, voltage in zip(*(c.tolist() for c in columns), strict=True):
            self._apply_changes(time)
            for command in commands.value[taken:count].tolist():
                self._supervisor.command(command)
                newest = command
            taken = max(taken, count)
            elapsed = 0.0 if self._values["lockstep"] is True else (time - last) * 1e-9
            last = time
            yield time, newest, reading, voltage, self._supervisor.sample(reading, number or None, elapsed)

    def _answers(self, readings: Samples) -> tuple[Integers, Floats]:
        """When each reading was answered [ns], and by what [V]: itself and NaN where it was not."""
        given = self._voltages
        if given is None or len(given.time) == 0:
            return readings.time, np.full(len(readings.time), np.nan)
        first = np.searchsorted(given.time, readings.time, side="right")
        at = np.minimum(first, len(given.time) - 1)
        own = (first == at) & (given.time[at] < np.append(readings.time[1:], END))
        taking = np.maximum(given.time[at] - TAKING, readings.time)
        return np.where(own, taking, readings.time), np.where(own, given.value[at], np.nan)
