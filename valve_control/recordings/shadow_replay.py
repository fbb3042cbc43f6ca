# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Shadow replay: gives a controller the recorded commands and readings and compares its voltages.

The controller's journal tells which reading it answered under which command, and all else that it took in:
with the recorded parameters a shadow is that controller once more, and gives its voltages bit for bit.
Without a journal, commands are taken by the times at which they were sent.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from valve_control import parameter
from valve_control.arrays import Floats, Integers
from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.supervision.command_course import Motion
from valve_control.control.supervision.journal import COLUMNS, COUNTED, Block, Event
from valve_control.control.supervision.state_snapshot import restore, snapshot
from valve_control.control.supervision.supervisor import Supervisor
from valve_control.parameter import ParameterError, defaults, updated
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.cleaning import Samples, seconds
from valve_control.recordings.recording import ValveRecording

Row = tuple[int, float, float, float, float]  # time [ns], command, reading, recorded and shadow voltage [V]
EVENT, COMMAND, READING, NUMBER, ELAPSED, VOLTAGE = range(1, len(COLUMNS))
TAKING = 60_000  # ns from taking commands to publishing the voltage, about
END = np.iinfo(np.int64).max  # ns
REPORT = 10_000  # samples between two words of progress


class Shadow(NamedTuple):
    """Recorded and replayed voltage at each step of the controller."""

    time: Floats  # s, from the first of them
    controller: str  # law at the beginning
    measurement: Floats  # V, NaN where the LVDT was silent
    command: Floats  # V, the newest one taken, NaN before the first
    recorded: Floats  # V, NaN where the bag has no voltage
    voltage: Floats  # V
    faithful: bool  # whether the recorded parameters were used, all of them
    left_out: list[str]

    @property
    def differences(self) -> Integers:
        """Indices of the samples whose voltages differ, by any bit."""
        return np.flatnonzero(np.isfinite(self.recorded) & (self.voltage != self.recorded))

    @property
    def differing(self) -> int:
        """Number of these samples."""
        return len(self.differences)


def replay(
    valve: ValveRecording, overrides: Mapping[str, Any], told: Callable[[int], None] | None = None
) -> Shadow:
    """Shadow replay of one valve, loaded with its journal; ``overrides`` win over the recorded parameters.

    Raises BagError without readings or commands, ParameterError for parameters that do not fit together.
    """
    if valve.journal and valve.accounts and valve.topics.plain:
        return _ByJournal(valve, overrides).run(told)
    for part in ("spool_position", "spool_command"):
        if part not in valve.recorded or len(valve.recorded[part].time) == 0:
            raise BagError(f"{valve.name} has no {part}, so no controller can be replayed on it")
    return _ByTimes(valve, overrides).run(told)


class _Replay:
    """Runs a supervisor with the recorded parameters of each moment."""

    exact = False  # whether the valve got the very voltages that the supervisor gives without overrides
    _why_nothing = "the bag has no reading in this part"

    def __init__(self, valve: ValveRecording, overrides: Mapping[str, Any]) -> None:
        self._valve = valve
        self._overrides = dict(overrides)
        self._voltages = valve.recorded.get("valve_voltage")
        self._left_out: list[str] = []
        self._faithful = not overrides
        self._supervisor = Supervisor()
        self._supervisor.answered = self._faithful and self.exact
        # In recordings that do not have this parameter yet a late command was held.
        self._values = {**defaults(CONTROLLER), "command.bridge": 0.0}
        self._supervisor.apply(self._values, build.law_params(self._values))

    def run(self, told: Callable[[int], None] | None) -> Shadow:
        rows: list[Row] = []
        law, lockstep = "", False
        for row in self._rows():
            if not rows:
                law, lockstep = self._supervisor.name, self._values["lockstep"] is True
            rows.append(row)
            if told is not None and len(rows) % REPORT == 0:
                told(REPORT)
        if not rows:
            raise BagError(f"{self._valve.name}: nothing to replay; {self._why_nothing}")
        stamp = np.array([row[0] for row in rows], dtype=np.int64)
        command, measurement, recorded, voltage = (np.array(c) for c in list(zip(*rows, strict=True))[1:])
        time = seconds(stamp, int(stamp[0]))
        if lockstep:
            time = np.arange(len(rows), dtype=np.float64) * parameter.number(self._values, "sample_period")
        faithful = self._faithful and bool(np.any(np.isfinite(recorded)))
        return Shadow(
            time=time,
            controller=law,
            measurement=measurement,
            command=command,
            recorded=recorded,
            voltage=voltage,
            faithful=faithful,
            left_out=list(dict.fromkeys(self._left_out)),
        )

    def _rows(self) -> Iterator[Row]:
        raise NotImplementedError

    def _row(self, time: int, reading: float, recorded: float, voltage: float) -> Row:
        command = self._supervisor.memory.command.value
        return time, math.nan if command is None else command, reading, recorded, voltage

    def _use(self, recorded: Mapping[str, Any]) -> None:
        """Take recorded parameters into use, and over them the given ones. Raises ParameterError."""
        known = {parameter.name for parameter in CONTROLLER}
        wanted = {name: value for name, value in recorded.items() if name in known}
        try:
            values = updated(CONTROLLER, self._values, wanted | self._overrides)
            params = build.law_params(values)
        except ParameterError as error:
            if self._overrides:
                raise
            self._faithful = False
            self._left_out.append(f"recorded parameters not used: {error}")
            return
        if values != self._values:
            self._supervisor.apply(values, params)
            self._values = values


