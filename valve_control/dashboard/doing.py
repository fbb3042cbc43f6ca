# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What one does with a valve from the page: command it, record it, inject faults, run identify and tune."""

from __future__ import annotations

import math
import re
import shlex
import time
from collections.abc import Sequence
from functools import partial

from nicegui import ui

from valve_control.control.commands.scenarios import SCENARIOS
from valve_control.control.parameters.build import as_text
from valve_control.control.parameters.table import COMMAND
from valve_control.dashboard.entry import EntryError, number, parse
from valve_control.dashboard.generator import check, paced
from valve_control.dashboard.programs import Program
from valve_control.dashboard.valve import Valve
from valve_control.dashboard.window import Window
from valve_control.parameter import ParameterError, Values, defaults, lookup, updated

GENERATOR, RECORDER, REPORT, RUN = "generator", "recorder", "report", "run"  # places of programs
SHAPE = (
    "amplitude", "offset", "frequency", "end_frequency", "sweep_time", "max_velocity", "max_accel", "cycle",
    "duration",
)  # fmt: skip
FIRST = {"amplitude": "1.0", "frequency": "1.0", "end_frequency": "10.0", "duration": "60.0"}
LIMITS = {"largest command [V]": "3.0", "fastest command [V/s]": "200.0"}
RUNS = ("identify", "tune", "commission")  # of valve-control
EXAMPLES = {
    "identify": "--set lvdt.noise=0.005 --output valve.yaml --figure bode.png",
    "tune": "--controller pid --budget 200 --output tuned.yaml",
    "commission": "--node {node} --max-voltage 4 --travel 2 --folder commission{valve} --yes",
}
EXPLAINED = {
    "identify": "Identifies the valve of the parameter files in simulation, or a recorded one: name its bag "
    "first. Nothing on the graph is touched.",
    "tune": "Searches gains on simulated valves. Nothing on the graph is touched; load what it writes to try "
    "it.",
    "commission": "Moves the spool of this valve within the limits in the arguments: tests it, tunes its "
    "law, sets the gains and verifies them, without further question. Cancel or STOP leads to 0 V and to "
    "the parameters from before.",
}
MOVING = ("commission",)
LOADED = ("identify", "tune")  # whose parameter files are not in force yet
FAULTS = ("fault.lvdt", "fault.valve", "fault.samples", "fault.jump")
SHOWN_LINES = 30


def named(name: str) -> ui.element:
    """A box with an id of the page."""
    return ui.element("div").props(f"id={name}")


