# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The form of a valve's parameters, with undo, two sets to compare, and parameter files."""

from __future__ import annotations

import asyncio
from typing import Any

from nicegui import events, ui

from valve_control.dashboard.changes import differing
from valve_control.dashboard.entry import EntryError, Field, parse, scale, shown, slid
from valve_control.dashboard.valve import LAW, NodeState, Valve
from valve_control.dashboard.window import Window
from valve_control.parameter import Value

GENERAL = "general"
HIDDEN = ("save_file", "load_file", "use_sim_time", "start_type_description_service")
THROTTLE = 0.1  # s between two values of a slider that is drawn


class Row:
    """One parameter: its name, what was typed, a slider if it has a range, and why it was refused."""

    def __init__(self, form: Tuning, field: Field, node: NodeState) -> None:
        self.field = field
        self._form, self._node = form, node
        self._scale = scale(field)
        self._wanted: Value | None = None
        self._busy = False
        self._typing = False  # something was typed and not entered yet
        self._entered: str | None = None  # text whose answer is awaited
        self.box = ui.element("div").classes("vc-row").props(f'data-name="{field.name}"')
        with self.box:
            ui.label(field.name).classes("vc-name")
            self._entry = self._make_entry()
            if self._scale is not None:
                self._slider = ui.slider(min=0, max=1000, step=1).props(
                    f'aria-label="slider of {field.name}"'
                )
                self._slider.on("update:model-value", self._slid, throttle=THROTTLE)
            else:
                ui.element("span")
            words = [field.text, field.range_text]
            ui.label("; ".join(word for word in words if word)).classes("vc-help")
            self._refusal = ui.label("").classes("vc-refusal").props("role=alert")
        self.refresh()

    def _make_entry(self) -> ui.input | ui.select | ui.switch:
        field, title = self.field, f'aria-label="{self.field.name}"'
        if field.kind == "bool":
            return ui.switch(on_change=self._chosen).props(title)
        if field.choices:
            return ui.select(list(field.choices), on_change=self._chosen).props(f"dense outlined {title}")
        entry = ui.input().props(
            f'dense outlined inputmode="text" autocomplete="off" spellcheck="false" {title}'
        )
        entry.on("keydown.enter", self._typed)
        entry.on("blur", self._left)
        entry.on("update:model-value", self._edited, [])
        return entry

    def refresh(self) -> None:
        """Show the value that is in force, or what was typed and not applied."""
        name = self.field.name
        value = self._node.values.get(name)
        if value is None:
            return
        draft = self._node.drafts.get(name)
        if isinstance(self._entry, ui.input):
            if not self._typing and self._entered is None:
                self._entry.set_value(shown(value) if draft is None else draft)
        else:
            self._entry.value = value if draft is None else parse(self.field, draft)
        if self._scale is not None and not self._busy and isinstance(value, (int, float)):
            self._slider.set_value(self._scale.place(value))
        reason = self._node.refusals.get(name, "")
        self._refusal.set_text(reason)
        self._refusal.set_visibility(bool(reason))
        self.box.classes(add="vc-draft") if draft is not None else self.box.classes(remove="vc-draft")

    def _edited(self) -> None:
        self._typing = True

    async def _typed(self) -> None:
        self._typing = False
        await self._enter()

    async def _left(self) -> None:
        if self._typing:
            self._typing = False
            await self._enter()

    async def _enter(self) -> None:
        """Hand on what stands in the field, once: the field may be left while the answer is awaited."""
        text = str(self._entry.value)
        if text == self._entered:
            return
        self._entered = text
        try:
            value = self._node.values[self.field.name]
            if text.strip() == shown(value) and self.field.name not in self._node.drafts:
                self._node.refusals.pop(self.field.name, None)
            elif text != self._node.drafts.get(self.field.name) or self._form.at_once:
                await self._form.enter(self.field, text, self._node)
        finally:
            if self._entered == text:
                self._entered = None
        self.refresh()

    async def _chosen(self, event: events.ValueChangeEventArguments[Any]) -> None:
        text, node = shown(event.value), self._node
        if text != node.drafts.get(self.field.name, shown(node.values[self.field.name])):
            await self._form.enter(self.field, text, node)
            self.refresh()

    async def _slid(self, event: events.GenericEventArguments) -> None:
        """Apply the newest place; those that come while an answer is awaited are passed over but the last."""
        assert self._scale is not None
        self._wanted = slid(self.field, self._scale, float(event.args))
        if self._busy:
            return
        self._busy = True
        try:
            while self._wanted is not None:
                wanted, self._wanted = self._wanted, None
                await self._form.enter(self.field, shown(wanted), self._node)
        finally:
            self._busy = False
        self.refresh()


