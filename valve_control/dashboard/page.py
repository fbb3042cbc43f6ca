# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The page of one window; whether it may change the machine is checked here each time."""

import math
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

from nicegui import events, ui

from valve_control.dashboard.form import Form
from valve_control.dashboard.history import recent_indices
from valve_control.dashboard.machine import RESTING, Machine
from valve_control.dashboard.recording import Recording
from valve_control.dashboard.valve import Valve

REFRESH = 0.3  # s
SLOW = 1.0  # s
COLOURS = {"info": "", "warning": "vc-warning", "error": "vc-error"}
STYLE = Path(__file__).with_name("page.css")
NO_VALVE = (
    "No valve on the graph yet: no node publishes spool_position or valve_voltage. Start a controller, "
    "such as ros2 launch valve_control cascade.launch.xml, in this ROS_DOMAIN_ID and discovery range. It "
    "appears here by itself."
)
LOOK_ONLY = (
    "This window may only look: its address has no token, or a wrong one. The dashboard's terminal shows the "
    "whole one."
)


class Plots(ui.element, component="plots.js"):
    """The plots (plots.js)."""

    def __init__(self, on_act: Callable[[str], Awaitable[None]]) -> None:
        super().__init__()
        self.props["valve"] = ""

        async def act(event: events.GenericEventArguments) -> None:
            await on_act(str(event.args))

        self.on("act", act)

    def show(self, namespace: str) -> None:
        """Show the valve in ``namespace``."""
        if self.props["valve"] != namespace:
            self.props["valve"] = namespace
            self.update()


