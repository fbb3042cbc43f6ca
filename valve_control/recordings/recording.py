# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Loads a bag as valves with their signals, cleaned and aligned to the LVDT readings."""

import struct
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats, Integers
from valve_control.control.analysis.timing import LATE
from valve_control.control.supervision.journal import Block, block
from valve_control.control.supervision.state_snapshot import Account, account
from valve_control.recordings import modes, parameters
from valve_control.recordings.bags.bag import FAR, Bag, Series
from valve_control.recordings.bags.cdr import UNDECODABLE, Decoder, jazzy
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.cleaning import Samples, clean, seconds
from valve_control.recordings.clocks import Clock, decide, of_table, without_strays
from valve_control.recordings.mapping import STATE_TYPE, ValveTopics, find_valves
from valve_control.recordings.stamps import fields, retimed

ESTIMATES = ("a1", "a0", "b0", "b0dn")
V = TypeVar("V")
LAG_ROWS = 200  # accounts on ~/state by which answers are matched with readings
LONGEST_LAG = 12  # readings
STATE_FIELDS = (
    "sample",
    "mode",
    "measurement",
    "voltage",
    "lyapunov",
    "lyapunov_bound",
    *ESTIMATES,
)


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
    timed: dict[str, Samples]  # likewise, with NaN
    recorded: dict[str, Samples]  # likewise, with NaN and all publishers
    state: State | None
    journal: list[Block]  # what the controller took in, if it was asked for
    accounts: dict[tuple[int, int], Account]  # what it remembered, by journal and row, likewise
    since: int  # ns, the beginning of the part that was asked for; journal and accounts begin with the bag
    controller: parameters.Node | None
    simulator: parameters.Node | None
    modes: list[modes.Interval]  # without a gap; [] if they are not known
    problems: list[str]
    doubts: list[str]  # those of them that are about the signals' messages
    clock: Clock  # of all times
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
    nodes: dict[str, parameters.Node]
    problems: list[str]
    clock: Clock  # of all times


def _wanted(
    bag: Bag, topics: Mapping[str, ValveTopics], journals: bool
) -> tuple[dict[str, list[str]], set[str], set[str], list[str]]:
    """Fields to read by topic, then the topics of states, of whole messages and of diagnostics."""
    wanted: dict[str, list[str]] = {}
    states = {valve.state for valve in topics.values() if valve.state}
    for valve in topics.values():
        for source in valve.sources.values():
            wanted.setdefault(source.topic, [])
            if source.field not in wanted[source.topic]:
                wanted[source.topic].append(source.field)
    for name in states:
        terms = [f"data[{label}]" for label in STATE_FIELDS]
        wanted[name] = [*terms, *(field for field in wanted.get(name, ()) if field not in terms)]
    diagnostics = modes.diagnostic_topics(bag)
    raw = {parameters.TOPIC, *diagnostics}
    if journals:
        raw |= {topic for valve in topics.values() for topic in (valve.journal, valve.memory)}
    raw &= {name for name, topic in bag.topics.items() if not topic.unreadable}
    return wanted, states, raw, diagnostics


class _Request(NamedTuple):
    """What is to be read of a bag."""

    path: Path | str  # as it was given
    wanted: dict[str, list[str]]  # fields by topic
    states: set[str]  # topics of laws' states
    raw: set[str]  # topics of whole messages
    groups: list[list[str]]  # topics of the signals of each valve
    start: float | None  # s  after the bag's beginning
    end: float | None  # s
    clock: str | None

    def span(self, begin: int) -> tuple[int, int | None]:
        """Beginning and end [ns] of the part, of a bag that begins at ``begin`` [ns]."""
        first = begin if self.start is None else begin + nanoseconds(self.start, "--from")
        return first, None if self.end is None else begin + nanoseconds(self.end, "--to")


