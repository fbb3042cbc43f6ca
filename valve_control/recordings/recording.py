"""Signals of the valves in a bag, cleaned and aligned to the LVDT's readings."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.bags.bag import Bag, Series
from valve_control.bags.cdr import Decoder
from valve_control.bags.errors import BagError
from valve_control.recordings import parameters
from valve_control.recordings.mapping import Source, ValveTopics, find_valves

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
ESTIMATES = ("a1", "a0", "b0", "b0dn")
STATE_FIELDS = ("sample", "mode", "z1", "z2", "lyapunov", "lyapunov_bound", *ESTIMATES)
CLOCKS = 1.0  # s by which two clocks may differ for source times to be used
SMALL_DISORDER = 0.1  # s by which messages may be out of order to be sorted instead of left out


class Samples(NamedTuple):
    """One signal of a valve, in order of time, without what cannot be used."""

    topic: str
    time: Integers  # ns, source time if the bag has it
    log_time: Integers  # ns, when it was recorded
    sequence: Integers
    value: Floats  # V
    has_source_time: bool


class Aligned(NamedTuple):
    """All signals at each LVDT reading, from the first command on."""

    time: Floats  # s, from the first of these readings
    stamp: Integers  # ns
    period: float  # s
    command: Floats  # V, NaN where the bag has none
    measurement: Floats  # V
    voltage: Floats  # V, NaN where the bag has none
    latency: Floats  # s from reading to voltage, of the readings that were answered
    unanswered: int  # readings without a voltage before the next one


class State(NamedTuple):
    """What the controller said of itself on ~/state."""

    stamp: Integers  # ns
    labels: list[str]  # of the first message
    values: dict[str, Floats]  # by label; NaN where a law has no such term


class Valve(NamedTuple):
    """Everything recorded of one valve."""

    name: str
    topics: ValveTopics
    signals: dict[str, Samples]  # by part
    recorded: dict[str, Samples]  # likewise, with what cannot be used: NaN, other publishers
    state: State | None
    memories: list[tuple[int, str]]  # what the controller remembered, with source times [ns]
    controller: parameters.Node | None
    simulator: parameters.Node | None
    problems: list[str]

    @property
    def lockstep(self) -> bool:
        """Whether wall time means nothing, since everyone waited for everyone."""
        return self.controller is not None and self.controller.initial.get("lockstep") is True

    @property
    def period(self) -> float:
        """Sample period [s]: the recorded parameter, else the median interval of the readings."""
        if self.controller is not None and "sample_period" in self.controller.initial:
            return float(self.controller.initial["sample_period"])
        intervals = np.diff(self.signals["spool_position"].time)
        return float(np.median(intervals)) * 1e-9 if len(intervals) else np.nan


class Recording(NamedTuple):
    """A bag as a control engineer sees it."""

    bag: Bag
    valves: dict[str, Valve]
    nodes: dict[str, parameters.Node]
    problems: list[str]


def load(
    path: Path | str,
    maps: Sequence[str] = (),
    start: float | None = None,
    end: float | None = None,
    told: Callable[[Bag], Callable[[int], None]] | None = None,
) -> Recording:
    """Read a bag, or its part from ``start`` to ``end`` [s] after its beginning.

    ``told`` makes, from the opened bag, what hears the bytes done. Raises BagError if nothing can be
    analysed.
    """
    bag = Bag(path)
    topics = find_valves(bag, maps)
    wanted: dict[str, list[str]] = {}
    states = {valve.state for valve in topics.values() if valve.state}
    for valve in topics.values():
        for source in valve.sources.values():
            wanted.setdefault(source.topic, [])
            if source.field not in wanted[source.topic]:
                wanted[source.topic].append(source.field)
    labels = {name: _labels(bag, name) for name in states}
    for name in states:
        wanted[name] = [f"data[{label}]" for label in STATE_FIELDS]
    raw = {parameters.TOPIC, *(_memory_topic(name) for name in states)} & set(bag.topics)
    begin = bag.begin if start is not None or end is not None else 0
    series = bag.read(
        wanted,
        raw=raw,
        sparse=states,
        start=None if start is None else begin + round(start * 1e9),
        end=None if end is None else begin + round(end * 1e9),
        told=told(bag) if told else None,
    )
    nodes = parameters.history(series.get(parameters.TOPIC), bag.problems)
    valves = {
        name: _valve(valve, series, labels.get(valve.state, []), nodes) for name, valve in topics.items()
    }
    if not any(len(s.time) for valve in valves.values() for s in valve.signals.values()):
        raise BagError(f"{path} has no message on any topic of a valve, so there is nothing to analyse")
    return Recording(bag, valves, nodes, bag.problems)


def _memory_topic(state: str) -> str:
    """Topic on which the controller with this topic of its state says what it remembers."""
    return f"{state.removesuffix('/state')}/memory"


def _labels(bag: Bag, topic: str) -> list[str]:
    message = bag.first(topic)
    return [] if message is None else Decoder(bag.topic(topic), ()).labels(message)


def _valve(
    topics: ValveTopics, series: dict[str, Series], labels: list[str], nodes: dict[str, parameters.Node]
) -> Valve:
    problems: list[str] = []
    recorded = {
        part: _samples(source, series[source.topic], problems) for part, source in topics.sources.items()
    }
    signals = {part: _usable(samples, problems) for part, samples in recorded.items()}
    kinds: dict[str, Any] = {}
    for node in nodes.values():
        if node.namespace == topics.namespace and node.kind:
            kinds[node.kind] = node
    state = None
    if topics.state and len(series[topics.state].log_time):
        got = series[topics.state]
        named = {label: got.values[f"data[{label}]"] for label in STATE_FIELDS}
        state = State(got.publish_time, labels, named)
    memories: list[tuple[int, str]] = []
    told = series.get(_memory_topic(topics.state))
    if told is not None:
        texts = [raw[8:].rstrip(b"\0").decode(errors="replace") for raw in told.raw]
        memories = sorted(zip(told.publish_time.tolist(), texts, strict=True))
    for part in ("spool_command", "spool_position", "valve_voltage"):
        if part not in signals:
            problems.append(f"{topics.name} has no {part}; what needs it is left out")
    if topics.state == "":
        problems.append(f"{topics.name} has no ~/state of its controller: no estimates and no V2")
    if "controller" not in kinds:
        problems.append(f"{topics.name}: the bag has no parameters of its controller")
    return Valve(
        topics.name,
        topics,
        signals,
        recorded,
        state,
        memories,
        kinds.get("controller"),
        kinds.get("valve_simulator"),
        problems,
    )


def _samples(source: Source, series: Series, problems: list[str]) -> Samples:
    value = series.values[source.field]
    if source.factor != 1.0:
        value = value * source.factor
    name = source.topic
    if series.undecodable:
        problems.append(
            f"{series.undecodable} messages of {name} could not be decoded and are left out: {series.error}"
        )
    has_source_time = bool(np.any(series.publish_time != series.log_time))
    if has_source_time:
        behind = float(np.median(series.log_time - series.publish_time)) * 1e-9
        if abs(behind) > CLOCKS:
            problems.append(
                f"the clock of {name}'s publisher is {behind:.3g} s behind the recorder's; "
                "times of recording are used for it"
            )
            has_source_time = False
    time = series.publish_time if has_source_time else series.log_time
    return Samples(name, time, series.log_time, series.sequence, value, has_source_time)


def _usable(samples: Samples, problems: list[str]) -> Samples:
    """``samples`` in order of time, without what cannot be analysed, which is said in ``problems``."""
    name = samples.topic
    keep = np.isfinite(samples.value)
    if not keep.all():
        n = int(np.count_nonzero(~keep))
        problems.append(f"{n} messages of {name} hold NaN or infinity and are left out")
    columns = _one_publisher(
        name, [samples.time, samples.log_time, samples.sequence, samples.value], keep, problems
    )
    time, log_time, sequence, value = _forward(name, columns, problems)
    return Samples(name, time, log_time, sequence, value, samples.has_source_time)


def _one_publisher(name: str, columns: list[Any], keep: Any, problems: list[str]) -> list[Any]:
    """Of publishers whose messages are interleaved, told by their sequence numbers, the one with the most."""
    sequence = columns[2]
    falls = int(np.count_nonzero(np.diff(sequence) <= 0)) if np.any(sequence) else 0
    if len(sequence) > 20 and falls > max(10, 0.02 * len(sequence)):
        owner = _owners(sequence)
        counts = np.bincount(owner)
        most = int(np.argmax(counts))
        problems.append(
            f"{len(counts)} publishers are interleaved on {name}; only the one with the most messages "
            f"({counts[most]} of {len(sequence)}) is analysed"
        )
        keep = keep & (owner == most)
    return columns if keep.all() else [column[keep] for column in columns]


def _owners(sequence: Integers) -> Integers:
    """Publisher of each message: the one whose last number it follows most closely."""
    last: list[int] = []
    owner = np.empty(len(sequence), dtype=np.int64)
    for i, number in enumerate(sequence.tolist()):
        behind = [(number - n, k) for k, n in enumerate(last) if 0 < number - n <= 1000]
        k = min(behind)[1] if behind else len(last)
        if k == len(last):
            last.append(number)
        last[k] = number
        owner[i] = k
    return owner


def _forward(name: str, columns: list[Any], problems: list[str]) -> list[Any]:
    """Messages in order of time; where it goes back by more than a little, the longest part in order."""
    time = columns[0]
    back = np.flatnonzero(np.diff(time) < 0)
    if len(back) == 0:
        return columns
    largest = float(np.max(time[back] - time[back + 1])) * 1e-9
    if largest <= SMALL_DISORDER:
        problems.append(
            f"{len(back)} messages of {name} were out of order by up to {largest:.3g} s and are sorted"
        )
        order = np.argsort(time, kind="stable")
        return [column[order] for column in columns]
    edges = [0, *(back + 1).tolist(), len(time)]
    begin, end = max(zip(edges[:-1], edges[1:], strict=True), key=lambda e: e[1] - e[0])
    problems.append(
        f"time goes backwards on {name} {len(back)} time(s), by up to {largest:.3g} s; only the longest part "
        f"that runs forward is analysed ({end - begin} of {len(time)} messages)"
    )
    return [column[begin:end] for column in columns]


def seconds(stamp: Integers, begin: int | Integers = 0) -> Floats:
    """Nanoseconds since ``begin`` as seconds."""
    return (stamp - begin).astype(np.float64) * 1e-9


def align(valve: Valve) -> Aligned:
    """Command, measurement and voltage at each LVDT reading from the first command on.

    The command is the newest one sent before the voltage that answers the reading; the voltage is the one in
    force until the next reading. Raises BagError without readings.
    """
    if "spool_position" not in valve.signals or len(valve.signals["spool_position"].time) == 0:
        raise BagError(f"{valve.name} has no spool_position, so no signal can be aligned")
    stamp = valve.signals["spool_position"].time
    measurement = valve.signals["spool_position"].value
    period = valve.period
    until = np.append(stamp[1:], stamp[-1] + round((period if np.isfinite(period) else 0.0) * 1e9))
    seen: Integers = stamp
    voltage: Floats = np.full(len(stamp), np.nan)
    latency = np.empty(0)
    unanswered = 0
    voltages = valve.signals.get("valve_voltage")
    if voltages is not None and len(voltages.time):
        after = np.searchsorted(voltages.time, stamp, side="right")
        answer = voltages.time[np.minimum(after, len(voltages.time) - 1)]
        answered = (answer > stamp) & (answer <= until)
        latency = seconds(answer[answered], stamp[answered])
        unanswered = int(np.count_nonzero(~answered))
        seen = np.where(answered, answer, stamp)
        voltage = _held(voltages, np.searchsorted(voltages.time, until, side="left") - 1)
    command: Floats = np.full(len(stamp), np.nan)
    commands = valve.signals.get("spool_command")
    first = 0
    if commands is not None and len(commands.time):
        command = _held(commands, np.searchsorted(commands.time, seen, side="right") - 1)
        first = int(np.argmax(np.isfinite(command))) if np.any(np.isfinite(command)) else 0
    if np.any(np.isfinite(voltage)):
        first = max(first, int(np.argmax(np.isfinite(voltage))))
    time = seconds(stamp, int(stamp[first]))
    if valve.lockstep:
        time = (np.arange(len(stamp), dtype=np.float64) - first) * period
    return Aligned(
        time[first:], stamp[first:], period, command[first:], measurement[first:], voltage[first:], latency,
        unanswered,
    )  # fmt: skip


def _held(samples: Samples, index: Integers) -> Floats:
    """Value at ``index``, NaN before the first."""
    return np.where(index >= 0, samples.value[np.maximum(index, 0)], np.nan)
