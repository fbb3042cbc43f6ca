# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reports the analysis of a bag: tables, signals, spectra and parameters of its valves, and its axes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from valve_control.control.analysis.figures import Band, Line, Plot
from valve_control.control.analysis.indices import Indices
from valve_control.control.analysis.tables import HEADER, index_row
from valve_control.recordings import axis_analysis, report
from valve_control.recordings.analysis import (
    Analysis,
    Part,
    Spell,
    ValveAnalysis,
    as_dict,
    change_text,
    estimates,
    guarantee_use,
    modes_dict,
)
from valve_control.recordings.axis_analysis import Axis
from valve_control.recordings.cleaning import seconds
from valve_control.recordings.modes import Mode
from valve_control.recordings.parameters import Node
from valve_control.recordings.recording import Aligned, at_time
from valve_control.recordings.report import BLACK, BLUE, GREEN, RED, Figure, Markup, Notes, Piece, Table

LISTED = 12  # motions, and intervals of modes, in the terminal; all of them are in JSON and HTML
BANDS = 500  # in one figure
COLOURS = {Mode.DEGRADED: "#E69F00", Mode.SAFE: "#CC0000", Mode.INACTIVE: "#777777", Mode.UNKNOWN: "#777777"}
TIMING = (  # heads and widths of the columns
    ("", 16), ("messages", 10), ("rate [Hz]", 11), ("jitter p99 [ms]", 12), ("max [ms]", 10), ("gaps", 7),
    ("longest [ms]", 14), ("lost", 7),
)  # fmt: skip


def of_bag(analysis: Analysis, axes: Mapping[str, Axis]) -> report.Report:
    """Report of the valves and axes of a bag."""
    about = as_dict(analysis)
    bag = about["bag"]
    lines = [
        f"{bag['path']}: {bag['storage']}{', ' + bag['compression'] if bag['compression'] else ''}, "
        f"{bag['bytes'] / 1e6:.1f} MB, {bag['duration_s']:.3f} s from {bag['start']} by {bag['clock']}"
    ]
    sections: dict[str, list[Piece]] = {
        "Bag": [
            Table(["", ""], [(key, _plain(value)) for key, value in bag.items() if key != "topics"]),
            Table(["topic", "type"], list(bag["topics"].items())),
            Notes(analysis.left_out),
        ]
    }
    for name, valve in analysis.valves.items():
        lines += ["", *_valve_lines(name, valve)]
        sections.update(_valve_sections(name, valve))
    if analysis.left_out:
        lines += ["", *report.noted(analysis.left_out)]
    for name, axis in axes.items():
        lines += ["", *axis_analysis.lines(name, axis)]
    if axes:
        about["axes"] = {name: axis_analysis.as_dict(axis) for name, axis in axes.items()}
    return report.Report(f"{Path(str(bag['path'])).name}: valve report", lines, about, sections)