def _read(
    bag: Bag, asked: _Request, hears: Callable[[int], None] | None
) -> tuple[dict[str, Series], Clock, int]:
    """Series by topic, the clock of all their times, and the beginning of the part [ns]. Raises BagError."""
    wanted, states, raw = asked.wanted, asked.states, asked.raw
    first, last = asked.span(bag.begin)
    signals = [name for group in asked.groups for name in group]
    stamped = fields(bag, signals, asked.clock) if bag.table is None else {}
    for name, names in stamped.items():
        wanted.setdefault(name, []).extend(names)
    if stamped:
        series = bag.read(wanted, raw=raw, sparse=states, told=hears)
    elif asked.start is None:
        series = bag.read(wanted, raw=raw, sparse=states, end=last, told=hears)
    else:
        # What is known of the nodes counts from the bag's beginning, whatever part is asked for.
        series = bag.read(wanted, sparse=states, start=first, end=last, told=hears)
        series |= bag.read({}, raw=raw, end=last)
    found: list[str] = []
    series = without_strays(series, found)
    if bag.table is not None:
        ruling = of_table(bag.table, asked.clock)
    else:
        ruling = decide(series, asked.groups, None if stamped else asked.clock, asked.path)
    if stamped:
        series, ruling = retimed(series, stamped, ruling, signals)
        series = without_strays(series, found)
    apart = ruling.source and ruling.apart
    if (apart or stamped) and (asked.start is not None or asked.end is not None):
        if apart:
            # The part that was read is one of times of recording.
            found.clear()
            series = without_strays(bag.read(wanted, raw=raw, sparse=states), found)
        sent = [series[name].publish_time for name in signals]
        first, last = asked.span(min(int(time.min()) for time in sent if len(time)))
        series = {
            name: one.pick(
                ((name in raw) | (one.publish_time >= first))
                & (one.publish_time < (np.inf if last is None else last))
            )
            for name, one in series.items()
        }
    bag.problems += [*found, *ruling.notes]
    return ruling.read(series), ruling, first


def load(
    path: Path | str,
    maps: Sequence[str] = (),
    start: float | None = None,
    end: float | None = None,
    told: Callable[[Bag], Callable[[int], None]] | None = None,
    journals: bool = False,
    clock: str | None = None,
) -> Recording:
    """Load a bag, or its part from ``start`` to ``end`` [s] after its beginning.

    ``told`` takes the opened bag and returns a function that is called with the number of bytes read since
    its last call; ``journals``: load the controllers' journals too, which only a shadow replay needs;
    ``clock``: log, publish, header (stamps in headers) or /clock (a simulated clock), whose times are taken
    for all (default: publish, if it is fit for all signals).
    Raises BagError if nothing can be analysed.
    """
    bag = Bag(path)
    topics = find_valves(bag, maps)
    wanted, states, raw, diagnostics = _wanted(bag, topics, journals)
    labels = {name: _labels(bag, name) for name in states}
    groups = [[source.topic for source in valve.sources.values()] for valve in topics.values()]
    asked = _Request(path, wanted, states, raw, groups, start, end, clock)
    series, ruling, first = _read(bag, asked, told(bag) if told else None)
    since = 0 if start is None else first
    nodes = parameters.history(series.get(parameters.TOPIC), bag.problems)
    if start is not None:
        nodes = {name: node.from_time(first) for name, node in nodes.items()}
    said = modes.words([series[name] for name in diagnostics], bag.problems)
    valves = {
        name: _valve(
            valve, series, labels.get(valve.state, []), nodes, said, since, ruling, bag.table is not None
        )
        for name, valve in topics.items()
    }
    if not any(len(s.time) for valve in valves.values() for s in valve.signals.values()):
        part = "" if start is None and end is None else " in this part of its time"
        why = "; ".join(doubt for valve in valves.values() for doubt in valve.doubts)
        raise BagError(
            f"{path} has no message on any topic of a valve{part}, so there is nothing to analyse"
            + (f" ({why})" if why else "")
        )
    return Recording(bag, valves, nodes, bag.problems, ruling)


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
    kind = jazzy().get_msgdef(STATE_TYPE)
    blocks = []
    unreadable = 0
    for raw in notes.raw:
        try:
            message: Any = kind.deserialize_cdr_le(raw[4:], 0, kind.cls, jazzy())[0]
            blocks.append(block(message.data))
        except UNDECODABLE:
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
    message = bag.first(topic)
    try:
        return [] if message is None else Decoder(bag.topic(topic), ()).labels(message)
    except (BagError, struct.error):
        return []