class Tuning:
    """The part of the page that tunes."""

    def __init__(self, page: Window) -> None:
        self._page = page
        self._rows: dict[str, Row] = {}
        self._groups: dict[str, ui.expansion] = {}
        self._bodies: dict[str, list[Field]] = {}
        self._shown: tuple[str, int] | None = None
        self._built_for: tuple[NodeState, dict[str, Field]] | None = None
        self._law: Value = ""
        self._build()

    @property
    def at_once(self) -> bool:
        """Whether each value is applied as soon as it is entered."""
        return bool(self._at_once.value)

    @property
    def _place(self) -> tuple[Valve, NodeState] | None:
        valve, node = self._page.valve, self._page.controller
        return None if valve is None or node is None else (valve, node)

    def _build(self) -> None:
        self._hint = ui.label("no controller yet").classes("vc-help").props("id=tune-hint")
        with self._page.controls():
            with ui.element("div").classes("vc-buttons"):
                self._at_once = ui.switch("apply at once", value=True, on_change=self._switched).props(
                    "id=at-once"
                )
                self._apply = self._button("Apply", self._apply_drafts, "apply")
                self._discard = self._button("Discard", self._discard_drafts, "discard")
            with ui.element("div").classes("vc-buttons"):
                self._undo = self._button("Undo (U)", lambda: self.act("undo"), "undo")
                self._redo = self._button("Redo (Y)", lambda: self.act("redo"), "redo")
                self._button("Keep as A", lambda: self._keep("A"), "keep-a")
                self._button("Keep as B", lambda: self._keep("B"), "keep-b")
                self._switch = self._button("A/B (X)", lambda: self.act("switch"), "switch")
            self._sets = ui.label("").classes("vc-help").props("id=sets")
            self._lost = self._button("", self._restore, "restore")
            self._refusal = ui.label("").classes("vc-refusal").props("id=refusal role=alert")
            with ui.element("div").classes("vc-buttons"):
                self._file = ui.input("file").props('dense outlined for=file autocomplete="off"')
                self._button("Save", lambda: self._use_field("save"), "save")
                self._button("Load", lambda: self._use_field("load"), "load")
            self._said = ui.label("").classes("vc-help").props("id=file-answer role=status")
            self._law_box = ui.element("div")
        self._filter = ui.input("find a parameter", on_change=self._filtered).props(
            "dense outlined clearable"
        )
        self._list = ui.element("div")

    def _button(self, text: str, act: events.Handler, name: str) -> ui.button:  # type: ignore[type-arg]
        return ui.button(text, on_click=act).props(f"id={name} dense no-caps outline")

    # Showing

    def show(self) -> None:
        """Show another valve."""
        self._shown = self._built_for = None
        self._clear()
        self._hint.set_text("no controller yet")
        self.refresh()

    def refresh(self) -> None:
        """Show what has changed."""
        place = self._place
        if place is None:
            return
        _, node = place
        if self._shown == (node.name, node.version):
            return
        self._shown = (node.name, node.version)
        if not node.fields:
            self._hint.set_text(f"{node.name} has not told its parameters yet")
            return
        self._hint.set_text(f"{node.name}: {len(node.fields)} parameters")
        if self._built_for is None or self._built_for[0] is not node or self._built_for[1] != node.fields:
            self._built_for = (node, node.fields)
            self._build_groups(node)
            self._file.set_value(str(node.values.get("save_file", "")))
        for row in self._rows.values():
            row.refresh()
        if LAW not in node.fields and GENERAL in self._groups and not self._rows:
            self._groups[GENERAL].set_value(True)
        elif node.values.get(LAW, "") != self._law:
            self._open_law(node)
        count = len(node.drafts)
        self._apply.set_text(f"Apply {count} together" if count else "Apply")
        self._apply.set_enabled(count > 0)
        self._discard.set_enabled(count > 0)
        self._undo.set_enabled(bool(node.changes.done))
        self._redo.set_enabled(bool(node.changes.undone))
        self._undo.props(f'title="{node.changes.done[-1].text}"' if node.changes.done else 'title=""')
        self._switch.set_enabled(bool(node.comparison.other()))
        self._sets.set_text(self._sets_text(node))
        self._lost.set_text(f"Set the {len(node.lost)} values again that were in force before the start")
        self._lost.set_visibility(bool(node.lost))

    @staticmethod
    def _sets_text(node: NodeState) -> str:
        sets = node.comparison.sets
        if not sets:
            return "A/B: keep two sets, then go to and fro with X"
        if len(sets) == 1:
            return f"set {next(iter(sets))} is kept"
        differ = differing(sets["A"], sets["B"])
        text = ", ".join(f"{name} {sets['A'][name]} / {value}" for name, value in sorted(differ.items())[:6])
        active = node.comparison.active
        state = "was changed since" if differing(node.tuned(), sets[active]) else "is in force"
        return f"set {active} {state}; A / B differ in {len(differ)}: {text}"

    def _clear(self) -> None:
        self._list.clear()
        self._law_box.clear()
        self._rows.clear()
        self._groups.clear()
        self._bodies.clear()
        self._law = ""

    def _build_groups(self, node: NodeState) -> None:
        self._clear()
        for name, field in node.fields.items():
            if name not in HIDDEN and name != LAW and not field.read_only:
                self._bodies.setdefault(name.partition(".")[0] if "." in name else GENERAL, []).append(field)
        if LAW in node.fields:
            with self._law_box:
                self._rows[LAW] = Row(self, node.fields[LAW], node)
        with self._list:
            for group in self._bodies:
                self._groups[group] = ui.expansion(
                    f"{group} ({len(self._bodies[group])})",
                    on_value_change=lambda e, g=group: self._opened(g, e.value),
                ).props(f"dense id=group-{group}")

    def _opened(self, group: str, open_: bool) -> None:
        """Make a group's rows when it is first opened."""
        place = self._place
        fields = self._bodies[group]
        if not open_ or place is None or (fields and fields[0].name in self._rows):
            return
        with self._groups[group], self._page.controls():
            for field in fields:
                self._rows[field.name] = Row(self, field, place[1])

    def _open_law(self, node: NodeState) -> None:
        """Open the group of the law in force, close that of the one before."""
        before, self._law = self._law, node.values.get(LAW, "")
        if before in self._groups:
            self._groups[str(before)].set_value(False)
        if self._law in self._groups:
            group = self._groups[str(self._law)]
            group.set_value(True)
            group.move(target_index=0)

    def _filtered(self) -> None:
        word = str(self._filter.value or "").strip().lower()
        for group, expansion in self._groups.items():
            found = [f.name for f in self._bodies[group] if word in f.name.lower() or word in f.text.lower()]
            expansion.set_visibility(bool(found))
            expansion.set_value(bool(found) if word else group == self._law)
            for field in self._bodies[group]:
                if field.name in self._rows:
                    self._rows[field.name].box.set_visibility(field.name in found)

    # Changing

    async def enter(self, field: Field, text: str, node: NodeState) -> None:
        """Take in what was typed for a parameter of ``node``: apply it, or keep it until ``Apply``.

        A slider that waits for an answer has its next value when another valve is shown: that is dropped.
        """
        place = self._place
        if place is None or place[1] is not node or not self._page.allowed():
            return
        valve = place[0]
        try:
            value = parse(field, text)
        except EntryError as error:
            node.drafts[field.name] = text
            node.refusals[field.name] = f"{error}; nothing was changed"
            node.version += 1
            self.refresh()
            return
        node.refusals.pop(field.name, None)
        if not self.at_once:
            node.drafts[field.name] = text
            if value == node.values[field.name]:
                del node.drafts[field.name]
            node.version += 1
            self.refresh()
            return
        node.drafts.pop(field.name, None)
        reason = await self._page.machine.change(valve, node, {field.name: value})
        if reason:
            node.drafts[field.name] = text
            node.refusals[field.name] = f"{reason}; nothing was changed"
            node.version += 1
        self.refresh()

    async def _apply_drafts(self) -> None:
        """Apply all that was typed as one change, or nothing."""
        place = self._place
        if place is None or not self._page.allowed():
            return
        valve, node = place
        values: dict[str, Value] = {}
        for name, text in node.drafts.items():
            try:
                values[name] = parse(node.fields[name], text)
                node.refusals.pop(name, None)
            except EntryError as error:
                node.refusals[name] = f"{error}; nothing was changed"
        if any(name in node.refusals for name in node.drafts):
            self._refusal.set_text("nothing was changed: see the reasons beside the fields")
        else:
            reason = await self._page.machine.change(valve, node, values)
            self._refusal.set_text(f"{reason}; none of the {len(values)} was changed" if reason else "")
            for name in values if reason else ():
                if name in reason:
                    node.refusals[name] = f"{reason}; nothing was changed"
        node.version += 1
        self.refresh()

    def _discard_drafts(self) -> None:
        place = self._place
        if place is not None and self._page.allowed():
            node = place[1]
            for name in list(node.drafts):
                node.refusals.pop(name, None)
            node.drafts.clear()
            node.version += 1
            self._refusal.set_text("")
            self.refresh()

    async def _switched(self) -> None:
        if self.at_once and self._place is not None and self._place[1].drafts:
            await self._apply_drafts()

    async def act(self, act: str) -> None:
        """Undo, redo or switch between A and B."""
        place = self._place
        if place is None or not self._page.allowed():
            return
        machine = self._page.machine
        reason = await {"undo": machine.undo, "redo": machine.redo, "switch": machine.switch}[act](*place)
        if reason:
            self._page.tell(reason)
        self.refresh()

    def _keep(self, which: str) -> None:
        place = self._place
        if place is not None and self._page.allowed():
            self._page.machine.keep(*place, which)
            self.refresh()

    async def _restore(self) -> None:
        """Set the values that were in force before the node was started anew."""
        place = self._place
        if place is None or not self._page.allowed():
            return
        valve, node = place
        reason = await self._page.machine.change(valve, node, dict(node.lost), "those from before the start")
        if reason:
            self._refusal.set_text(f"{reason}; nothing was changed")
        else:
            node.lost = {}
            node.version += 1
        self.refresh()

    async def _use_field(self, act: str) -> None:
        """Save to the file that is named, or load it."""
        if self._place is not None and self._page.allowed():
            name = str(self._file.value or "").strip()
            self._said.set_text(await self.use_file(act, name))

    async def use_file(self, act: str, name: str) -> str:
        """Save the values in force as YAML, or load such a file, by the services of the node; its answer."""
        place = self._place
        if place is None:
            return "there is no controller"
        valve, node = place
        parameter = f"{act}_file"
        if f"{act}_parameters" not in node.services or parameter not in node.values:
            return f"{node.name} is an older or another controller: it has no {act}_parameters"
        if not name:
            return "the name of the file is missing"
        reason = await self._page.machine.change(valve, node, {parameter: name})
        if not reason:
            answer = await self._page.machine.trigger(valve, node, f"{act}_parameters")
            reason = answer.text
            await asyncio.sleep(0.1)  # for the word of the node about its new values
        self.refresh()
        return reason
