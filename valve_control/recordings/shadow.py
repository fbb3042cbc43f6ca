"""Shadow replay: a controller sees the recorded command and LVDT and says which voltage it would have given.

With the recorded parameters this is the recorded controller once more, and gives its voltages bit for bit.
What it took in between two readings is known from source times; whether a command that was sent while a
reading was being answered came before or after is not: both are tried, and the recorded voltage decides.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.bags.errors import BagError
from valve_control.parameters import build
from valve_control.parameters.table import CONTROLLER, ParameterError, Values, defaults, updated
from valve_control.recordings.parameters import Change
from valve_control.recordings.recording import Valve, seconds
from valve_control.supervision.supervisor import Supervisor

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
TAKING = 60_000  # ns from taking commands to publishing the voltage, about
HOPELESS = 20  # samples in a row that differ, after which the recorded voltage no longer decides
QUEUE = 12  # periods; a reading that waited longer than the queue is long was never seen
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
        self._faithful = valve.controller is not None and not overrides and self._voltages is not None
        self._law = build.word(self._values, "controller")
        self._lockstep = self._values["lockstep"] is True
        self._commands_taken = 0

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
        supervisor = self._supervisor
        supervisor.apply(self._values, build.law_params(self._values))
        readings, answers = self._pairs()
        recorded = np.full(len(readings), np.nan)
        voltage = np.empty(len(readings))
        command = np.full(len(readings), np.nan)
        numbered = bool(np.any(self._readings.sequence))
        y, numbers = self._readings.value.tolist(), self._readings.sequence.tolist()
        stamps = self._readings.time.tolist()
        given = self._voltages.value.tolist() if self._voltages is not None else []
        sent = self._voltages.time.tolist() if self._voltages is not None else []
        last, wrong = stamps[readings[0]], 0
        for k, (reading, answer) in enumerate(zip(readings, answers, strict=True)):
            moment = sent[answer] if answer >= 0 else stamps[reading]
            self._take_changes(moment)
            elapsed = 0.0 if self._lockstep else (moment - last) * 1e-9
            last = moment
            number = numbers[reading] if numbered else None
            if answer >= 0:
                recorded[k] = given[answer]
            sample = (y[reading], number, elapsed)
            if self._faithful and answer >= 0 and wrong < HOPELESS:
                got, fits = self._tried(sample, moment, recorded[k], k)
                wrong = 0 if fits else wrong + 1
            else:
                self._give(self._sent_before(moment - TAKING))
                got = supervisor.sample(*sample)
            voltage[k] = got
            if self._commands_taken:
                command[k] = self._commands.value[self._commands_taken - 1]
            if told is not None and k % REPORT == REPORT - 1:
                told(REPORT)
        if told is not None:
            told(len(readings) % REPORT)
        if wrong >= HOPELESS:
            self._left_out.append(
                f"{HOPELESS} voltages in a row differ from the recording: from there on commands are taken "
                "by their source times alone"
            )
        used = np.array(readings)
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

    # Which reading was answered by which voltage

    def _pairs(self) -> tuple[list[int], list[int]]:
        """Readings that the controller saw, and the voltage that answers each, -1 for none."""
        stamps = self._readings.time
        if self._voltages is None or len(self._voltages.time) == 0:
            return list(range(len(stamps))), [-1] * len(stamps)
        sent = self._voltages.time
        first = int(np.searchsorted(stamps, sent[0])) - 1
        if first < 0:
            first = 0
        if self._voltages.sequence[0] > 1 and self._faithful:
            self._left_out.append(
                f"the recording begins with voltage {self._voltages.sequence[0]} of the controller; what its "
                "law remembered then is not known"
            )
        period = build.number(self._values, "sample_period") * 1e9
        readings: list[int] = []
        answers: list[int] = []
        reading, extra, unseen = first, 0, 0
        times, moments = stamps.tolist(), sent.tolist()
        for answer, moment in enumerate(moments):
            while (
                not self._lockstep
                and reading + 1 < len(times)
                and moment - times[reading] > QUEUE * period
                and times[reading + 1] < moment
            ):
                reading += 1
                unseen += 1
            if reading >= len(times):
                extra += len(moments) - answer
                break
            if times[reading] >= moment:
                extra += 1
                continue
            readings.append(reading)
            answers.append(answer)
            reading += 1
        if extra:
            self._left_out.append(f"{extra} voltages answer no reading (0 V while the LVDT was silent)")
        if unseen:
            self._left_out.append(f"{unseen} readings were not seen by the controller")
        if not readings:
            raise BagError(f"{self._valve.name}: no voltage answers any reading")
        return readings, answers

    # What the controller took in before a reading

    def _take_changes(self, moment: int) -> None:
        while self._changes and self._changes[0].time < moment:
            self._apply(self._changes.pop(0))

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
        return int(np.searchsorted(self._commands.time, moment))

    def _give(self, count: int) -> None:
        """Hand on commands until ``count`` of them are taken."""
        while self._commands_taken < count:
            self._supervisor.command(float(self._commands.value[self._commands_taken]))
            self._commands_taken += 1

    def _tried(
        self, sample: tuple[float, int | None, float], moment: int, wanted: float, k: int
    ) -> tuple[float, bool]:
        """The sample with the inputs under which the voltage is the recorded one, if there are any."""
        supervisor = self._supervisor
        most = max(self._sent_before(moment), self._commands_taken)
        likely = most if self._lockstep else max(self._sent_before(moment - TAKING), self._commands_taken)
        before, taken = supervisor.snapshot(), self._commands_taken
        self._give(likely)
        got = supervisor.sample(*sample)
        if got == wanted:
            return got, True
        counts = [count for count in range(most, max(taken, most - 3) - 1, -1) if count != likely]
        events: list[tuple[str, Callable[[], None]]] = [
            ("the upper level left", supervisor.command_gone),
            ("~/reset was called", supervisor.reset),
            ("the controller began anew", supervisor.start),
        ]
        attempts: list[tuple[int, str, Callable[[], None] | None]] = [(count, "", None) for count in counts]
        attempts += [(likely, name, event) for name, event in events]
        for count, name, event in attempts:
            supervisor.restore(before)
            self._commands_taken = taken
            if event is not None:
                event()
            self._give(count)
            attempt = supervisor.sample(*sample)
            if attempt == wanted:
                if name:
                    self._inferred.append(f"before sample {k}: {name}")
                return attempt, True
        supervisor.restore(before)
        self._commands_taken = taken
        self._give(likely)
        return supervisor.sample(*sample), False