def _valve(
    topics: ValveTopics,
    series: dict[str, Series],
    labels: list[str],
    nodes: dict[str, parameters.Node],
    said: dict[str, list[modes.Word]],
    since: int,
    clock: Clock,
    rows: bool,
) -> ValveRecording:
    problems: list[str] = []
    cleaned = clean(topics.sources, series, problems, rows, received=clock.name == "log_time")
    signals = _together(cleaned.usable, problems)
    doubts = list(problems)
    kinds = _kinds(topics, nodes)
    state = None
    if topics.state and len(series[topics.state].log_time):
        got = series[topics.state]
        named = {label: got.values[f"data[{label}]"] for label in STATE_FIELDS}
        stamp = got.publish_time if cleaned.ties is None else cleaned.ties.of(got.publish_time, got.place)
        state = State(stamp, labels, named)
    for part in ("spool_command", "spool_position", "valve_voltage"):
        if part not in signals:
            problems.append(f"{topics.name} has no {part}; what needs it is left out")
    if topics.state == "" and not rows:
        problems.append(f"{topics.name} has no ~/state of its controller: no estimates and no V2")
    journal = _journal(series.get(topics.journal), problems)
    accounts = _accounts(series.get(topics.memory))
    if "controller" not in kinds and not accounts and not rows:
        problems.append(f"{topics.name}: the bag has no parameters of its controller")
    for node in kinds.values():
        if node.missing and not (accounts and node.kind == "controller"):
            problems.append(
                f"the bag does not have {node.missing} parameters of {node.name} from its beginning"
            )
    return ValveRecording(
        name=topics.name,
        topics=topics,
        signals=signals,
        timed=cleaned.timed,
        recorded=cleaned.recorded,
        state=state,
        journal=journal,
        accounts=accounts,
        since=since,
        controller=kinds.get("controller"),
        simulator=kinds.get("valve_simulator"),
        modes=_modes(topics, said, state, cleaned.timed, since),
        problems=problems,
        doubts=doubts,
        clock=clock,
        coarse=cleaned.ties is not None and not cleaned.ties.crossed and (cleaned.ties.several or not rows),
        paired=rows or (cleaned.ties is not None and cleaned.ties.crossed),
    )


def _kinds(topics: ValveTopics, nodes: Mapping[str, parameters.Node]) -> dict[str, parameters.Node]:
    """Nodes of a valve by their kind; of several controllers the one whose state or journal is read."""
    kinds = {node.kind: node for node in nodes.values() if node.namespace == topics.namespace and node.kind}
    own = nodes.get((topics.state or topics.journal).rpartition("/")[0])
    return {**kinds, own.kind: own} if own is not None and own.kind in kinds else kinds


def _together(signals: Mapping[str, Samples], problems: list[str]) -> dict[str, Samples]:
    """``signals`` without the messages of those that were recorded hours before or after the readings."""
    kept = dict(signals)
    readings = signals.get("spool_position")
    if readings is None or len(readings.time) == 0:
        return kept
    begin, end = int(readings.time[0]), int(readings.time[-1])
    for part, one in signals.items():
        if len(one.time) == 0:
            continue
        apart = max(begin - int(one.time[-1]), int(one.time[0]) - end) * 1e-9
        if apart > FAR:
            problems.append(
                f"{one.topic} and {readings.topic} have no time in common ({apart / 3600.0:.3g} h lie "
                f"between them); {one.topic} is left out"
            )
            kept[part] = one.pick(slice(0, 0))
    return kept


