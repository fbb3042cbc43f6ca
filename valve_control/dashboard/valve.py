# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Holds what the page knows of one valve and of its nodes."""

import asyncio
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.dashboard.changes import Change, Changes, differing, joined
from valve_control.dashboard.history import History
from valve_control.parameter import Parameter, Value, Values

LOG = 1000  # lines
MARKS = 500
PRESENT = 1.0  # s  a signal whose newest sample is older is silent
ECHO = 2.0  # s  in which a node's word about its parameters may be about what was set from here
SIGNALS = ("command", "position", "error", "voltage")
FILES = ("save_file", "load_file")  # parameters that take no part in undo and are not in the form


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
    node: str = ""  # whose parameters were changed


class NodeState:
    """A node of a valve: how it describes its parameters, and their values."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.fields: dict[str, Parameter] = {}  # {} until it has answered
        self.values: Values = {}
        self.services: frozenset[str] = frozenset()  # names without the node's
        self.present = True
        self.asking = False  # it was started anew and has not told its parameters since
        self.state = ""  # of its life: active, inactive ...; "" if it is not known
        self.failing = False  # it says that something is wrong
        self.changes = Changes()
        self.version = 0  # of all that the form shows
        self.turn = asyncio.Lock()  # changes from here follow one another: each waits for the node's answer
        self._sent: deque[tuple[float, str, Value]] = deque(maxlen=500)  # what was set from here, and when

    def answered(self, fields: Mapping[str, Parameter], values: Mapping[str, Value]) -> None:
        """Take in what the node has told of itself after its start, or after it was first seen."""
        self.fields, self.values, self.asking = dict(fields), dict(values), False
        self.changes = Changes()
        self.version += 1

    def asks(self, changes: Mapping[str, Value], time: float) -> None:
        """Note that ``changes`` are on their way to the node from ``time`` [s] on."""
        self._sent.extend((time, name, value) for name, value in changes.items())

    def observed(self, values: Mapping[str, Value], time: float) -> Change | None:
        """Take in values that the node says it has; returns what somebody else has changed.

        The node tells changes made from here too, sometimes late, when the next one has been made.
        """
        sent = [(name, value) for asked, name, value in self._sent if asked > time - ECHO]
        foreign = {name: value for name, value in values.items() if (name, value) not in sent}
        return self.take(foreign, time, "from elsewhere")

    def take(self, values: Mapping[str, Value], time: float, origin: str) -> Change | None:
        """Take in ``values`` that are in force from ``time`` [s] on; the change that can be taken back."""
        after = differing(self.values, values)
        before = {name: self.values[name] for name in after if name not in FILES}
        if after:
            self.values.update(after)
            self.version += 1
        return Change(time, before, {name: after[name] for name in before}, origin) if before else None


class Valve:
    """Signals, log, marks and nodes of the valve in one namespace."""

    def __init__(self, namespace: str) -> None:
        self.namespace = namespace  # "/" or such as "/boom"
        self.signals = {name: History() for name in SIGNALS}  # also term.NAME and axis.NAME
        self.commanders: list[str] = []  # nodes that publish commands
        self.missing = 0  # messages that the page did not see, by their numbers
        self.log: deque[Line] = deque(maxlen=LOG)
        self.marks: deque[Mark] = deque(maxlen=MARKS)
        self.nodes: dict[str, NodeState] = {}  # controller, simulator, upper level, source of commands
        self.mode, self.reason = "", ""
        self.figures: dict[str, str] = {}  # of the controller's diagnostics
        self.period = 0.001  # s
        self._lines = 0

    @property
    def name(self) -> str:
        """Its name on the page."""
        return self.namespace.strip("/") or "valve"

    @property
    def controller(self) -> NodeState | None:
        """The node that publishes the voltage."""
        return self.nodes.get("controller")

    def say(self, time: float, level: str, text: str) -> None:
        """Write a line into the log."""
        self._lines += 1
        self.log.append(Line(self._lines, time, level, text))

    def mark(self, time: float, text: str) -> None:
        """Show a moment in the plots."""
        self.marks.append(Mark(time, text))

    def note(self, node: NodeState, change: Change | None, asked: float) -> None:
        """Log and mark a change, asked for at ``asked`` [s]; moves of one slider are one mark."""
        if change is None:
            return
        where = "" if node is self.controller else f"{node.name}: "
        self.say(change.time, "info", f"{where}{change.text} ({change.origin})")
        last = self.marks[-1] if self.marks and self.marks[-1].node == node.name else None
        whole = joined(last.change if last else None, change, asked)
        if whole is not None:
            self.marks.pop()
        shown = whole or change
        self.marks.append(Mark(shown.time, f"{where}{shown.text}", shown, node.name))

    def status(self, level: str, mode: str, reason: str, figures: dict[str, str], time: float) -> None:
        """Take in the controller's diagnostics; what is new is said in the log."""
        if (mode, reason) != (self.mode, self.reason):
            self.say(time, level, f"{mode}: {reason}" if reason and reason != mode else mode)
        self.mode, self.reason, self.figures = mode, reason, figures
        with suppress(ValueError):
            period = 1e-3 * float(figures.get("period_ms", ""))
            self.period = period if 0.0 < period < np.inf else self.period

    def add(self, name: str, time: Floats, value: Floats) -> None:
        """Add samples of a signal with their times [s]: V, of an axis m or bar."""
        self.signals.setdefault(name, History()).append(time, value)

    def read(self, time: Floats, value: Floats) -> None:
        """Add readings [V]; the error is reading minus the command that holds at that time."""
        self.add("position", time, value)
        command = self.signals["command"]
        begin = command.value_at(time[0])
        times, values = command.between(time[0], np.nextafter(time[-1], np.inf))
        held = np.append(begin, values)[np.searchsorted(times, time, side="right")]
        known = np.isfinite(held)
        self.add("error", time[known], (value - held)[known])

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
