# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Loads a bag as valves with their signals, cleaned and aligned to the LVDT readings."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats, Integers
from valve_control.control.analysis.timing import LATE
from valve_control.control.supervision.journal import Block, block
from valve_control.control.supervision.state_snapshot import Account, account
from valve_control.recordings import modes, parameters
from valve_control.recordings.bags.bag import Bag, Series
from valve_control.recordings.bags.cdr import deserialized, places
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.table import TableFile
from valve_control.recordings.cleaning import Samples, clean, seconds
from valve_control.recordings.clocks import Clock, decide, without_strays
from valve_control.recordings.mapping import PARTS, STATE_TYPE, ValveTopics, find_valves

ESTIMATES = ("a1", "a0", "b0", "b0dn")
V = TypeVar("V")
BETWEEN = 1.5  # periods from one command to the next, beyond which they are samples of a motion between
PAUSE = 100_000_000  # ns from one command to the next, beyond which the last one holds
STEP = 3.0  # times the changes before and after, beyond which a change is a step
STATE_FIELDS = ("sample", "mode", "lyapunov", "lyapunov_bound", *ESTIMATES)


class Aligned(NamedTuple):
    """All signals at each LVDT reading, from the first command on."""

    time: Floats  # s, from the first of these readings
    stamp: Integers  # ns
    period: float  # s
    command: Floats  # V, NaN where the bag has none
    measurement: Floats  # V
    voltage: Floats  # V, NaN where the bag has none
    latency: Floats  # s from reading to voltage, of the readings that were answered
    answered: npt.NDArray[np.bool_] | None  # by a voltage before the next reading; None: stamps do not tell
    wall: bool  # whether time is real time, not lockstep

    @property
    def unanswered(self) -> int | None:
        """Readings without a voltage before the next one, None where stamps do not tell."""
        return None if self.answered is None else int(np.count_nonzero(~self.answered))


class State(NamedTuple):
    """Content of the controller's ~/state messages."""

    stamp: Integers  # ns
    labels: list[str]  # of the first message
    values: dict[str, Floats]  # by label; NaN where a law has no such term


class ValveRecording(NamedTuple):
    """Everything that was recorded of one valve."""

    name: str
    topics: ValveTopics
    signals: dict[str, Samples]  # by part
    recorded: dict[str, Samples]  # likewise, with NaN
    state: State | None
    journal: list[Block]  # what the controller took in, if it was asked for
    accounts: dict[tuple[int, int], Account]  # what it remembered, by journal and row, likewise
    since: int  # ns, the beginning of the part that was asked for; journal and accounts begin with the bag
    controller: parameters.Node | None
    simulator: parameters.Node | None
    modes: list[modes.Interval]  # without a gap; [] if they are not known
    problems: list[str]
    doubts: list[str]  # those of them that are about the signals' messages
    coarse: bool  # whether stamps do not tell latency, jitter and gaps
    paired: bool = False  # whether voltages belong to readings by row or number, which tells no latency

    @property
    def lockstep(self) -> bool:
        """Whether the run was in lockstep, so that wall time means nothing."""
        return self.controller is not None and self.controller.initial.get("lockstep") is True

    @property
    def period(self) -> float:
        """Sample period [s]: the recorded parameter, else the median interval of the readings."""
        if self.controller is not None and "sample_period" in self.controller.initial:
            return float(self.controller.initial["sample_period"])
        intervals = np.diff(self.signals["spool_position"].time)
        return float(np.median(intervals)) * 1e-9 if len(intervals) else np.nan


class Recording(NamedTuple):
    """A loaded bag: its valves, with signals in volts and seconds."""

    bag: Bag
    valves: dict[str, ValveRecording]
    problems: list[str]
    clock: Clock  # of all times


