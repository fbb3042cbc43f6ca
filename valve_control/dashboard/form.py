# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The form of a node's parameters, as the node itself describes them, with undo and parameter files."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Callable
from typing import Any

from nicegui import events, ui

from valve_control.control.parameters.ros_file import from_text
from valve_control.dashboard.machine import Machine
from valve_control.dashboard.slider import STEPS, scale
from valve_control.dashboard.valve import FILES, NodeState, Valve
from valve_control.parameter import Parameter, ParameterError, Value

LAW = "controller"  # the parameter that names the law
GENERAL = "general"
HIDDEN = (*FILES, "use_sim_time", "start_type_description_service")
THROTTLE = 0.1  # s between two values of a slider that is drawn


def shown(value: Value) -> str:
    """Text of ``value``, from which ``from_text`` makes it again."""
    return value if isinstance(value, str) else json.dumps(value)


class Row:
    """One parameter: its name, its value, a slider if it has a range, and why a value was refused."""

    def __init__(self, form: Form, valve: Valve, node: NodeState, parameter: Parameter) -> None:
        self.name = parameter.name
        self._form, self._valve, self._node, self._parameter = form, valve, node, parameter
        self._scale = scale(parameter)
        self._last: Value | None = None  # that was shown
        title = f'aria-label="{self.name}"'
        self.box = ui.element("div").classes("vc-row").props(f'data-name="{self.name}"')
        with self.box:
            ui.label(self.name).classes("vc-name")
            self._entry: Any  # ui.switch, ui.select or ui.input, by the parameter's kind
            if isinstance(parameter.default, bool):
                self._entry = ui.switch(on_change=self._chosen).props(title)
            elif parameter.choices:
                self._entry = ui.select(list(parameter.choices), on_change=self._chosen)
                self._entry.props(f"dense outlined {title}")
            else:
                self._entry = ui.input().props(f'dense outlined autocomplete="off" {title}')
                self._entry.on("change", self._typed)
            if self._scale is not None:
                self._slider = ui.slider(min=0, max=STEPS).props(f'aria-label="slider of {self.name}"')
                self._slider.on("update:model-value", self._slid, throttle=THROTTLE)
            else:
                self._entry.classes("vc-wide")
            limited = math.isfinite(parameter.high - parameter.low) and not parameter.choices
            between = parameter.range_text if limited else ""
            ui.label("; ".join(filter(None, (parameter.text, between)))).classes("vc-help")
            self._refusal = ui.label("").classes("vc-refusal").props("role=alert")
        self.refresh()

    def refresh(self) -> None:
        """Show the value that is in force, if it is another than before; what is being typed stays."""
        value = self._node.values.get(self.name)
        if value is None or value == self._last:
            return
        self._last = value
        self._refusal.set_text("")
        self._entry.set_value(shown(value) if isinstance(self._entry, ui.input) else value)
        if self._scale is not None and isinstance(value, (int, float)):
            self._slider.set_value(self._scale.place(value))

    async def _chosen(self, event: events.ValueChangeEventArguments[Any]) -> None:
        if event.value != self._node.values[self.name]:
            await self._set(event.value)
            self._entry.set_value(self._node.values[self.name])

    async def _typed(self, event: events.GenericEventArguments) -> None:
        text = str(event.args).strip()
        if self._parameter.type_name == "double" and text.lstrip("+-").isdecimal():
            text += ".0"  # 3 is a gain too: unlike a file, the form knows the type
        try:
            value = from_text(self._parameter, text)
        except ParameterError as error:
            self._refusal.set_text(f"{error}; nothing was changed")
        else:
            await self._set(value)

    async def _slid(self, event: events.GenericEventArguments) -> None:
        assert self._scale is not None
        await self._set(self._scale.value(float(event.args)))

    async def _set(self, value: Value) -> None:
        reason = await self._form.change(self._valve, self._node, self.name, value)
        self._refusal.set_text(f"{reason}; nothing was changed" if reason else "")
        if not reason:
            self._last = None
            self.refresh()


