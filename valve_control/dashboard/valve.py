# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Holds what the page knows of one valve and of its nodes."""

import asyncio
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.dashboard.changes import Change, Changes, Comparison, differing, joined
from valve_control.dashboard.entry import Field
from valve_control.dashboard.history import History
from valve_control.dashboard.latency import Latencies
from valve_control.parameter import Value, Values

LOG = 1000  # lines
MARKS = 500
PRESENT = 1.0  # s  a signal whose newest sample is older is silent
ECHO = 2.0  # s  in which a node's word about its parameters may be about what was set from here
PAIRED = 2000  # readings that a late voltage may still belong to
LAW = "controller"  # the parameter that names the law
SIGNALS = ("command", "position", "error", "voltage")
# What one does not tune, and what takes no part in undo and in the sets A and B.
NOT_TUNED = ("save_file", "load_file", "state_topics", "autostart", "use_sim_time")


class Line(NamedTuple):
    """A line of a valve's log."""

    number: int  # counted over all lines
    time: float  # s
    level: str  # info, warning or error
    text: str


class Mark(NamedTuple):
    """A moment that the plots show."""

    time: float  # s
    text: str
    change: Change | None = None  # that it shows
    where: str = ""  # name of the node before the text, if it is not the controller


class NodeState:
    """A node of a valve: how it describes its parameters, and their values."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.fields: dict[str, Field] = {}  # {} until it has answered
        self.values: Values = {}
        self.services: frozenset[str] = frozenset()  # names without the node's
        self.present = True
        self.asking = False  # it was started anew and has not told its parameters since
        self.state = ""  # of its life: active, inactive ...; "" if it is not known
        self.failing = False  # it says that something is wrong
        self.wanting = ""  # sentence about what it lacks beside a controller of this version, "" if nothing
        self.changes = Changes()
        self.comparison = Comparison()
        self.lost: Values = {}  # values that were in force before it was started anew, where they differ
        self.drafts: dict[str, str] = {}  # typed and not applied
        self.refusals: dict[str, str] = {}  # reasons by name
        self.version = 0  # of all that the form shows
        self.turn = asyncio.Lock()  # changes from here follow one another: each waits for the node's answer
        self._own: deque[tuple[float, str, Value]] = deque(maxlen=500)  # what was set from here, and when

    def tuned(self) -> Values:
        """Values that take part in undo and in the sets A and B."""
        return {
            name: value
            for name, value in self.values.items()
            if name not in NOT_TUNED and name in self.fields and not self.fields[name].read_only
        }

    def answered(self, fields: Mapping[str, Field], values: Mapping[str, Value]) -> None:
        """Take in what the node has told of itself after its start, or after it was first seen."""
        before = {**self.tuned(), **self.lost}  # it may have been started twice before anybody looked
        self.fields, self.values, self.asking = dict(fields), dict(values), False
        self.lost = differing(self.tuned(), before)
        self.changes.forget()
        self.version += 1

    def asks(self, changes: Mapping[str, Value], time: float) -> None:
        """Note that ``changes`` are on their way to the node from ``time`` [s] on."""
        self._own.extend((time, name, value) for name, value in changes.items())

    def asked(self, changes: Mapping[str, Value], reason: str, time: float, origin: str) -> Change | None:
        """Note the node's answer to ``changes``: refused with a ``reason``, or in force with ""."""
        self.version += 1
        if reason:
            return None
        return self._take(changes, time, origin)

    def observed(self, values: Mapping[str, Value], time: float) -> Change | None:
        """Take in values that the node says it has; returns what somebody else has changed.

        The node tells changes made from here too, sometimes late, when the next one has been made.
        """
        own = [(name, value) for asked, name, value in self._own if asked > time - ECHO]
        foreign = {name: value for name, value in values.items() if (name, value) not in own}
        change = self._take(foreign, time, "from elsewhere")
        if change is not None:
            self.version += 1
        return change

    def _take(self, values: Mapping[str, Value], time: float, origin: str) -> Change | None:
        after = differing(self.values, values)
        if not after:
            return None
        before = {name: self.values[name] for name in after}
        self.values.update(after)
        for name in after:
            self.drafts.pop(name, None)
            self.refusals.pop(name, None)
            self.lost.pop(name, None)
        tuned = {name: value for name, value in after.items() if name not in NOT_TUNED}
        if not tuned:
            return None
        return Change(time, {name: before[name] for name in tuned}, tuned, origin)


