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
from valve_control.recordings.recording import Valve
from valve_control.supervision.journal import COLUMNS, Block, Event, observe
from valve_control.supervision.memory import heading, recall, remember
from valve_control.supervision.supervisor import Supervisor

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Row = tuple[int, float, float, float, float]  # time [ns], command, reading, recorded and shadow voltage [V]
EVENT, COMMAND, READING, NUMBER, ELAPSED, VOLTAGE = range(1, len(COLUMNS))
TAKING = 60_000  # ns from taking commands to publishing the voltage, about
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
    return (_ByJournal if valve.journal and valve.accounts else _ByTimes)(valve, overrides).run(told)


class _Replay:
    """A supervisor with the parameters of each moment."""

    def __init__(self, valve: Valve, overrides: Mapping[str, Any]) -> None:
        self._valve = valve
        self._overrides = dict(overrides)
        self._voltages = valve.recorded.get("valve_voltage")
        self._left_out: list[str] = []
        self._faithful = not overrides
        self._supervisor = Supervisor()
        self._values = updated(CONTROLLER, defaults(CONTROLLER), overrides)
        self._supervisor.apply(self._values, build.law_params(self._values))
        self._law = ""

    def run(self, told: Callable[[int], None] | None) -> Shadow:
        rows: list[Row] = []
        for row in self._rows():
            self._law = self._law or self._supervisor.name
            rows.append(row)
            if told is not None and len(rows) % REPORT == 0:
                told(REPORT)
        if not rows:
            raise BagError(f"{self._valve.name}: the bag has no voltage that can be replayed")
        stamp = np.array([row[0] for row in rows], dtype=np.int64)
        command, measurement, recorded, voltage = (np.array(c) for c in list(zip(*rows, strict=True))[1:])
        time = seconds(stamp, int(stamp[0]))
        if self._values["lockstep"] is True:
            time = np.arange(len(rows), dtype=np.float64) * build.number(self._values, "sample_period")
        faithful = self._faithful and bool(np.any(np.isfinite(recorded)))
        return Shadow(time, self._law, measurement, command, recorded, voltage, faithful, self._left_out)

    def _rows(self) -> Iterator[Row]:
        raise NotImplementedError

    def _use(self, recorded: Mapping[str, Any]) -> None:
        """Take recorded parameters into use, but for those that are given."""
        names = {parameter.name for parameter in CONTROLLER} - self._overrides.keys()
        try:
            values = updated(
                CONTROLLER, self._values, {name: v for name, v in recorded.items() if name in names}
            )
            if values == self._values:
                return
            self._supervisor.apply(values, build.law_params(values))
        except ParameterError as error:
            self._left_out.append(f"recorded parameters not used: {error}")
            return
        self._values = values


class _ByJournal(_Replay):
    """What the controller's journal says that it took in, in that order, from its first account on."""

    def _rows(self) -> Iterator[Row]:
        blocks = self._valve.journal
        self._known = False  # whether the supervisor is where the recorded one was, or as good
        self._changed = False  # whether parameters came into use that the next account tells
        self._newest = math.nan  # V, command taken
        self._unlike = compared = 0
        before: Block | None = None
        for i, block in enumerate(blocks):
            self._enter(block, before)
            end = int(blocks[i + 1].time[0]) if i + 1 < len(blocks) else END
            times, recorded = block.time.tolist(), self._recorded(block, end)
            for time, row, given in zip(times, block.rows.tolist(), recorded, strict=True):
                voltage = self._step(row) if self._known else None
                if voltage is not None:
                    compared += not math.isnan(given)
                    yield time, self._newest, row[READING], given, voltage
            before = block
        self._say(compared)

    def _enter(self, block: Block, before: Block | None) -> None:
        """Go on; after a gap or with new parameters, from the controller's account of what it remembers."""
        told = self._account(block, before)
        if (
            before is None
            or block.first != before.first + len(before.rows)
            or (self._changed and told is None)
        ):
            self._known = self._known and not self._faithful
        self._changed = False
        if told is None:
            return
        text, values = told
        self._use(values)
        if not self._faithful:
            self._known = True
        elif not self._known or remember(self._supervisor, block.first) != text:
            self._unlike += self._known
            self._known = recall(self._supervisor, text)
            command = self._supervisor.command_in_force
            self._newest = math.nan if command is None else command

    def _account(self, block: Block, before: Block | None) -> tuple[str, Values] | None:
        """What the controller remembered before ``block``, and its parameters; None if it did not say."""
        accounts, moment = self._valve.accounts, itemgetter(0)
        first = bisect_left(accounts, 0 if before is None else int(before.time[-1]), key=moment)
        last = bisect_right(accounts, int(block.time[-1]), key=moment)
        for _, text in accounts[first:last]:
            told = heading(text)
            if told is not None and told[0] == block.first:
                return text, told[1]
        return None

    def _step(self, row: list[float]) -> float | None:
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
                self._changed = True
            case Event.START:
                supervisor.start()
            case Event.RESET:
                supervisor.reset()
            case Event.COMMAND_GONE:
                supervisor.command_gone()
            case Event.COMMAND_PUBLISHERS | Event.LVDT_PUBLISHERS:
                observe(supervisor, event, int(row[NUMBER]))
        return None

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
        if self._unlike:
            self._left_out.append(
                f"{self._unlike} times the controller remembered something else than the shadow, which "
                "went on from its account"
            )
        lost = self._supervisor.counts["lvdt_lost"]
        if lost:
            self._left_out.append(f"{lost} readings did not reach the controller")


class _ByTimes(_Replay):
    """Each reading in turn, under the newest command sent before it was answered, as far as times tell."""

    def _rows(self) -> Iterator[Row]:
        node = self._valve.controller
        changes = list(node.changes) if node is not None else []
        if node is not None:
            values, refused = node.table_values(node.initial)
            self._left_out += refused
            self._use(values)
        elif "sample_period" not in self._overrides:
            self._use({"sample_period": self._valve.period})
        if node is None or node.missing or self._left_out:
            self._faithful = False
            self._left_out.append(
                "not all of the recorded controller's parameters are known: defaults stand for the others"
            )
        self._left_out.append(
            "the bag has no ~/journal of a controller: what it took in is known to a sample or so, from times"
        )
        readings, commands = (self._valve.recorded[part] for part in ("spool_position", "spool_command"))
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
            while changes and changes[0].time < time:
                self._use(changes.pop(0).values)
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