class _ByJournal(_Replay):
    """Replays what the controller's journal lists, in its order, from its first snapshot on."""

    exact = True
    _why_nothing = "this part of the controller's journal has no account on ~/memory to begin with"

    def _rows(self) -> Iterator[Row]:
        blocks = self._valve.journal
        if any(later.time[0] < before.time[-1] for before, later in pairwise(blocks)):
            blocks = sorted(blocks, key=lambda block: (block.run, block.first))
        self._known = False  # whether the supervisor is where the recorded one was, or as good
        self._changed = False  # whether parameters came into use that the next account tells
        self._apart: float | None = 0.0  # s without rows before the next reading, None if none are missing
        self._mismatches = self._refused = unseen = gaps = 0
        answered: list[tuple[int, float]] = []  # time [ns] and voltage [V]
        before: Block | None = None
        last: float | None = None  # number of the last reading
        for block in self._from_account(blocks):
            if not block.follows(before):
                gaps += before is not None and block.run == before.run
                last = None
            self._enter(block, before)
            for time, row in zip(block.time.tolist(), block.rows.tolist(), strict=True):
                voltage = self._step(row) if self._known else None
                number = row[NUMBER]
                if time < self._valve.since:
                    continue
                if row[EVENT] in (Event.READING, Event.STALL) and not math.isnan(number):
                    unseen += int(number - last - 1) if last is not None and number > last else 0
                    last = number
                if voltage is not None and not math.isnan(row[VOLTAGE]):
                    answered.append((time, row[VOLTAGE]))
                    yield self._row(time, row[READING], row[VOLTAGE], voltage)
            before = block
        if gaps:
            self._left_out.append(f"parts of the controller's journal are missing in {gaps} places")
        if self._mismatches:
            self._left_out.append(
                f"{self._mismatches} times the controller remembered something else than the shadow, which "
                "went on from its account"
            )
        if self._refused:
            self._why_nothing = (
                f"{self._refused} accounts of what the controller remembers are of another version"
            )
            self._left_out.append(self._why_nothing)
        if unseen:
            self._left_out.append(f"{unseen} readings did not reach the controller")
        self._compare(answered)

    def _from_account(self, blocks: list[Block]) -> list[Block]:
        """The blocks from the last one on that an account precedes and that lies before the wanted part."""
        begins = [i for i, b in enumerate(blocks) if (b.run, b.first) in self._valve.accounts]
        early = [i for i in begins if blocks[i].time[0] <= self._valve.since]
        if early:
            return blocks[early[-1] :]
        return blocks[begins[0] :] if begins else blocks

    def _enter(self, block: Block, before: Block | None) -> None:
        """Go on; after a gap or with new parameters, from the controller's account of what it remembers."""
        told = self._valve.accounts.get((block.run, block.first))
        follows = block.follows(before)
        if not follows:
            self._apart = 0.0 if before is None else max(0.0, float(block.time[0] - before.time[-1]) * 1e-9)
        if not follows or (self._changed and told is None):
            self._known = self._known and not self._faithful
        self._changed = False
        if told is None:
            return
        self._use(told.values)
        if not self._faithful:
            if not self._known and told.command is not None:
                self._supervisor.command(told.command)
            self._known = True
        elif not self._known or snapshot(self._supervisor, told.run, told.row) != told.text:
            self._mismatches += self._known
            self._known = restore(self._supervisor, told.text)
            self._refused += not self._known

    def _step(self, row: list[float]) -> float | None:
        """Pass on to the supervisor what ``row`` lists; returns the voltage [V], None if the row has none."""
        supervisor, event = self._supervisor, Event(int(row[EVENT]))
        if event is Event.TRAJECTORY:
            point = Motion(row[COMMAND], row[READING], row[NUMBER])
            supervisor.trajectory(point, row[ELAPSED] or math.nan, row[VOLTAGE])
        elif event is Event.TRAJECTORY_REFUSED:
            supervisor.trajectory_refused(int(row[COMMAND]), int(row[READING]), int(row[NUMBER]))
        elif event is Event.COMMAND or not math.isnan(row[COMMAND]):
            timed = event is Event.COMMAND and not math.isnan(row[NUMBER])
            supervisor.command(row[COMMAND], row[READING] if timed else math.nan, row[NUMBER])
        match event:
            case Event.READING:
                number, elapsed = int(row[NUMBER]), row[ELAPSED]
                apart, self._apart = self._apart, None
                if apart is not None and not self._faithful:
                    # It is the bag that lacks rows: no reading was lost, and the spool has moved meanwhile.
                    return supervisor.sample(row[READING], None, elapsed + apart)
                return supervisor.sample(row[READING], number, elapsed)
            case Event.STALL if not math.isnan(row[NUMBER]):
                return supervisor.skip(row[READING], row[NUMBER], row[ELAPSED])
            case Event.SILENCE | Event.STALL:
                return supervisor.silence(row[ELAPSED], event is Event.STALL)
            case Event.START | Event.STOP:
                supervisor.start()
                return supervisor.voltage
            case Event.PARAMETERS:
                self._changed = True
            case Event.RESET:
                supervisor.reset()
            case Event.COMMAND_GONE:
                supervisor.command_gone()
            case Event.TRAJECTORY_GONE:
                supervisor.trajectory_gone()
            case _ if event in COUNTED:
                supervisor.publishers(COUNTED[event], int(row[NUMBER]))
        return None

    def _compare(self, answered: list[tuple[int, float]]) -> None:
        """Whether the voltages on the topic are those in the journal."""
        heard = self._voltages
        if heard is None or not answered:
            return
        others = (Counter(heard.value.tolist()) - Counter(voltage for _, voltage in answered)).total()
        if others:
            early, late = (answered[0][0] - heard.time[0]) * 1e-9, (heard.time[-1] - answered[-1][0]) * 1e-9
            self._left_out.append(
                f"{others} of {len(heard.time)} messages on {heard.topic} are not in the part of the journal "
                f"that is replayed: it begins {max(early, 0.0):.3f} s after the first of them and ends "
                f"{max(late, 0.0):.3f} s before the last"
            )