class Doing:
    """The part of the page that commands, records and runs."""

    def __init__(self, page: Window) -> None:
        self._page = page
        self._fields: dict[str, ui.input] = {}
        self._limits: dict[str, ui.input] = {}
        self._faults: dict[str, ui.select | ui.input] = {}
        self._fault_version: tuple[str, int] | None = None
        with page.controls():
            self._build_generator()
            self._build_recorder()
            self._fault_box = ui.element("div")
            self._build_runs()

    # Command generator

    def _build_generator(self) -> None:
        ui.label("Command").classes("vc-title")
        self._scenario = ui.select(list(SCENARIOS), value="sine").props(
            'dense outlined id=scenario aria-label="shape"'
        )
        with ui.element("div").classes("vc-grid"):
            for name in SHAPE:
                parameter = lookup(COMMAND, name)
                text = FIRST.get(name, as_text(parameter.default))
                with named(f"command-{name}"):
                    self._fields[name] = ui.input(f"{name} [{parameter.unit}]", value=text).props(
                        'dense outlined autocomplete="off"'
                    )
            for title, text in LIMITS.items():
                self._limits[title] = ui.input(title, value=text).props('dense outlined autocomplete="off"')
        with ui.element("div").classes("vc-buttons"):
            ui.button("Start command", on_click=self._start).props("id=start no-caps dense outline")
            ui.button("End command", on_click=self._end).props("id=end no-caps dense outline")
        self._command_state = ui.label("").classes("vc-help").props("id=command-state role=status")
        self._command_refusal = ui.label("").classes("vc-warning").props("id=command-refusal role=alert")

    def _shape(self, valve: Valve) -> Values:
        """Parameters of the command source inside the limits. Raises ParameterError."""
        typed: dict[str, float] = {}
        try:
            for name, field in (self._fields | self._limits).items():
                typed[name] = number(str(field.value))
        except EntryError as error:
            raise ParameterError(f"{name}: {error}") from error
        limits = [typed.pop(title) for title in LIMITS]
        node = valve.controller
        values = node.values if node is not None else {}
        changes: Values = {"scenario": str(self._scenario.value), **typed, **paced(valve)}
        made = updated(COMMAND, defaults(COMMAND), changes)
        bound = values.get("command_limit", limits[0])
        assert isinstance(bound, (int, float))
        check(made, min(limits[0], bound), limits[1])
        return {name: made[name] for name in changes}

    def _start(self) -> None:
        valve = self._page.valve
        if valve is None or not self._page.allowed():
            return
        reason = self._refused(valve)
        if not reason:
            try:
                shape = self._shape(valve)
            except ParameterError as error:
                reason = f"{error}; nothing was sent"
            else:
                settings = [w for n, v in shape.items() for w in ("-p", f"{n}:={as_text(v)}")]
                reason = self._page.programs.start(
                    GENERATOR,
                    f"command {shape['scenario']}",
                    [
                        "valve_control.nodes.command_source", "--ros-args", "-r", f"__ns:={valve.namespace}",
                        "-r", "__node:=page_command", *settings,
                    ],
                    self._page.folder,
                    moves=True,
                )  # fmt: skip
                if not reason:
                    self._page.say(valve, f"command {shape['scenario']} started", mark=True)
        self._command_refusal.set_text(reason)

    def _refused(self, valve: Valve) -> str:
        node = valve.controller
        others = [name for name in valve.commanders if not name.endswith("/page_command")]
        if others:
            return f"{', '.join(others)} commands this valve already; end it first, two commands would fight"
        if node is None or not node.present:
            return "there is no controller to command"
        if node.state in ("inactive", "unconfigured"):
            return "the controller is stopped; activate it first"
        return ""

    def _end(self) -> None:
        if self._page.allowed():
            self._page.programs.end(GENERATOR)

    # Recorder

    def _build_recorder(self) -> None:
        ui.label("Recording").classes("vc-title")
        with ui.element("div").classes("vc-buttons"):
            ui.button("Record", on_click=self._record).props("id=record no-caps dense outline")
            ui.button("End and report", on_click=self._end_record).props(
                "id=end-record no-caps dense outline"
            )
            self._link = ui.link("", "", new_tab=True).props("id=report")
        self._record_state = ui.label("").classes("vc-help").props("id=record-state role=status")

    def _record(self) -> None:
        valve = self._page.valve
        if valve is None or not self._page.allowed():
            return
        bag = self._page.folder / time.strftime("recording_%Y%m%d_%H%M%S")
        reason = self._page.programs.start(
            RECORDER,
            f"recording {bag.name}",
            [
                "valve_control.nodes.recorder",
                "--ros-args",
                "-r",
                "__node:=page_recorder",
                "-p",
                f"bag:={bag}",
            ],
            self._page.folder,
        )
        self._page.say(valve, reason or f"records into {bag}", mark=not reason)
        if reason:
            self._page.tell(reason)

    def _end_record(self) -> None:
        if self._page.allowed():
            self._page.programs.end(RECORDER)

    def _refresh_recorder(self) -> None:
        """Show the recording; when it has ended, have its report made."""
        programs = self._page.programs
        recorder, report = programs.get(RECORDER), programs.get(REPORT)
        if recorder is None:
            return
        name = recorder.title.removeprefix("recording ")
        if recorder.running:
            last = recorder.lines[-1] if recorder.lines else "starting"
            said = re.sub(r"^(\[.*?\] ?)+: ", "", last)
            self._record_state.set_text(f"records into {name}: {said}")
            self._link.set_text("")
            return
        target = f"{name}.html"
        if recorder.status == 0 and (report is None or report.title != f"report of {name}"):
            programs.start(
                REPORT,
                f"report of {name}",
                ["valve_control.cli", "analyze", name, "--html", target],
                self._page.folder,
            )
            return
        if recorder.status != 0:
            last = recorder.lines[-1] if recorder.lines else ""
            self._record_state.set_text(f"the recording {recorder.state}: {last}")
        elif report is not None and report.running:
            self._record_state.set_text(f"{name} is written to {self._page.folder}; its report is being made")
        elif report is not None and report.status == 0:
            self._record_state.set_text(f"{name} and its report are in {self._page.folder}")
            self._link.set_text(f"report of {name}")
            self._link.props(f'href="/files/{target}"')
        elif report is not None:
            last = report.lines[-1] if report.lines else ""
            self._record_state.set_text(f"{name} is written to {self._page.folder}; no report: {last}")

    # Faults of a simulator

    def _build_faults(self) -> None:
        self._fault_box.clear()
        self._faults.clear()
        valve = self._page.valve
        node = valve.simulator if valve is not None else None
        if node is None or "fault.lvdt" not in node.fields:
            return
        with self._fault_box:
            ui.label("Faults of the simulated valve").classes("vc-title")
            with ui.element("div").classes("vc-grid"):
                for name in FAULTS:
                    field = node.fields.get(name)
                    if field is None:
                        continue
                    value = str(node.values[name])
                    with named(name.replace(".", "-")):
                        made: ui.select | ui.input = (
                            ui.select(list(field.choices), label=name, value=value)
                            if field.choices
                            else ui.input(name, value=value)
                        )
                    self._faults[name] = made.props("dense outlined")
            with ui.element("div").classes("vc-buttons"):
                ui.button("Inject", on_click=self._inject).props("id=inject no-caps dense outline")
                ui.button("No faults", on_click=self._clear).props("id=no-faults no-caps dense outline")
            self._fault_answer = ui.label("").classes("vc-warning").props("id=fault-answer role=alert")

    async def _inject(self) -> None:
        valve = self._page.valve
        node = valve.simulator if valve is not None else None
        if valve is None or node is None or not self._page.allowed():
            return
        try:
            values: Values = {}
            for name, box in self._faults.items():
                values[name] = parse(node.fields[name], str(box.value))
        except EntryError as error:
            self._fault_answer.set_text(f"{name}: {error}")
            return
        self._fault_answer.set_text(await self._page.machine.change(valve, node, values))

    async def _clear(self) -> None:
        valve = self._page.valve
        node = valve.simulator if valve is not None else None
        if valve is not None and node is not None and self._page.allowed():
            none: Values = {name: "none" for name in ("fault.lvdt", "fault.valve")}
            self._fault_answer.set_text(await self._page.machine.change(valve, node, none))

    # identify, tune and what else valve-control has

    def _build_runs(self) -> None:
        ui.label("Runs").classes("vc-title")
        self._run = ui.select(list(RUNS), value=RUNS[0], on_change=self._example)
        self._run.props('dense outlined id=run aria-label="run"')
        self._typed: dict[str, str] = {}  # arguments by run
        with named("arguments"):
            self._arguments = ui.input(
                "arguments, as after valve-control",
                value=EXAMPLES[RUNS[0]],
                on_change=lambda event: self._typed.update({str(self._run.value): str(event.value or "")}),
            )
        self._arguments.props('dense outlined autocomplete="off"')
        self._explained = ui.label(EXPLAINED[RUNS[0]]).classes("vc-help").props("id=run-explained")
        with ui.element("div").classes("vc-buttons"):
            ui.button("Run", on_click=self._start_run).props("id=start-run no-caps dense outline")
            ui.button("Cancel", on_click=self._cancel_run).props("id=cancel-run no-caps dense outline")
        self._run_refusal = ui.label("").classes("vc-warning").props("id=run-refusal role=alert")
        self._run_state = ui.label("").classes("vc-help").props("id=run-state role=status")
        self._share = ui.linear_progress(show_value=False).props("id=run-share aria-label=progress")
        self._share.set_visibility(False)
        self._output = ui.label("").classes("vc-output").props("id=output role=log")
        self._output.set_visibility(False)
        self._made = ui.element("div").props("id=made")
        self._files_of: Program | None = None

    def _example(self) -> None:
        """Offer the arguments of the chosen run, and say what it does. Those that move are for this valve."""
        name, valve = str(self._run.value), self._page.valve
        node = valve.controller.name if valve is not None and valve.controller is not None else "/controller"
        space = valve.namespace.strip("/").replace("/", "_") if valve is not None else ""
        text = EXAMPLES[name].format(node=node, valve=f"_{space}" if space else "")
        self._arguments.set_value(text if name in MOVING else self._typed.get(name, text))
        self._explained.set_text(EXPLAINED[name])

    def _start_run(self) -> None:
        valve = self._page.valve
        if not self._page.allowed():
            return
        name = str(self._run.value)
        try:
            words = shlex.split(str(self._arguments.value or ""))
        except ValueError as error:
            self._run_refusal.set_text(f"the arguments cannot be read: {str(error).lower()}")
            return
        moves = name in MOVING
        if moves and valve is not None and valve.commanders:
            reason = f"{', '.join(valve.commanders)} commands this valve; end it first"
        else:
            reason = self._page.programs.start(
                RUN, name, ["valve_control.cli", name, *words], self._page.folder, moves
            )
        self._run_refusal.set_text(reason)
        if not reason and valve is not None:
            text = f"started valve-control {name} {shlex.join(words)} in {self._page.folder}"
            self._page.say(valve, text, mark=moves)

    def _cancel_run(self) -> None:
        if self._page.allowed():
            self._page.programs.end(RUN)

    def _refresh_run(self) -> None:
        run = self._page.programs.get(RUN)
        if run is None:
            return
        self._run_state.set_text(f"{run.title}: {run.state}")
        shown = run.running and not math.isnan(run.share)
        self._share.set_visibility(shown)
        if shown:
            self._share.set_value(run.share)
        lines = (
            [*list(run.lines)[-SHOWN_LINES:], run.progress]
            if run.progress
            else list(run.lines)[-SHOWN_LINES:]
        )
        self._output.set_text("\n".join(lines))
        self._output.set_visibility(True)
        if run.ended and run is not self._files_of:
            self._files_of = run
            self._show_made(run.title, run.wrote)

    def _show_made(self, run: str, paths: Sequence[str]) -> None:
        """Link what a run has written, reports first; offer to load its parameters."""
        self._made.clear()
        with self._made:
            for path in sorted(paths, key=lambda path: not path.endswith(".html")):
                folder = self._page.folder.resolve()
                target = (folder / path).resolve()
                if not (target.is_file() and target.is_relative_to(folder)):
                    continue
                title = f"report {path}" if path.endswith(".html") else path
                address = f"/files/{target.relative_to(folder).as_posix()}"
                ui.link(title, address, new_tab=True).classes("q-mr-md")
                if path.endswith(".yaml") and run in LOADED:
                    ui.button(f"Load {path}", on_click=partial(self._load, str(target))).props(
                        "id=load-made dense no-caps outline"
                    )

    async def _load(self, path: str) -> None:
        """Let the controller load parameters that a run has written."""
        if self._page.allowed():
            self._run_refusal.set_text(await self._page.load(path))

    # Showing

    def show(self) -> None:
        """Show another valve."""
        self._fault_version = None
        if self._run.value in MOVING:
            self._example()  # for this valve
        self.refresh()

    def refresh(self) -> None:
        """Show what has changed."""
        valve = self._page.valve
        if valve is None:
            return
        generator = self._page.programs.get(GENERATOR)
        text = (
            "commanded by " + ", ".join(valve.commanders)
            if valve.commanders
            else "nobody commands this valve"
        )
        if generator is not None:
            text = f"{generator.title}: {generator.state}; {text}"
        self._command_state.set_text(text)
        node = valve.simulator
        version = (node.name, len(node.fields)) if node is not None else None
        if version != self._fault_version:
            self._fault_version = version
            self._build_faults()
        self._refresh_recorder()
        self._refresh_run()
