# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reports the analysis of a bag: tables, signals, spectra and parameters of its valves, and its axes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from valve_control.control.analysis.figures import Band, Line, Plot
from valve_control.control.analysis.indices import Indices
from valve_control.control.analysis.timing import Timing
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
from valve_control.recordings.recording import Aligned, at_time
from valve_control.recordings.report import BLACK, BLUE, GREEN, RED, Aside, Figure, Notes, Piece, Table

LISTED = 12  # motions, and intervals of modes, in the terminal; all of them are in JSON and HTML
BANDS = 500  # in one figure
COLOURS = {Mode.DEGRADED: "#E69F00", Mode.SAFE: "#CC0000", Mode.INACTIVE: "#777777", Mode.UNKNOWN: "#777777"}
TIMING = ("signal", "messages", "rate [Hz]", "jitter p99 [ms]", "max [ms]", "gaps", "longest [ms]", "lost")


def of_bag(analysis: Analysis, axes: Mapping[str, Axis]) -> report.Report:
    """Report of the valves and axes of a bag."""
    about = as_dict(analysis)
    bag = about["bag"]
    sections: dict[str, list[Piece]] = {
        "Bag": [
            f"{bag['path']}: {bag['storage']}{', ' + bag['compression'] if bag['compression'] else ''}, "
            f"{bag['bytes'] / 1e6:.1f} MB, {bag['duration_s']:.3f} s from {bag['start']} by {bag['clock']}",
            Aside("files and topics", [
                Table(["", ""], [(key, _plain(value)) for key, value in bag.items() if key != "topics"]),
                Table(["topic", "type"], list(bag["topics"].items())),
            ]),
            Notes(analysis.left_out),
        ]
    }  # fmt: skip
    for name, valve in analysis.valves.items():
        sections.update(_valve_sections(name, valve))
    sections.update({f"axis {name or '/'}": axis_analysis.pieces(axis) for name, axis in axes.items()})
    if axes:
        about["axes"] = report.plain(axes)
    return report.Report(f"{Path(str(bag['path'])).name}: valve report", about, sections)


