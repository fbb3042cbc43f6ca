# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The page of one window; whether it may change the machine is checked here each time."""

import math
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from nicegui import events, ui

from valve_control.dashboard.doing import Doing
from valve_control.dashboard.drawing import histogram_svg
from valve_control.dashboard.history import recent_indices
from valve_control.dashboard.machine import Machine
from valve_control.dashboard.programs import Programs
from valve_control.dashboard.tuning import Tuning
from valve_control.dashboard.valve import NodeState, Valve
from valve_control.dashboard.writers import Writer, right

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
    "This window may only look: its address has no token. The dashboard's terminal shows the whole one."
)
WRONG_TOKEN = (
    "This window may only look: the token in its address is wrong. The dashboard's terminal shows the right "
    "one."
)
OTHER = "Another window writes; this one looks on."


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

    def __init__(
        self, machine: Machine, writer: Writer, programs: Programs, folder: Path, token: str, given: str
    ) -> None:
        self.machine = machine
        self.programs = programs
        self.folder = folder
        self._writer = writer
        self._tokened = right(token, given)
        self._wrong = bool(given) and not self._tokened
        self._shown: str | None = None
        self._guarded: list[ui.element] = []
        self._could: bool | None = None
        self._logged = 0

    # Who may

    @property
    def may_write(self) -> bool:
        """Whether this window may change the machine now."""
        return self._tokened and self._writer.writes(self._tab)

    @property
    def _tab(self) -> str:
        """The browser's name of this window, which outlives a reload; "" until it is connected."""
        return self._client.tab_id or ""

    def allowed(self) -> bool:
        """The same; if not, says so."""
        if not self.may_write:
            self.tell(self._standing()[0])
        return self.may_write

    def _standing(self) -> tuple[str, str]:
        """What this window may, in words, and what the button beside it does."""
        if not self._tokened:
            return WRONG_TOKEN if self._wrong else LOOK_ONLY, ""
        if self.may_write:
            return "This window writes.", ""
        return OTHER, "Write here"

    def tell(self, text: str, kind: str = "warning") -> None:
        """Show one sentence for a while."""
        if self._client.is_deleted:
            return
        with self._root:
            ui.notify(text, type="negative" if kind == "error" else "warning", position="top", timeout=6000)

    async def load(self, path: str) -> str:
        """Let the controller that is shown load a parameter file; its answer."""
        return await self._tuning.use_file("load", path)

    def say(self, valve: Valve, text: str, mark: bool = False) -> None:
        """Write a line into a valve's log, and a mark into its plots."""
        with self.machine.lock:
            now = time.time()
            valve.say(now, "info", text)
            if mark:
                valve.mark(now, text)

    @contextmanager
    def controls(self) -> Iterator[ui.element]:
        """What is made inside can be used only while this window writes."""
        with ui.element("div").classes("vc-controls").props("" if self.may_write else "inert") as box:
            self._guarded = [other for other in self._guarded if not other.is_deleted] + [box]
            yield box

    # What is shown

    @property
    def valve(self) -> Valve | None:
        """The valve that is shown."""
        return self.machine.valves.get(self._shown) if self._shown is not None else None

    @property
    def controller(self) -> NodeState | None:
        """Its controller."""
        valve = self.valve
        return valve.controller if valve is not None else None

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
                with ui.element("section").classes("vc-side").props('aria-label="Tune and do"'):
                    self._build_side()
        ui.timer(REFRESH, self._refresh)
        ui.timer(SLOW, self._refresh_slowly)

    def _build_head(self) -> None:
        with ui.element("header").classes("vc-head"):
            ui.label("valve_control").classes("vc-title")
            self._choice = ui.select({}, on_change=self._choose).props('dense outlined aria-label="valve"')
            self._choice.classes("vc-choice")
            self._mode = ui.label("").classes("vc-mode").props("id=mode role=status")
            ui.space()
            self._stop_button = ui.button("STOP (space)", on_click=self._stop, color="negative")
            self._stop_button.props("id=stop no-caps").classes("vc-stop")
            self._activate_button = ui.button("Activate", on_click=self._activate).props(
                "id=activate no-caps outline"
            )
            self._reset_button = ui.button("Reset the axis", on_click=self._reset).props(
                "id=reset no-caps outline"
            )
            self._reset_button.set_visibility(False)
        with ui.element("div").classes("vc-standing"):
            self._standing_label = ui.label("").props("id=standing role=status")
            self._claim_button = ui.button("Write here", on_click=self._claim).props(
                "id=claim dense no-caps outline"
            )
        self._notice = ui.label(NO_VALVE).classes("vc-notice").props("id=notice role=status")

    def _build_side(self) -> None:
        with ui.tabs().props("dense no-caps align=left") as tabs:
            names = [
                ui.tab(name).props(f"id=tab-{name.lower()}") for name in ("Tune", "Do", "Log", "Latency")
            ]
        with ui.tab_panels(tabs, value=names[0], keep_alive=True, animated=False).classes("vc-panels"):
            with ui.tab_panel(names[0]):
                self._tuning = Tuning(self)
            with ui.tab_panel(names[1]):
                self._doing = Doing(self)
            with ui.tab_panel(names[2]):
                self._log = ui.log(max_lines=400).classes("vc-log").props("id=log role=log")
            with ui.tab_panel(names[3]):
                self._histogram = ui.html("", sanitize=False).classes("full-width").props("id=latency")
                self._latency = ui.label("no voltages yet")

    # What is done

    async def _act(self, act: str) -> None:
        """A key was pressed."""
        if act == "stop":
            await self._stop()
        elif act in ("undo", "redo", "switch"):
            await self._tuning.act(act)

    async def _stop(self) -> None:
        """Every window with the token may stop, also one that does not write."""
        if not self._tokened:
            self.tell(self._standing()[0])
            return
        self.programs.end_moving()
        said = await self.machine.stop()
        for text in said:
            self.tell(text, "error")
        self._refresh()

    async def _activate(self) -> None:
        valve, node = self.valve, self.controller
        if valve is None or node is None or not self.allowed():
            return
        reason = await self.machine.activate(valve, node)
        if reason:
            self.tell(reason)

    async def _reset(self) -> None:
        """End the stop of an axis."""
        valve = self.valve
        if valve is None or valve.upper is None or not self.allowed():
            return
        answer = await self.machine.trigger(valve, valve.upper, "reset")
        if not answer.done:
            self.tell(answer.text)

    def _claim(self) -> None:
        if self._tokened:
            self._writer.claim(self._tab, time.monotonic(), by_force=True)

    def _choose(self) -> None:
        value = self._choice.value
        if isinstance(value, str) and value != self._shown:
            self._shown = value
            self._log.clear()
            self._logged = 0
            self._tuning.show()
            self._doing.show()

    # Refreshing

    def _refresh(self) -> None:
        if self._client.is_deleted:
            return
        if self._tokened:
            self._writer.claim(self._tab, time.monotonic())
        now = time.time()
        with self.machine.lock:
            options = {namespace: valve.name for namespace, valve in sorted(self.machine.valves.items())}
        if options != self._choice.options:
            self._choice.set_options(options, value=self._shown or next(iter(options), None))
            self._choose()
        self._choice.set_visibility(len(options) > 1)
        self._refresh_standing()
        valve = self.valve
        if valve is None:
            return
        self._plots.show(valve.namespace)
        with self.machine.lock:
            mode, notice = self._words(valve, now)
            notices = [notice] if notice else self._notices(valve)
            lines = [line for line in valve.log if line.number > self._logged]
        self._mode.set_text(mode)
        self._mode.classes(replace=f"vc-mode vc-mode-{mode.split(' ')[0].strip(':,')}")
        self._notice.set_text("\n".join(notices))
        self._notice.set_visibility(bool(notices))
        upper = valve.upper
        self._reset_button.set_visibility(upper is not None and upper.failing and self.may_write)
        node = valve.controller
        resting = node is not None and node.state == "inactive"
        self._activate_button.set_visibility(resting and self.may_write)
        for line in lines:
            stamp = time.strftime("%H:%M:%S", time.localtime(line.time))
            self._log.push(f"{stamp} {line.text}", classes=COLOURS.get(line.level, ""))
            self._logged = line.number
        self._tuning.refresh()
        self._doing.refresh()

    def _refresh_standing(self) -> None:
        text, button = self._standing()
        self._standing_label.set_text(text)
        self._claim_button.set_visibility(bool(button))
        may = self.may_write
        if may != self._could:
            self._could = may
            for box in (box for box in self._guarded if not box.is_deleted):
                box.props(remove="inert") if may else box.props("inert")
            self._stop_button.set_enabled(self._tokened)

    def _words(self, valve: Valve, now: float) -> tuple[str, str]:
        """Mode of the valve, and what is to be said about it beyond that."""
        node = valve.controller
        if node is None:
            unknown = " and ".join(valve.strangers)
            return "no controller", (
                f"valve_voltage comes from {unknown}, which offers no parameters: no controller of "
                "valve_control. Its signals can be watched; there is nothing to tune or to stop here."
                if unknown
                else f"{valve.name} has readings, but no controller publishes valve_voltage."
            )
        if not node.present:
            return "gone", f"{node.name} is gone from the graph. When it is started again it appears here."
        if node.state in ("inactive", "unconfigured"):
            return node.state, ""
        silent = valve.silent(now)
        if silent:
            since = ", ".join(
                f"no {name} " + (f"since {age:.0f} s" if age < math.inf else "so far")
                for name, age in silent.items()
            )
            return f"silent: {since}", ""
        mode = valve.mode or "waiting for diagnostics"
        return f"{mode}: {valve.reason}" if valve.reason and valve.reason != mode else mode, ""

    @staticmethod
    def _notices(valve: Valve) -> list[str]:
        """What is to be said about a valve besides its mode."""
        said = [node.wanting for node in valve.nodes if node.present and node.wanting]
        if valve.unnamed and valve.controller is not None:
            said.append(
                f"{valve.controller.name}/state does not name its numbers: the terms of the law cannot be "
                "shown."
            )
        if len(valve.commanders) > 1:
            said.append(
                f"{' and '.join(valve.commanders)} command this valve at the same time; end all but one."
            )
        if valve.upper is not None and valve.upper.failing:
            said.append(f"{valve.upper.name}: {valve.upper.state}")
        return said

    def _refresh_slowly(self) -> None:
        valve = self.valve
        if valve is None:
            return
        with self.machine.lock:
            found = recent_indices(
                valve.signals["error"], valve.signals["voltage"], 5.0, valve.period, time.time()
            )
            histogram = valve.latencies.histogram()
            missing = valve.missing
            counts = {name: valve.figures.get(name, "") for name in ("lvdt_lost", "overruns")}
        lost = f"   readings lost {counts['lvdt_lost'] or '?'}, unseen here {missing}"
        if found is None:
            self._indices.set_text(f"last 5 s: no error and voltage together{lost}")
        else:
            self._indices.set_text(
                f"last 5 s:  e_M {found.e_M:.4f} V   e_rms {found.e_rms:.4f} V   "
                f"u_rms {found.u_rms:.3f} V   c_u {found.c_u:.4f}{lost}"
            )
        if histogram is not None:
            self._histogram.set_content(histogram_svg(histogram))
            self._latency.set_text(
                f"reading to voltage: median {histogram.p50:.3f} ms, 99 % below {histogram.p99:.3f} ms, "
                f"largest {histogram.largest:.3f} ms; the last {int(histogram.counts.sum())} voltages"
            )