class _ByTimes(_Replay):
    """Replays each reading in turn, with the newest command sent before it was answered, by the times."""

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
        without = (
            "without a controller's ~/journal and ~/memory" if self._valve.topics.plain else "with --map"
        )
        self._left_out.append(f"{without} what a controller took in is known to a sample or so, from times")
        readings, commands = (self._valve.recorded[part] for part in ("spool_position", "spool_command"))
        answered, recorded = self._answers(readings)
        taken, begin = 0, int(readings.time[0])
        last = begin - round(1e9 * self._valve.period)
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
            lockstep = self._values["lockstep"] is True
            in_time = lockstep or self._valve.paired or self._valve.coarse  # no command has a time of its own
            for command, sent in zip(
                commands.value[taken:count].tolist(), commands.time[taken:count].tolist(), strict=True
            ):
                stamp = math.nan if in_time else 1.0 + (sent - begin) * 1e-9
                self._supervisor.command(command, stamp, (sent - last) * 1e-9)
            taken = max(taken, count)
            elapsed = 0.0 if lockstep else (time - last) * 1e-9
            last = time
            answer = self._supervisor.sample(reading, number or None, elapsed)
            yield self._row(time, reading, voltage, answer)

    def _answers(self, readings: Samples) -> tuple[Integers, Floats]:
        """Time [ns] and voltage [V] of each reading's answer: its own time and NaN where it has none."""
        given = self._voltages
        if given is None or len(given.time) == 0:
            return readings.time, np.full(len(readings.time), np.nan)
        first = np.searchsorted(given.time, readings.time, side="right")
        at = np.minimum(first, len(given.time) - 1)
        own = (first == at) & (given.time[at] < np.append(readings.time[1:], END))
        taking = np.maximum(given.time[at] - TAKING, readings.time)
        return np.where(own, taking, readings.time), np.where(own, given.value[at], np.nan)