class Page:
    """One window with its page."""

    def __init__(self, machine: Machine, recording: Recording, may_write: bool) -> None:
        self._machine, self._recording, self._may_write = machine, recording, may_write
        self._shown: str | None = None
        self._logged = 0

    def allowed(self) -> bool:
        """Whether this window may change the machine; if not, says so."""
        if not self._may_write:
            self.tell(LOOK_ONLY)
        return self._may_write

    def tell(self, text: str) -> None:
        """Show one sentence for a while."""
        if not self._client.is_deleted:
            with self._root:
                ui.notify(text, type="warning", position="bottom", timeout=6000, textColor="white")

    @property
    def valve(self) -> Valve | None:
        """The valve that is shown."""
        return self._machine.valves.get(self._shown) if self._shown is not None else None

    def build(self) -> None:
        """Build the page."""
        self._client = ui.context.client
        ui.add_head_html(f"<style>{STYLE.read_text(encoding='utf-8')}</style>")
        ui.query("html").props('lang="en"')
        ui.colors(primary="#0072b2", negative="#b3261e", positive="#00664a", warning="#8a5a00")
        self._root = ui.element("div").classes("vc-page")
        with self._root:
            self._build_head()
            with ui.element("main").classes("vc-main"):
                with ui.element("section").classes("vc-see").props('aria-label="See"'):
                    self._indices = ui.label().classes("vc-indices").props("id=indices")
                    self._plots = Plots(self._act)
                with ui.element("section").classes("vc-side").props('aria-label="Tune"'):
                    self._build_side()
        ui.timer(REFRESH, self._refresh)
        ui.timer(SLOW, self._refresh_slowly)

    def _build_head(self) -> None:
        inert = "" if self._may_write else "inert"
        with ui.element("header").classes("vc-head"):
            ui.label("valve_control").classes("vc-title")
            self._choice = ui.select({}, on_change=self._choose).props('dense outlined aria-label="valve"')
            self._choice.classes("vc-choice")
            self._mode = ui.label("").classes("vc-mode").props("id=mode role=status")
            with ui.element("div").classes("vc-buttons").props(inert):
                self._record_button = ui.button("Record", on_click=self._record).props(
                    "id=record no-caps outline"
                )
                self._activate_button = ui.button("Activate", on_click=self._activate)
                self._activate_button.props("id=activate no-caps outline")
                self._reset_button = ui.button("Reset the axis", on_click=self._reset)
                self._reset_button.props("id=reset no-caps outline")
                stop = ui.button("STOP (space)", on_click=self._stop, color="negative")
                stop.props("id=stop no-caps").classes("vc-stop")
        ui.label("This window writes." if self._may_write else LOOK_ONLY).classes("vc-standing").props(
            "id=standing role=status"
        )
        self._record_state = ui.label("").classes("vc-standing").props("id=record-state role=status")
        self._notice = ui.label(NO_VALVE).classes("vc-notice").props("id=notice role=status")

    def _build_side(self) -> None:
        with ui.tabs().props("dense no-caps align=left") as tabs:
            tune, log, figures = (
                ui.tab(name).props(f"id=tab-{name.lower()}") for name in ("Tune", "Log", "Figures")
            )
        with ui.tab_panels(tabs, value=tune, keep_alive=True, animated=False).classes("vc-panels"):
            with ui.tab_panel(tune).props("" if self._may_write else "inert"):
                self._form = Form(self._machine, self.allowed, self.tell)
            with ui.tab_panel(log):
                self._log = ui.log(max_lines=400).classes("vc-log").props("id=log role=log")
            with ui.tab_panel(figures):
                self._figures = ui.label("no diagnostics yet").classes("vc-figures").props("id=figures")

    # What is done

    async def _act(self, act: str) -> None:
        """A key was pressed."""
        if act == "stop":
            await self._stop()
        elif act in ("undo", "redo"):
            await self._form.act(act)

    async def _stop(self) -> None:
        if self.allowed():
            for text in await self._machine.stop():
                self.tell(text)
            self._refresh()

    async def _activate(self) -> None:
        valve = self.valve
        if valve is not None and valve.controller is not None and self.allowed():
            reason = await self._machine.activate(valve, valve.controller)
            if reason:
                self.tell(reason)

    async def _reset(self) -> None:
        """End the stop of an axis."""
        valve = self.valve
        if valve is not None and "upper" in valve.nodes and self.allowed():
            answer = await self._machine.trigger(valve, valve.nodes["upper"], "reset")
            if not answer.done:
                self.tell(answer.text)

    def _record(self) -> None:
        """Begin a recording, or end the one that runs."""
        if not self.allowed():
            return
        if self._recording.running:
            self._recording.interrupt()
            return
        try:
            self._recording.start()
        except OSError as error:
            self.tell(f"the recorder cannot be started: {error.strerror}")

    def _choose(self) -> None:
        value = self._choice.value
        if isinstance(value, str) and value != self._shown:
            self._shown = value
            self._log.clear()
            self._logged = 0

    # Refreshing

    def _refresh(self) -> None:
        if self._client.is_deleted:
            return
        with self._machine.lock:
            options = {namespace: valve.name for namespace, valve in sorted(self._machine.valves.items())}
        if options != self._choice.options:
            self._choice.set_options(options, value=self._shown or next(iter(options), None))
            self._choose()
        self._choice.set_visibility(len(options) > 1)
        self._record_button.set_text("End recording" if self._recording.running else "Record")
        self._record_state.set_text(self._recording.text)
        valve = self.valve
        if valve is None:
            return
        self._plots.show(valve.namespace)
        with self._machine.lock:
            mode, notice = self._words(valve, time.time())
            lines = [line for line in valve.log if line.number > self._logged]
            upper, node = valve.nodes.get("upper"), valve.controller
        self._mode.set_text(mode)
        self._mode.classes(replace=f"vc-mode vc-mode-{mode.split(' ')[0].strip(':,')}")
        self._notice.set_text(notice)
        self._notice.set_visibility(bool(notice))
        self._reset_button.set_visibility(upper is not None and upper.failing)
        self._activate_button.set_visibility(node is not None and node.state == "inactive")
        for line in lines:
            stamp = time.strftime("%H:%M:%S", time.localtime(line.time))
            self._log.push(f"{stamp} {line.text}", classes=COLOURS.get(line.level, ""))
            self._logged = line.number
        self._form.show(valve)

    @staticmethod
    def _words(valve: Valve, now: float) -> tuple[str, str]:
        """Mode of the valve, and what is to be said about it beyond that."""
        node = valve.controller
        if node is None:
            return "no controller", f"{valve.name} has readings, but no controller publishes valve_voltage."
        if not node.present:
            return "gone", f"{node.name} is gone from the graph. When it is started again it appears here."
        notice = ""
        upper = valve.nodes.get("upper")
        if len(valve.commanders) > 1:
            notice = f"{' and '.join(valve.commanders)} command this valve at the same time; end all but one."
        elif upper is not None and upper.failing:
            notice = f"{upper.name}: {upper.state}"
        if node.state in RESTING:
            return node.state, notice
        silent = valve.silent(now)
        if silent:
            since = ", ".join(
                f"no {name} " + (f"since {age:.0f} s" if age < math.inf else "so far")
                for name, age in silent.items()
            )
            return f"silent: {since}", notice
        mode = valve.mode or "waiting for diagnostics"
        return f"{mode}: {valve.reason}" if valve.reason and valve.reason != mode else mode, notice

    def _refresh_slowly(self) -> None:
        valve = self.valve
        if valve is None:
            return
        with self._machine.lock:
            recent = recent_indices(
                valve.signals["error"], valve.signals["voltage"], 5.0, valve.period, time.time()
            )
            figures, missing = valve.figures, valve.missing
        lost = f"   readings lost {figures.get('lvdt_lost', '?')}, unseen here {missing}"
        if recent is None:
            self._indices.set_text(f"last 5 s: no error and voltage together{lost}")
        else:
            self._indices.set_text(
                f"last 5 s:  e_M {recent.e_M:.4f} V   e_rms {recent.e_rms:.4f} V   "
                f"u_rms {recent.u_rms:.3f} V   c_u {recent.c_u:.4f}{lost}"
            )
        if figures:
            self._figures.set_text("\n".join(f"{name}: {value}" for name, value in figures.items()))
