# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads the nodes' parameters and their changes from /parameter_events in a bag."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from valve_control.control.parameters.table import NODES
from valve_control.parameter import ParameterError, Values, defaults, lookup, updated
from valve_control.recordings.bags.bag import Series
from valve_control.recordings.bags.cdr import deserialized

TOPIC = "/parameter_events"
TYPE = "rcl_interfaces/msg/ParameterEvent"
# A parameter by which a node of this package is known, whatever its name.
MARKS = {"controller": "arc.k1", "valve_simulator": "friction.coulomb", "command_source": "scenario"}
# Values of a ParameterValue by its type from 1.
FIELDS = [
    f"{kind}_value"
    for kind in (
        "bool", "integer", "double", "string", "byte_array", "bool_array", "integer_array", "double_array",
        "string_array",
    )
]  # fmt: skip


class Change(NamedTuple):
    """Parameters of a node that changed at one moment."""

    time: int  # ns, source time
    values: dict[str, Any]  # what differs from before


class Node(NamedTuple):
    """Parameters of one node over time."""

    name: str  # with its namespace
    kind: str  # controller, valve_simulator, command_source or ""
    initial: dict[str, Any]
    changes: list[Change]

    @property
    def missing(self) -> int:
        """Parameters of a node of this package whose values at the beginning the bag does not have."""
        return sum(parameter.name not in self.initial for parameter in NODES.get(self.kind, ()))

    def from_time(self, time: int) -> "Node":
        """The same node as a recording that begins at ``time`` [ns] would have it."""
        initial = dict(self.initial)
        for change in self.changes:
            if change.time < time:
                initial.update(change.values)
        return self._replace(initial=initial, changes=[c for c in self.changes if c.time >= time])

    def table_values(self, values: Mapping[str, Any]) -> tuple[Values, list[str]]:
        """All values of a node of this package, and a sentence for each recorded one that it cannot take."""
        table = NODES[self.kind]
        taken = defaults(table)
        refused = []
        for name, value in values.items():
            if name in ("use_sim_time", "start_type_description_service"):
                continue
            try:
                lookup(table, name)
                taken = updated(table, taken, {name: value})
            except ParameterError as error:
                refused.append(f"recorded parameter of {self.name} not used: {error}")
        return taken, refused


def history(events: Series | None, problems: list[str]) -> dict[str, Node]:
    """Parameters over time of each node, from the messages of /parameter_events."""
    nodes: dict[str, Node] = {}
    if events is None:
        return nodes
    seen: dict[str, dict[str, Any]] = {}
    unreadable = 0
    for time, raw in sorted(zip(events.publish_time.tolist(), events.raw, strict=True), key=lambda e: e[0]):
        event = deserialized(raw, TYPE)
        if event is None:
            unreadable += 1
            continue
        values = {
            p.name: _plain(p.value)
            for p in (*event.new_parameters, *event.changed_parameters)
            if 0 < p.value.type <= len(FIELDS)
        }
        before = seen.setdefault(event.node, {})
        differs = {
            name: value for name, value in values.items() if name not in before or before[name] != value
        }
        node = nodes.setdefault(event.node, Node(event.node, "", {}, []))
        if not node.kind:
            node = nodes[event.node] = node._replace(kind=_kind(event.node, values))
        # A list may come in parts, of what was so from the beginning; a change holds only from now on.
        listed = {p.name for p in event.new_parameters}
        new = {name: value for name, value in differs.items() if name in listed and name not in before}
        node.initial.update(new)
        changed = {name: value for name, value in differs.items() if name not in new}
        if changed:
            node.changes.append(Change(time, changed))
        before.update(values)
    if unreadable:
        problems.append(f"{unreadable} messages of {TOPIC} could not be decoded and are left out")
    return nodes


def _plain(value: Any) -> Any:
    got = getattr(value, FIELDS[value.type - 1])
    return got.tolist() if hasattr(got, "tolist") else got


def _kind(name: str, values: Mapping[str, Any]) -> str:
    """Which node of this package it is: by a parameter that only one has, else by its name."""
    last = name.rpartition("/")[2]
    known = next((kind for kind, mark in MARKS.items() if mark in values), "")
    return known or (last if last in MARKS else "")