def load(
    path: Path | str,
    maps: Sequence[str] = (),
    start: float | None = None,
    end: float | None = None,
    journals: bool = False,
    clock: str | None = None,
) -> Recording:
    """Load a bag, or its part recorded from ``start`` to ``end`` [s] after its beginning.

    What tells of the nodes counts from the bag's beginning. ``journals``: load the controllers' journals too,
    which only a shadow replay needs; ``clock``: log or publish, whose times are taken for all (default:
    publish, if it is fit for all signals). Raises BagError if nothing can be analysed.
    """
    bag = Bag(path)
    topics = find_valves(bag, maps)
    groups = [[source.topic for source in valve.sources.values()] for valve in topics.values()]
    states = {valve.state for valve in topics.values() if valve.state}
    fields = {name: [f"data[{label}]" for label in STATE_FIELDS] for name in states}
    for source in (source for valve in topics.values() for source in valve.sources.values()):
        if source.field not in fields.setdefault(source.topic, []):
            fields[source.topic].append(source.field)
    sound = {name: topic for name, topic in bag.topics.items() if not topic.unreadable}
    diagnostics = [n for n, t in sound.items() if t.type == modes.TYPE and n.endswith("/diagnostics")]
    raw = {parameters.TOPIC, *diagnostics}
    if journals:
        raw |= {topic for valve in topics.values() for topic in (valve.journal, valve.memory)}
    raw &= sound.keys()
    labels = {name: _labels(bag, name) for name in states}

    first = bag.begin + nanoseconds(start or 0.0, "--from")
    last = None if end is None else bag.begin + nanoseconds(end, "--to")
    read = bag.read(fields, raw, None if start is None else first, last)
    series = without_strays(read, bag.problems)
    if bag.table is not None and clock is not None:
        raise BagError(f"--clock {clock}: {path} is a table, whose rows have one time ({bag.table.clock})")
    used = decide(series, groups, clock, bag.path) if bag.table is None else Clock(bag.table.clock)
    bag.problems += used.notes
    series = used.read(series)
    nodes = parameters.history(series.get(parameters.TOPIC), bag.problems)
    since, received = 0, used.name == "log_time"
    if start is not None:  # by the clock that counts
        times = (series[name].publish_time for group in groups for name in group)
        since = min((int(time.min()) for time in times if len(time)), default=first)
        nodes = {name: node.from_time(since) for name, node in nodes.items()}
    words = modes.words([series[name] for name in diagnostics], bag.problems)
    valves = {
        name: _valve(valve, series, labels.get(valve.state, []), nodes, words, since, received, bag.table)
        for name, valve in topics.items()
    }
    if not any(len(s.time) for valve in valves.values() for s in valve.signals.values()):
        part = "" if start is None and end is None else " in this part of its time"
        why = "; ".join(doubt for valve in valves.values() for doubt in valve.doubts)
        raise BagError(
            f"{path} has no message on any topic of a valve{part}, so there is nothing to analyse"
            + (f" ({why})" if why else "")
        )
    return Recording(bag, valves, bag.problems, used)


def chosen(path: Path | str, valves: Mapping[str, V], of: str | None) -> V:
    """The valve ``of`` of a bag, or its only one. Raises BagError."""
    if of is None and len(valves) > 1:
        raise BagError(f"{path} has the valves {', '.join(valves)}; choose one with --of")
    name = next(iter(valves)) if of is None else of
    if name not in valves:
        raise BagError(f"{path} has no valve {name}; it has {', '.join(valves)}")
    return valves[name]


def nanoseconds(time: float, option: str) -> int:
    """``time`` [s] of a command-line option. Raises BagError unless it is finite and not negative."""
    if not 0.0 <= time <= 1e9:
        raise BagError(f"{option} is {time}; it must be a number of seconds from 0 to 1e9")
    return round(time * 1e9)


def _journal(notes: Series | None, problems: list[str]) -> list[Block]:
    if notes is None:
        return []
    blocks: list[Block] = []
    unreadable = 0
    for raw in notes.raw:
        message = deserialized(raw, STATE_TYPE)
        try:
            blocks.append(block(message.data))
        except (AttributeError, ValueError, IndexError):
            unreadable += 1
    if unreadable:
        problems.append(f"{unreadable} messages on ~/journal are no journal and are left out")
    return [part for part in blocks if len(part.rows)]