def _plain(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else "" if value is None else str(value)


def parts_of_modes(part: Part) -> list[tuple[str, Indices]]:
    """Indices of a part without the samples in some modes, by name; [] if all of it is ok."""
    if not part.time_in:
        return []
    rows = [("without safe", part.without_safe), ("only ok", part.only_ok)]
    return rows if set(part.time_in) > {"degraded"} else rows[1:]


def time_in(spent: dict[str, float]) -> str:
    """Time in modes in words."""
    return ", ".join(f"{mode} {duration:.3f} s" for mode, duration in spent.items())


def listed(spells: list[Spell], most: int) -> list[Spell]:
    """Spells that are not ok, in order of time; of more than ``most`` the gravest and longest."""
    found = [spell for spell in spells if spell.listed and spell.interval.mode is not Mode.OK]
    found.sort(key=lambda spell: (spell.interval.mode is not Mode.SAFE, spell.start - spell.end))
    return sorted(found[:most], key=lambda spell: spell.start)


def _valve_lines(name: str, valve: ValveAnalysis) -> list[str]:
    period = valve.signals.period if valve.signals is not None else np.nan
    head = f"{name}: controller {valve.controller or 'unknown'}, sample period {1e3 * period:.4g} ms"
    if valve.period.differs:
        head += f", LVDT readings every {1e3 * valve.period.measured:.4g} ms"
    lines = [head, *([HEADER] if valve.parts else [])]
    motions = [part for part in valve.parts if part.segment.kind == "motion"]
    for part in valve.parts:
        if part in motions[LISTED:]:
            continue
        remark = time_in(part.time_in)
        lines.append(index_row(part.segment.name, part.indices) + (f"  {remark}" if remark else ""))
        if part.segment.kind == "run":
            lines += [index_row(label, values) for label, values in parts_of_modes(part)]
    if len(motions) > LISTED:
        lines.append(f"({len(motions) - LISTED} more motions in --json and --html)")
    lines += [*_change_lines(valve), *_mode_lines(valve)]
    lines.append(
        f"{'':16}{'messages':>10}{'rate [Hz]':>11}{'jitter p99, max [ms]':>22}{'gaps':>7}"
        f"{'longest [ms]':>14}{'lost':>7}"
    )
    for signal, *row in _timing_rows(valve):
        cells = zip(row, TIMING[1:], strict=True)
        lines.append(f"{signal:16}" + "".join(f"{cell:>{width}}" for cell, (_, width) in cells))
    if valve.signals is not None and len(valve.signals.latency):
        p50, p99, most = 1e3 * np.percentile(valve.signals.latency, [50, 99, 100])
        lines.append(
            f"LVDT to voltage: p50 {p50:.3f}, p99 {p99:.3f}, max {most:.3f} ms; "
            f"{valve.signals.unanswered} readings not answered before the next"
        )
    theta = estimates(valve.valve.state)
    if theta:
        last = ", ".join(f"{name} {values[np.isfinite(values)][-1]:.5g}" for name, values in theta.items())
        lines.append(f"estimates at the end: {last}")
    use = guarantee_use(valve.valve.state)
    if use is not None:
        lines.append(f"V2 over its bound: at most {use:.3g}")
    return [*lines, *report.noted(valve.left_out)]


def _change_lines(valve: ValveAnalysis) -> list[str]:
    """Every change of parameters of controller and simulator, in order of time."""
    changes = []
    for node in valve.nodes:
        for i, change in enumerate(node.changes, start=1):
            name = f"after change {i}" if node is valve.valve.controller else node.name
            when = "" if valve.signals is None else f" (at {at_time(valve.signals, change.time):.3f} s)"
            changes.append((change.time, f"{name}: {change_text(change)}{when}"))
    return [line for _, line in sorted(changes, key=lambda entry: entry[0])]


def _mode_summary(valve: ValveAnalysis) -> list[str]:
    """Time in each mode in a line, [] if it is not known."""
    about = modes_dict(valve)
    if about is None:
        return []
    if not listed(valve.spells, 1):
        return ["modes: ok throughout"]
    share = about["ok"]["share"]
    parts = [] if share is None else [f"ok {100.0 * share:.1f} % of the time"]
    for mode in list(Mode)[1:]:
        entry = about[mode.name.lower()]
        if entry["intervals"]:
            times = f"{entry['intervals']} time{'s' if entry['intervals'] > 1 else ''}"
            parts.append(f"{mode.name.lower()} {times}, {entry['duration_s']:.3f} s")
    return [f"modes: {'; '.join(parts)}"]


def _mode_rows(valve: ValveAnalysis, most: int) -> list[tuple[str, ...]]:
    """Mode, beginning, end, length [s] and reasons of at most ``most`` spells that are not ok."""
    unknown = "nothing was heard of the controller"
    return [
        (
            spell.interval.mode.name.lower(),
            *(f"{value:.3f}" for value in (spell.start, spell.end, spell.end - spell.start)),
            unknown
            if spell.interval.mode is Mode.UNKNOWN
            else "; ".join(spell.interval.reasons) or "(the reason is not recorded)",
        )
        for spell in listed(valve.spells, most)
    ]


def _mode_lines(valve: ValveAnalysis) -> list[str]:
    rows = _mode_rows(valve, LISTED)
    if not rows:
        return _mode_summary(valve)
    more = len(listed(valve.spells, len(valve.spells))) - len(rows)
    return [
        *_mode_summary(valve),
        f"{'':14}{'from [s]':>10}{'to [s]':>10}{'lasts [s]':>11}",
        *(f"{mode:14}{start:>10}{end:>10}{lasts:>11}  {why}" for mode, start, end, lasts, why in rows),
        *([f"({more} more in --json and --html)"] if more else []),
    ]


def _timing_rows(valve: ValveAnalysis) -> list[list[str]]:
    rows = []
    for part, entry in valve.timing.items():
        told = ["?"] * 4
        if entry.gaps is not None:
            jitter = entry.jitter_s
            told = [f"{1e3 * jitter.p99:.3f}", f"{1e3 * jitter.max:.3f}", str(entry.gaps)]
            told.append(f"{1e3 * entry.longest_gap_s:.2f}")
        lost = "?" if entry.lost is None else str(entry.lost)
        rows.append([part, str(entry.messages), f"{entry.rate_hz:.2f}", *told, lost])
    return rows


def csv_text(signals: Aligned) -> str:
    """Aligned signals of one valve, one reading a line."""
    s = signals
    columns = (s.time, s.stamp, s.command, s.measurement, s.measurement - s.command, s.voltage)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    head = "time_s,stamp_ns,command_V,measurement_V,error_V,voltage_V\n"
    form = "%.9f,%d,%.17g,%.17g,%.17g,%.17g\n"
    return head + "".join(form % row for row in rows)


def _valve_sections(name: str, valve: ValveAnalysis) -> dict[str, list[Piece]]:
    sections: dict[str, list[Piece]] = {}
    signals = valve.signals
    if valve.parts and signals is not None:
        rows = []
        for part in valve.parts:
            begin, end = signals.time[part.segment.start], signals.time[part.segment.end - 1]
            remark = "; ".join(filter(None, [part.change, time_in(part.time_in)]))
            title = f"{part.segment.name}, {begin:.2f} to {end:.2f} s"
            rows.append((title, part.controller, part.indices, remark))
            if part.segment.kind == "run":
                rows += [(label, part.controller, values, "") for label, values in parts_of_modes(part)]
        sections[f"{name}: indices"] = [report.index_table(rows), Notes(valve.left_out)]
        if valve.spells:
            head = ["mode", "from [s]", "to [s]", "lasts [s]", "reasons"]
            modes = _mode_rows(valve, len(valve.spells))
            sections[f"{name}: modes"] = [*_mode_summary(valve), *([Table(head, modes)] if modes else [])]
        sections[f"{name}: signals"] = _signals(valve, signals)
        spectra = [
            Plot(f"{label} [V/√Hz]", [Line(label, s.frequency, s.density, colour)], logarithmic=True)
            for label, s, colour in (
                ("error", valve.error_spectrum, RED), ("voltage", valve.voltage_spectrum, BLUE)
            )
            if len(s.frequency)
        ]  # fmt: skip
        if spectra:
            figure = Figure(spectra, "frequency [Hz]", logarithmic_x=True)
            sections[f"{name}: spectra"] = [Notes(valve.spectra_notes), figure]
    elif valve.left_out:
        sections[f"{name}: left out"] = [Notes(valve.left_out)]
    head = ["signal", *(title for title, _ in TIMING[1:])]
    sections[f"{name}: sample rate"] = [Table(head, _timing_rows(valve))]
    for node in valve.nodes:
        sections[f"Parameters of {node.name}"] = [
            Markup("<details><summary>at the beginning</summary>"),
            Table(["parameter", "value"], sorted(node.initial.items())),
            Markup("</details>"),
            _changes(valve, node) if node.changes else "not changed while recording",
        ]
    return sections


def _changes(valve: ValveAnalysis, node: Node) -> Table:
    rows = [
        ("" if valve.signals is None else f"{at_time(valve.signals, change.time):.3f}", name, value)
        for change in node.changes
        for name, value in change.values.items()
    ]
    return Table(["time [s]", "parameter", "new value"], rows)


def _signals(valve: ValveAnalysis, signals: Aligned) -> list[Piece]:
    """Figure of all signals and estimates, with marks of changes and bands of the modes."""
    changes = valve.valve.controller.changes if valve.valve.controller is not None else []
    begin, end = float(signals.time[0]), float(signals.time[-1]) + signals.period
    spells = listed(valve.spells, BANDS)
    bands = [
        Band(max(spell.start, begin), min(spell.end, end), COLOURS[spell.interval.mode])
        for spell in spells
        if spell.start < end and spell.end > begin
    ]
    marks = "".join(
        f' <span style="background:{COLOURS[mode]}55;padding:0 .5em">{mode.name.lower()}</span>'
        for mode in sorted({spell.interval.mode for spell in spells})
    )
    figure = Figure(
        _signal_plots(valve, signals),
        marks=[at_time(signals, change.time) for change in changes],
        bands=bands,
    )
    return [*([Markup(f"<p>Bands:{marks}</p>")] if marks else []), figure]


def _signal_plots(valve: ValveAnalysis, signals: Aligned) -> list[Plot]:
    def line(label: str, values: Any, colour: str) -> Line:
        return Line(label, signals.time, values, colour)

    plots = [
        Plot(
            "spool position [V]",
            [line("command", signals.command, BLACK), line("measurement", signals.measurement, BLUE)],
        ),
        Plot("error [V]", [line("error", signals.measurement - signals.command, RED)]),
        Plot("voltage [V]", [line("voltage", signals.voltage, GREEN)]),
    ]
    state = valve.valve.state
    theta = estimates(state)
    if state is None or not theta:
        return plots
    time = seconds(state.stamp, int(signals.stamp[0]))
    if valve.valve.lockstep:
        time = (state.values["sample"] - state.values["sample"][0]) * signals.period
    plots += [Plot(f"θ̂ {n}", [Line(f"θ̂ {n}", time, values, "#CC79A7")]) for n, values in theta.items()]
    v2 = Line("V2", time, state.values["lyapunov"], "#56B4E9")
    bound = Line("bound of V2", time, state.values["lyapunov_bound"], "#E69F00", dashed=True)
    return [*plots, Plot("V2", [v2, bound], logarithmic=True)]