def _plain(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else "" if value is None else str(value)


def time_in(spent: dict[str, float]) -> str:
    """Time in modes in words."""
    return ", ".join(f"{mode} {duration:.3f} s" for mode, duration in spent.items())


def listed(spells: list[Spell], most: int) -> list[Spell]:
    """At most so many spells that are not ok, in order of time; of more than LISTED the gravest first."""
    found = [spell for spell in spells if spell.listed and spell.mode is not Mode.OK]
    found.sort(key=lambda spell: (spell.mode is not Mode.SAFE, -spell.duration_s))
    return found[:most] if len(found) > LISTED else sorted(found, key=lambda spell: spell.start_s)


def _index_rows(part: Part) -> list[tuple[str, str, Indices, str]]:
    """Indices of a part; of the whole run also those without the samples in some modes."""
    law, modes = part.controller or "", part.not_ok_s
    remark = "; ".join(filter(None, [part.change, time_in(modes)]))
    rows = [(f"{part.name}, {part.start_s:.2f} to {part.end_s:.2f} s", law, part.indices, remark)]
    if part.kind == "run" and modes:
        rows.append(("only ok", law, part.indices_only_ok, ""))
    return rows


def _changes(valve: ValveAnalysis) -> list[str]:
    """Every change of parameters of controller and simulator, in order of time."""
    changes = []
    for node in valve.nodes:
        for i, change in enumerate(node.changes, start=1):
            name = f"after change {i}" if node is valve.valve.controller else node.name
            when = "" if valve.signals is None else f" (at {at_time(valve.signals, change.time):.3f} s)"
            changes.append((change.time, f"{name}: {change_text(change)}{when}"))
    return [line for _, line in sorted(changes, key=lambda entry: entry[0])]


def _modes(valve: ValveAnalysis) -> list[Piece]:
    """Time in each mode, and the spells that are not ok with their reasons; [] if they are not known."""
    about = modes_dict(valve)
    if about is None:
        return []
    spells = listed(valve.spells, len(valve.spells))
    if not spells:
        return ["modes: ok throughout"]
    share = about["ok"]["share"]
    parts = [] if share is None else [f"ok {100.0 * share:.1f} % of the time"]
    for mode in list(Mode)[1:]:
        entry = about[mode.name.lower()]
        if entry["intervals"]:
            times = f"{entry['intervals']} time{'s' if entry['intervals'] > 1 else ''}"
            parts.append(f"{mode.name.lower()} {times}, {entry['duration_s']:.3f} s")
    rows = [
        (
            spell.mode.name.lower(),
            *(f"{value:.3f}" for value in (spell.start_s, spell.end_s, spell.duration_s)),
            "nothing was heard of the controller"
            if spell.mode is Mode.UNKNOWN
            else "; ".join(spell.reasons) or "(the reason is not recorded)",
        )
        for spell in spells
    ]
    head = ["mode", "from [s]", "to [s]", "lasts [s]", "reasons"]
    return [f"modes: {'; '.join(parts)}", Table(head, rows, LISTED)]


def _timing_row(part: str, entry: Timing) -> list[str]:
    jitter, intervals = entry.jitter_s, ["?"] * 4
    if entry.gaps is not None:
        intervals = [f"{1e3 * jitter.p99:.3f}", f"{1e3 * jitter.max:.3f}", str(entry.gaps)]
        intervals.append(f"{1e3 * entry.longest_gap_s:.2f}")
    lost = "?" if entry.lost is None else str(entry.lost)
    return [part, str(entry.messages), f"{entry.rate_hz:.2f}", *intervals, lost]


def aligned_csv(signals: Aligned) -> str:
    """Aligned signals of one valve, one reading a line."""
    s = signals
    columns = (s.time, s.stamp, s.command, s.measurement, s.measurement - s.command, s.voltage)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    form = "%.9f,%d,%.17g,%.17g,%.17g,%.17g\n"
    return "time_s,stamp_ns,command_V,measurement_V,error_V,voltage_V\n" + "".join(form % r for r in rows)


def _valve_sections(name: str, valve: ValveAnalysis) -> dict[str, list[Piece]]:
    signals = valve.signals
    period = "unknown" if signals is None else f"{1e3 * signals.period:.4g} ms"
    head = f"controller {valve.controller or 'unknown'}, sample period {period}"
    parts = sorted(valve.parts, key=lambda part: part.kind == "motion")
    rows = [row for part in parts for row in _index_rows(part)]
    most = len(rows) - sum(part.kind == "motion" for part in parts) + LISTED
    indices = [report.index_table(rows, most)] if rows else []
    sections: dict[str, list[Piece]] = {
        f"{name}: indices": [head, *indices, *_changes(valve), Notes(valve.left_out)],
        f"{name}: modes": _modes(valve),
    }
    if signals is not None and parts:
        sections[f"{name}: signals"] = _signals(valve, signals)
        spectra = [
            Plot(f"{label} [V/√Hz]", [Line(label, s.frequency, s.density, colour)], logarithmic=True)
            for label, s, colour in (
                ("error", valve.error_spectrum, RED), ("voltage", valve.voltage_spectrum, BLUE)
            )
            if len(s.frequency)
        ]  # fmt: skip
        figure = Figure(spectra, "frequency [Hz]", logarithmic_x=True)
        sections[f"{name}: spectra"] = [figure] if spectra else []
    rate: list[Piece] = [Table(TIMING, [_timing_row(*entry) for entry in valve.timing.items()])]
    if signals is not None and len(signals.latency):
        p50, p99, longest = 1e3 * np.percentile(signals.latency, [50, 99, 100])
        rate.append(
            f"LVDT to voltage: p50 {p50:.3f}, p99 {p99:.3f}, max {longest:.3f} ms; "
            f"{signals.unanswered} readings not answered before the next"
        )
    if theta := estimates(valve.valve.state):
        last = ", ".join(f"{label} {values[np.isfinite(values)][-1]:.5g}" for label, values in theta.items())
        rate.append(f"estimates at the end: {last}")
    if (use := guarantee_use(valve.valve.state)) is not None:
        rate.append(f"V2 over its bound: at most {use:.3g}")
    sections[f"{name}: sample rate"] = rate
    for node in valve.nodes:
        values = Table(["parameter", "value"], sorted(node.initial.items()))
        sections[f"Parameters of {node.name}"] = [Aside("at the beginning", [values])]
    return sections


def _signals(valve: ValveAnalysis, signals: Aligned) -> list[Piece]:
    """Figure of all signals and estimates, with marks of changes and bands of the modes."""
    changes = valve.valve.controller.changes if valve.valve.controller is not None else []
    begin, end = float(signals.time[0]), float(signals.time[-1]) + signals.period
    spells = listed(valve.spells, BANDS)
    bands = [
        Band(max(spell.start_s, begin), min(spell.end_s, end), COLOURS[spell.mode])
        for spell in spells
        if spell.start_s < end and spell.end_s > begin
    ]
    marks = [at_time(signals, change.time) for change in changes]
    figure = Figure(_signal_plots(valve, signals), marks=marks, bands=bands)
    legend = Aside("bands", ["yellow: degraded, red: safe, grey: inactive or unknown"])
    return [*([legend] if bands else []), figure]


def _signal_plots(valve: ValveAnalysis, signals: Aligned) -> list[Plot]:
    error = signals.measurement - signals.command
    plots = report.plots_of(
        signals.time,
        {
            "spool position [V]": [
                ("command", signals.command, BLACK),
                ("measurement", signals.measurement, BLUE),
            ],
            "error [V]": [("error", error, RED)],
            "voltage [V]": [("voltage", signals.voltage, GREEN)],
        },
    )
    state = valve.valve.state
    theta = estimates(state)
    if state is None or not theta:
        return plots
    time = seconds(state.stamp, int(signals.stamp[0]))
    if valve.valve.lockstep:
        time = (state.values["sample"] - state.values["sample"][0]) * signals.period
    plots += [Plot(f"θ̂ {n}", [Line(f"θ̂ {n}", time, values, "#CC79A7")]) for n, values in theta.items()]
    v2 = Line("V2", time, state.values["lyapunov"], "#56B4E9")
    bound = Line("bound of V2", time, state.values["lyapunov_bound"], "#E69F00", style="--")
    return [*plots, Plot("V2", [v2, bound], logarithmic=True)]