def _accounts(notes: Series | None) -> dict[tuple[int, int], Account]:
    if notes is None:
        return {}
    texts = (raw[8:].rstrip(b"\0").decode(errors="replace") for raw in notes.raw)
    found = filter(None, map(account, texts))
    return {(told.run, told.row): told for told in found}


def _labels(bag: Bag, topic: str) -> list[str]:
    message = next(bag.messages(topic), None)
    try:
        return [] if message is None else places(bag.topic(topic), message).labels("data")
    except BagError:
        return []


def _valve(
    topics: ValveTopics,
    series: dict[str, Series],
    labels: list[str],
    nodes: dict[str, parameters.Node],
    words: dict[str, list[modes.Word]],
    since: int,
    received: bool,
    table: TableFile | None,
) -> ValveRecording:
    problems: list[str] = []
    recorded, signals, pairs = clean(topics.sources, series, problems, table, received)
    doubts = list(problems)
    # Of several controllers the one whose state or journal is read.
    near = [node for name, node in nodes.items() if name.rpartition("/")[0] == topics.namespace and node.kind]
    kinds = {node.kind: node for node in near}
    own = nodes.get((topics.state or topics.journal).rpartition("/")[0])
    if own is not None and own.kind in kinds:
        kinds[own.kind] = own
    state = None
    stamp, mode = np.empty(0, dtype=np.int64), np.empty(0)
    if topics.state and len(series[topics.state].log_time):
        got = series[topics.state]
        named = {label: got.values[f"data[{label}]"] for label in STATE_FIELDS}
        stamp = got.publish_time if pairs is None else pairs.of(got.publish_time, got.place)
        state, mode = State(stamp, labels, named), named["mode"]
    for part in PARTS:
        if part not in signals:
            problems.append(f"{topics.name} has no {part}; what needs it is left out")
    if topics.state == "" and table is None:
        problems.append(f"{topics.name} has no ~/state of its controller: no estimates and no V2")
    journal = _journal(series.get(topics.journal), problems)
    accounts = _accounts(series.get(topics.memory))
    if "controller" not in kinds and not accounts and table is None:
        problems.append(f"{topics.name}: the bag has no parameters of its controller")
    for node in kinds.values():
        if node.missing and not (accounts and node.kind == "controller"):
            problems.append(
                f"the bag does not have {node.missing} parameters of {node.name} from its beginning"
            )
    intervals: list[modes.Interval] = []
    if filled := [samples.time for samples in recorded.values() if len(samples.time)]:
        begin, end = min(int(time[0]) for time in filled), max(int(time[-1]) for time in filled) + 1
        heard = modes.of_controller(words, topics.namespace, topics.state)
        intervals = modes.history(heard, stamp, mode, max(begin, since), end)
    return ValveRecording(
        name=topics.name,
        topics=topics,
        signals=signals,
        recorded=recorded,
        state=state,
        journal=journal,
        accounts=accounts,
        since=since,
        controller=kinds.get("controller"),
        simulator=kinds.get("valve_simulator"),
        modes=intervals,
        problems=problems,
        doubts=doubts,
        coarse=pairs is not None and not pairs.crossed,
        paired=table is not None or (pairs is not None and pairs.crossed),
    )


def at_time(signals: Aligned, stamp: int) -> float:
    """Time [s] of a run at ``stamp`` [ns], in lockstep that of the next sample."""
    if signals.wall:
        return (stamp - int(signals.stamp[0])) * 1e-9
    return float(signals.time[min(int(np.searchsorted(signals.stamp, stamp)), len(signals.time) - 1)])