def _modes(
    topics: ValveTopics,
    said: dict[str, list[modes.Word]],
    state: State | None,
    signals: dict[str, Samples],
    since: int,
) -> list[modes.Interval]:
    """The controller's modes from the first to the last message of its signals."""
    filled = [samples.time for samples in signals.values() if len(samples.time)]
    if not filled:
        return []
    begin, end = min(int(time[0]) for time in filled), max(int(time[-1]) for time in filled) + 1
    told = modes.of_controller(said, topics.namespace, topics.state)
    none = np.empty(0, dtype=np.int64)
    stamp, mode = (none, np.empty(0)) if state is None else (state.stamp, state.values["mode"])
    return modes.history(told, stamp, mode, max(begin, since), end)


def at_time(signals: Aligned, stamp: int) -> float:
    """Time [s] of a run at ``stamp`` [ns], in lockstep that of the next sample."""
    if signals.wall:
        return (stamp - int(signals.stamp[0])) * 1e-9
    return float(signals.time[min(int(np.searchsorted(signals.stamp, stamp)), len(signals.time) - 1)])


def align(valve: ValveRecording) -> Aligned:
    """Pair command, measurement and voltage at each LVDT reading from the first command on.

    The command is the newest one sent before the voltage that answers the reading; the voltage is the one in
    force until the next reading, or until the next one is due: where that was lost, the voltage in answer to
    it can still be there. Raises BagError without readings.
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
        # Where answers take longer than a period, others come between a reading and its own.
        own = np.arange(len(stamp)) + _lag(valve, stamp, voltages)
        later = np.minimum(own, len(stamp) - 1)
        after = np.searchsorted(voltages.time, stamp[later], side="right")
        answer = voltages.time[np.minimum(after, len(voltages.time) - 1)]
        answered = (answer > stamp[later]) & (answer <= until[later]) & (own == later)
        if precise:
            latency = seconds(answer[answered], stamp[answered])
        seen = np.where(answered, answer, stamp)
        newest = np.searchsorted(voltages.time, until[later], side="left") - 1
        if precise:
            due = stamp[later] + round(period * 1e9)
            within = np.searchsorted(voltages.time, due, side="left") - 1
            gap = until[later] - stamp[later] > LATE * period * 1e9
            newest = np.where(gap, np.where(answered, np.maximum(within, after), within), newest)
        voltage = _held(voltages, newest)
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


def voltages_before(valve: ValveRecording, stamp: Integers) -> Floats:
    """Newest recorded voltage [V] before each ``stamp`` [ns]; NaN before the first."""
    voltages = valve.signals["valve_voltage"]
    return _held(voltages, np.searchsorted(voltages.time, stamp, side="left") - 1)


def _lag(valve: ValveRecording, stamp: Integers, voltages: Samples) -> int:
    """Number of readings between a reading and its voltage, as ~/state shows; 0 if it does not."""
    if valve.state is None:
        return 0
    measured, given = valve.state.values["measurement"], valve.state.values["voltage"]
    rows = np.flatnonzero(np.isfinite(measured) & np.isfinite(given) & (given != 0.0))
    rows = rows[:: max(1, len(rows) // LAG_ROWS)]
    readings = valve.signals["spool_position"].value
    votes = np.zeros(LONGEST_LAG, dtype=np.int64)
    for row in rows.tolist():
        newest = int(np.searchsorted(voltages.time, valve.state.stamp[row], side="right"))
        near = np.flatnonzero(voltages.value[max(0, newest - 3) : newest] == given[row])
        if len(near) == 0:
            continue
        moment = voltages.time[max(0, newest - 3) + int(near[-1])]
        before = int(np.searchsorted(stamp, moment)) - np.arange(1, LONGEST_LAG + 1)
        votes += (before >= 0) & (readings[np.maximum(before, 0)] == measured[row])
    return int(np.argmax(votes))


def _held(samples: Samples, index: Integers) -> Floats:
    """Value at ``index``, NaN before the first."""
    return np.where(index >= 0, samples.value[np.maximum(index, 0)], np.nan)