class Valve:
    """Signals, log, marks and nodes of the valve in one namespace."""

    def __init__(self, namespace: str) -> None:
        self.namespace = namespace  # "/" or such as "/boom"
        self.signals = {name: History() for name in SIGNALS}
        self.terms: dict[str, History] = {}
        self.labels: tuple[str, ...] = ()
        self.unnamed = False  # the controller publishes a state whose numbers have no names
        self.axis: dict[
            str, History
        ] = {}  # of an axis that it moves: position, goal [m], pressure_a [bar] ...
        self.latencies = Latencies()
        self.commanders: list[str] = []  # nodes that publish commands
        self.listeners = 0  # subscriptions that a command reaches
        self.missing = 0  # messages that the page did not see, by their numbers
        self.log: deque[Line] = deque(maxlen=LOG)
        self.marks: deque[Mark] = deque(maxlen=MARKS)
        self.controller: NodeState | None = None
        self.simulator: NodeState | None = None
        self.upper: NodeState | None = None  # of the axis
        self.strangers: list[str] = []  # nodes that publish voltages, and offer no parameters
        self.mode, self.reason = "", ""
        self.figures: dict[str, str] = {}  # of the controller's diagnostics
        self.period = 0.001  # s
        self._lines = 0
        self._readings = np.empty(0)  # times [s] of the newest ones

    @property
    def name(self) -> str:
        """Its name on the page."""
        return self.namespace.strip("/") or "valve"

    @property
    def nodes(self) -> Sequence[NodeState]:
        """Its nodes that are known."""
        return [node for node in (self.controller, self.simulator, self.upper) if node is not None]

    def say(self, time: float, level: str, text: str) -> None:
        """Write a line into the log."""
        self._lines += 1
        self.log.append(Line(self._lines, time, level, text))

    def mark(self, time: float, text: str) -> None:
        """Show a moment in the plots."""
        self.marks.append(Mark(time, text))

    def mark_change(self, change: Change, where: str, asked: float) -> None:
        """Show a change, asked for at ``asked`` [s], in the plots; moves of one slider are one mark."""
        last = self.marks[-1] if self.marks and self.marks[-1].where == where else None
        whole = joined(last.change if last else None, change, asked)
        if whole is not None:
            self.marks.pop()
        shown = whole or change
        self.marks.append(Mark(shown.time, f"{where}{shown.text}", shown, where))

    def status(self, level: str, mode: str, reason: str, figures: dict[str, str], time: float) -> None:
        """Take in the controller's diagnostics; what is new is said in the log."""
        if (mode, reason) != (self.mode, self.reason):
            self.say(time, level, f"{mode}: {reason}" if reason and reason != mode else mode)
        self.mode, self.reason, self.figures = mode, reason, figures
        with suppress(ValueError):
            period = 1e-3 * float(figures.get("period_ms", ""))
            self.period = period if 0.0 < period < np.inf else self.period

    def commanded(self, time: Floats, value: Floats) -> None:
        """Add commands [V] with their times [s]."""
        self.signals["command"].append(time, value)

    def read(self, time: Floats, value: Floats) -> None:
        """Add readings [V]; the error is reading minus the command that holds at that time."""
        if len(time) == 0:
            return
        self.signals["position"].append(time, value)
        self._readings = np.append(self._readings[-PAIRED:], time)
        command = self.signals["command"]
        begin = command.value_at(time[0])
        times, values = command.between(time[0], np.nextafter(time[-1], np.inf))
        held = np.append(begin, values)[np.searchsorted(times, time, side="right")]
        known = np.isfinite(held)
        self.signals["error"].append(time[known], (value - held)[known])

    def answered(self, time: Floats, value: Floats) -> None:
        """Add voltages [V], each the answer to a reading."""
        self.signals["voltage"].append(time, value)
        self.latencies.pair(self._readings, time)

    def told(self, labels: tuple[str, ...], time: Floats, rows: Floats) -> None:
        """Add rows of the controller's state, one column for each label."""
        if labels != self.labels:
            self.labels = labels
            for label in labels:
                self.terms.setdefault(label, History())
        for at, label in enumerate(labels):
            self.terms[label].append(time, rows[:, at])

    def moved(self, name: str, time: Floats, value: Floats) -> None:
        """Add readings of the axis that the valve moves: a position or goal [m], or a pressure [bar]."""
        self.axis.setdefault(name, History()).append(time, value)

    def silent(self, now: float) -> dict[str, float]:
        """Which of readings and voltages have not come for a second, and for how long [s] (inf: never)."""
        ages = {
            "readings": now - self.signals["position"].newest,
            "voltages": now - self.signals["voltage"].newest,
        }
        return {name: age for name, age in ages.items() if age > PRESENT}

    def live(self, now: float) -> bool:
        """Whether readings or voltages have come within the last second before ``now`` [s]."""
        return len(self.silent(now)) < 2