def align(valve: ValveRecording) -> Aligned:
    """Pair command, measurement and voltage at each LVDT reading from the first command on.

    The command is the newest one sent before the voltage that answers the reading, or ``_between`` those that
    are rare; the voltage is the one in force until the next reading, or until the next one is due: where that
    was lost, the voltage in answer to it can still be there. Raises BagError without readings.
    """
    if "spool_position" not in valve.signals or len(valve.signals["spool_position"].time) == 0:
        raise BagError(f"{valve.name} has no spool_position, so no signal can be aligned")
    stamp = valve.signals["spool_position"].time
    measurement = valve.signals["spool_position"].value
    period = valve.period
    if not period > 0.0:
        raise BagError(f"{valve.name}: the readings have no interval, so no sample period is known")
    until = np.append(stamp[1:], stamp[-1] + round(period * 1e9))
    precise = not (valve.coarse or valve.paired)
    seen: Integers = stamp
    voltage: Floats = np.full(len(stamp), np.nan)
    latency = np.empty(0)
    answered: npt.NDArray[np.bool_] = np.ones(len(stamp), dtype=np.bool_)
    voltages = valve.signals.get("valve_voltage")
    if voltages is not None and len(voltages.time):
        after = np.searchsorted(voltages.time, stamp, side="right")
        answer = voltages.time[np.minimum(after, len(voltages.time) - 1)]
        answered = (answer > stamp) & (answer <= until)
        if precise:
            latency = seconds(answer[answered], stamp[answered])
        seen = np.where(answered, answer, stamp)
        newest = np.searchsorted(voltages.time, until, side="left") - 1
        if precise:
            due = stamp + round(period * 1e9)
            within = np.searchsorted(voltages.time, due, side="left") - 1
            gap = until - stamp > LATE * period * 1e9
            newest = np.where(gap, np.where(answered, np.maximum(within, after), within), newest)
        voltage = _held(voltages, newest)
    command: Floats = np.full(len(stamp), np.nan)
    commands = valve.signals.get("spool_command")
    if commands is not None and len(commands.time):
        command = _held(commands, np.searchsorted(commands.time, seen, side="right") - 1)
        if not (valve.paired or valve.lockstep):
            command = _between(commands, stamp, command, round(period * 1e9))
    first = max(int(np.argmax(np.isfinite(signal))) for signal in (command, voltage))
    time = seconds(stamp, int(stamp[first]))
    if valve.lockstep:
        time = (np.arange(len(stamp), dtype=np.float64) - first) * period
    return Aligned(
        time=time[first:],
        stamp=stamp[first:],
        period=period,
        command=command[first:],
        measurement=measurement[first:],
        voltage=voltage[first:],
        latency=latency,
        answered=answered[first:] if precise else None,
        wall=not valve.lockstep,
    )


def _between(commands: Samples, stamp: Integers, held: Floats, period: int) -> Floats:
    """Command [V] at each ``stamp`` [ns]: between rare ``commands`` a straight line, ``held`` at steps."""
    apart, change = np.diff(commands.time), np.abs(np.diff(commands.value))
    if len(apart) == 0 or np.median(apart) < BETWEEN * period:
        return held
    beside = np.maximum(np.append(0.0, change[:-1]), np.append(change[1:], 0.0))
    moving = np.append((apart < PAUSE) & (change <= STEP * beside), False)
    line = np.interp(stamp - commands.time[0], commands.time - commands.time[0], commands.value)
    return np.where(moving[np.searchsorted(commands.time, stamp, side="right") - 1], line, held)


def voltages_before(valve: ValveRecording, stamp: Integers) -> Floats:
    """Newest recorded voltage [V] before each ``stamp`` [ns]; NaN before the first."""
    voltages = valve.signals["valve_voltage"]
    return _held(voltages, np.searchsorted(voltages.time, stamp, side="left") - 1)


def _held(samples: Samples, index: Integers) -> Floats:
    """Value at ``index``, NaN before the first."""
    return np.where(index >= 0, samples.value[np.maximum(index, 0)], np.nan)