class Form:
    """The parameters of one of a valve's nodes."""

    def __init__(self, machine: Machine, allowed: Callable[[], bool], tell: Callable[[str], None]) -> None:
        self._machine, self._allowed, self._tell = machine, allowed, tell
        self._rows: dict[str, Row] = {}
        self._groups: dict[str, ui.expansion] = {}
        self._members: dict[str, list[Parameter]] = {}
        self._valve: Valve | None = None
        self._built: tuple[NodeState, dict[str, Parameter]] | None = None
        self._version = -1
        self._law: Value = ""
        self._node = ui.select({}, on_change=self.refresh).props('dense outlined id=node aria-label="node"')
        with ui.element("div").classes("vc-buttons"):
            self._undo = self._button("Undo (U)", "undo", lambda: self.act("undo"))
            self._redo = self._button("Redo (Y)", "redo", lambda: self.act("redo"))
        self._files = ui.element("div").classes("vc-buttons")
        with self._files:
            self._file = ui.input("file").props('dense outlined for=file autocomplete="off"')
            self._button("Save", "save", lambda: self._use_file("save"))
            self._button("Load", "load", lambda: self._use_file("load"))
        self._answer = ui.label("").classes("vc-help").props("id=file-answer role=status")
        self._law_box = ui.element("div").classes("vc-fields")
        self._filter = ui.input("find a parameter", on_change=self._filtered)
        self._filter.props("dense outlined clearable")
        self._list = ui.element("div").classes("vc-fields")

    @staticmethod
    def _button(text: str, name: str, act: events.Handler[events.ClickEventArguments]) -> ui.button:
        return ui.button(text, on_click=act).props(f"id={name} dense no-caps outline")

    @property
    def node(self) -> NodeState | None:
        """The node whose parameters are shown."""
        nodes = self._valve.nodes.values() if self._valve is not None else ()
        return next((node for node in nodes if node.name == self._node.value), None)

    # Showing

    def show(self, valve: Valve) -> None:
        """Show the nodes of ``valve``, and what has changed."""
        self._valve = valve
        names = [node.name for node in valve.nodes.values() if node.fields]
        if names != self._node.options:
            value = self._node.value if self._node.value in names else next(iter(names), None)
            self._node.set_options(names, value=value)
        self.refresh()

    def refresh(self) -> None:
        """Show what has changed."""
        node, valve = self.node, self._valve
        if node is None or valve is None:
            self._clear()
            return
        if self._built is None or self._built[0] is not node or self._built[1] is not node.fields:
            self._clear()
            self._built = (node, node.fields)
            self._build(valve, node)
        elif self._version == node.version:
            return
        self._version = node.version
        for row in self._rows.values():
            row.refresh()
        if node.values.get(LAW, "") != self._law:
            self._open_law(node)
        self._undo.set_enabled(bool(node.changes.done))
        self._redo.set_enabled(bool(node.changes.undone))
        self._undo.props(f'title="{node.changes.done[-1].text}"' if node.changes.done else 'title=""')

    def _clear(self) -> None:
        self._built = None
        self._list.clear()
        self._law_box.clear()
        self._rows.clear()
        self._groups.clear()
        self._members.clear()
        self._law = ""

    def _build(self, valve: Valve, node: NodeState) -> None:
        for name, parameter in node.fields.items():
            if name not in (*HIDDEN, LAW):
                group = name.partition(".")[0] if "." in name else GENERAL
                self._members.setdefault(group, []).append(parameter)
        if LAW in node.fields:
            with self._law_box:
                self._rows[LAW] = Row(self, valve, node, node.fields[LAW])
        with self._list:
            for group, members in self._members.items():
                self._groups[group] = ui.expansion(
                    f"{group} ({len(members)})",
                    on_value_change=lambda e, g=group: self._opened(valve, node, g, e.value),
                ).props(f"dense id=group-{group}")
        if LAW not in node.fields and GENERAL in self._groups:
            self._groups[GENERAL].set_value(True)
        self._files.set_visibility({"save_parameters", "load_parameters"} <= node.services)
        self._file.set_value(str(node.values.get("save_file", "")))

    def _opened(self, valve: Valve, node: NodeState, group: str, open_: bool) -> None:
        """Make a group's rows when it is first opened."""
        members = self._members[group]
        if open_ and members[0].name not in self._rows:
            with self._groups[group]:
                self._rows |= {p.name: Row(self, valve, node, p) for p in members}

    def _open_law(self, node: NodeState) -> None:
        """Open the group of the law in force, close that of the one before."""
        before, self._law = self._law, node.values.get(LAW, "")
        if before in self._groups:
            self._groups[str(before)].set_value(False)
        if self._law in self._groups:
            self._groups[str(self._law)].set_value(True)
            self._groups[str(self._law)].move(target_index=0)

    def _filtered(self) -> None:
        word = str(self._filter.value or "").strip().lower()
        for group, expansion in self._groups.items():
            members = self._members[group]
            matching = {p.name for p in members if word in p.name.lower() or word in p.text.lower()}
            expansion.set_visibility(bool(matching))
            expansion.set_value(bool(matching) if word else group == self._law)
            for p in members:
                if p.name in self._rows:
                    self._rows[p.name].box.set_visibility(p.name in matching)

    # Changing

    async def change(self, valve: Valve, node: NodeState, name: str, value: Value) -> str:
        """Set a parameter of a ``node`` of ``valve``; the reason if it is refused, else ""."""
        if not self._allowed():
            return "this window may only look"
        return await self._machine.change(valve, node, {name: value})

    async def act(self, act: str) -> None:
        """Undo or redo."""
        node, valve = self.node, self._valve
        if node is not None and valve is not None and self._allowed():
            reason = await self._machine.act(valve, node, act)
            if reason:
                self._tell(reason)
            self.refresh()

    async def _use_file(self, act: str) -> None:
        """Save the values in force as YAML, or load such a file, by the services of the node."""
        node, valve, name = self.node, self._valve, str(self._file.value or "").strip()
        if node is None or valve is None or not self._allowed():
            return
        reason = await self._machine.change(valve, node, {f"{act}_file": name})
        if not reason:
            reason = (await self._machine.trigger(valve, node, f"{act}_parameters")).text
            await asyncio.sleep(0.1)  # for the word of the node about its new values
        self._answer.set_text(reason)
        self.refresh()
