# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reports the analysis of a bag as text for a terminal, as CSV, and as an HTML page."""

import html
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from valve_control.control.analysis.figures import Band, Line, Plot
from valve_control.control.analysis.indices import Indices
from valve_control.control.analysis.page import figure, notes, page, table
from valve_control.control.analysis.tables import HEADER, index_row
from valve_control.recordings.analysis import (
    Analysis,
    Part,
    Spell,
    ValveAnalysis,
    about_bag,
    change_text,
    estimates,
    guarantee_use,
    modes_dict,
)
from valve_control.recordings.cleaning import seconds
from valve_control.recordings.modes import Mode
from valve_control.recordings.recording import Aligned, at_time

LISTED = 12  # motions, and intervals of modes, in the terminal; all of them are in JSON and HTML
BANDS = 500  # in one figure
COLOURS = {Mode.DEGRADED: "#E69F00", Mode.SAFE: "#CC0000", Mode.INACTIVE: "#777777", Mode.UNKNOWN: "#777777"}


def text(analysis: Analysis) -> str:
    """The analysis as tables for a terminal."""
    about = about_bag(analysis)
    lines = [
        f"{about['path']}: {about['storage']}{', ' + about['compression'] if about['compression'] else ''}, "
        f"{about['bytes'] / 1e6:.1f} MB, {about['duration_s']:.3f} s from {about['start']} "
        f"by {about['clock']}"
    ]
    for name, valve in analysis.valves.items():
        lines += ["", *_valve_lines(name, valve)]
    if analysis.left_out:
        lines += ["", *(f"note: {note}" for note in analysis.left_out)]
    return "\n".join(lines)


def _valve_lines(name: str, valve: ValveAnalysis) -> list[str]:
    period = valve.signals.period if valve.signals is not None else np.nan
    head = f"{name}: controller {valve.controller or 'unknown'}, sample period {1e3 * period:.4g} ms"
    if valve.period.differs:
        head += f", LVDT readings every {1e3 * valve.period.measured:.4g} ms"
    lines = [head]
    if valve.parts:
        lines.append(HEADER)
        motions = [part for part in valve.parts if part.segment.kind == "motion"]
        shown = [part for part in valve.parts if part.segment.kind != "motion" or part in motions[:LISTED]]
        for part in shown:
            remark = time_in(part.time_in)
            lines.append(index_row(part.segment.name, part.indices) + (f"  {remark}" if remark else ""))
            if part.segment.kind == "run":
                lines += [index_row(label, values) for label, values in parts_of_modes(part)]
        if len(motions) > LISTED:
            lines.append(f"({len(motions) - LISTED} more motions in --json and --html)")
    lines += _change_lines(valve)
    lines += _mode_lines(valve)
    lines.append(
        f"{'':16}{'messages':>10}{'rate [Hz]':>11}{'jitter p99, max [ms]':>22}{'gaps':>7}"
        f"{'longest [ms]':>14}{'lost':>7}"
    )
    for row in _timing_rows(valve):
        signal, messages, rate, p99, most, gaps, longest, lost = row
        lines.append(f"{signal:16}{messages:>10}{rate:>11}{p99:>12}{most:>10}{gaps:>7}{longest:>14}{lost:>7}")
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
    return [*lines, *(f"note: {note}" for note in valve.left_out)]


def parts_of_modes(part: Part) -> list[tuple[str, Indices]]:
    """Indices of a part without the samples in some modes, by name; [] if all of it is ok."""
    if not part.time_in:
        return []
    rows = [("without safe", part.without_safe), ("only ok", part.only_ok)]
    return rows if set(part.time_in) > {"degraded"} else rows[1:]


def time_in(spent: dict[str, float]) -> str:
    """Time in modes in words."""
    return ", ".join(f"{mode} {duration:.3f} s" for mode, duration in spent.items())


def _change_lines(valve: ValveAnalysis) -> list[str]:
    """Every change of parameters of controller and simulator, in order of time."""
    told = []
    for node in (valve.valve.controller, valve.valve.simulator):
        for i, change in enumerate(node.changes if node is not None else [], start=1):
            name = f"after change {i}" if node is valve.valve.controller else node.name if node else ""
            when = "" if valve.signals is None else f" (at {at_time(valve.signals, change.time):.3f} s)"
            told.append((change.time, f"{name}: {change_text(change)}{when}"))
    return [line for _, line in sorted(told, key=lambda entry: entry[0])]


def listed(spells: list[Spell], most: int) -> list[Spell]:
    """Spells that are not ok, in order of time; of more than ``most`` the gravest and longest."""
    found = [spell for spell in spells if spell.listed and spell.interval.mode is not Mode.OK]
    found.sort(key=lambda spell: (spell.interval.mode is not Mode.SAFE, spell.start - spell.end))
    return sorted(found[:most], key=lambda spell: spell.start)


def _reasons(spell: Spell) -> str:
    if spell.interval.mode is Mode.UNKNOWN:
        return "nothing was heard of the controller"
    return "; ".join(spell.interval.reasons) or "(the reason is not recorded)"


def _mode_summary(valve: ValveAnalysis) -> str:
    """Time in each mode, "" if it is not known."""
    about = modes_dict(valve)
    if about is None:
        return ""
    if not listed(valve.spells, 1):
        return "modes: ok throughout"
    parts = (
        [f"ok {100.0 * about['ok']['share']:.1f} % of the time"] if about["ok"]["share"] is not None else []
    )
    for mode in Mode:
        entry = about[mode.name.lower()]
        if mode is not Mode.OK and entry["intervals"]:
            times = f"{entry['intervals']} time{'s' if entry['intervals'] > 1 else ''}"
            parts.append(f"{mode.name.lower()} {times}, {entry['duration_s']:.3f} s")
    return f"modes: {'; '.join(parts)}"


def _mode_rows(valve: ValveAnalysis, most: int) -> list[tuple[str, ...]]:
    """Mode, beginning, end, length [s] and reasons of at most ``most`` spells that are not ok."""
    return [
        (
            spell.interval.mode.name.lower(),
            *(f"{value:.3f}" for value in (spell.start, spell.end, spell.end - spell.start)),
            _reasons(spell),
        )
        for spell in listed(valve.spells, most)
    ]


def _mode_lines(valve: ValveAnalysis) -> list[str]:
    summary, rows = _mode_summary(valve), _mode_rows(valve, LISTED)
    if not rows:
        return [summary] if summary else []
    more = len(listed(valve.spells, len(valve.spells))) - len(rows)
    return [
        summary,
        f"{'':14}{'from [s]':>10}{'to [s]':>10}{'lasts [s]':>11}",
        *(f"{mode:14}{start:>10}{end:>10}{lasts:>11}  {why}" for mode, start, end, lasts, why in rows),
        *([f"({more} more in --json and --html)"] if more else []),
    ]


def mode_bands(spells: list[Spell], begin: float, end: float) -> list[Band]:
    """Bands for a figure from ``begin`` to ``end`` [s], where the mode is not ok."""
    return [
        Band(max(spell.start, begin), min(spell.end, end), COLOURS[spell.interval.mode])
        for spell in listed(spells, BANDS)
        if spell.start < end and spell.end > begin
    ]


def legend(modes: Iterable[Mode]) -> str:
    """What the colours of the bands mean."""
    marks = (
        f'<span style="background:{COLOURS[mode]}55;padding:0 .5em">{mode.name.lower()}</span>'
        for mode in modes
    )
    return f"<p>Bands: {' '.join(marks)}</p>"


def _timing_rows(valve: ValveAnalysis) -> list[list[str]]:
    return [
        [
            part,
            str(entry.messages),
            f"{entry.rate_hz:.2f}",
            *(
                ("?", "?", "?", "?")
                if entry.gaps is None
                else (
                    f"{1e3 * entry.jitter_s.p99:.3f}",
                    f"{1e3 * entry.jitter_s.max:.3f}",
                    str(entry.gaps),
                    f"{1e3 * entry.longest_gap_s:.2f}",
                )
            ),
            "?" if entry.lost is None else str(entry.lost),
        ]
        for part, entry in valve.timing.items()
    ]


def csv_text(signals: Aligned) -> str:
    """Aligned signals of one valve, one reading a line."""
    columns = (
        signals.time,
        signals.stamp,
        signals.command,
        signals.measurement,
        signals.measurement - signals.command,
        signals.voltage,
    )
    rows = zip(*(column.tolist() for column in columns), strict=True)
    head = "time_s,stamp_ns,command_V,measurement_V,error_V,voltage_V\n"
    form = "%.9f,%d,%.17g,%.17g,%.17g,%.17g\n"
    return head + "".join(form % row for row in rows)


def html_text(analysis: Analysis) -> str:
    """The report as one self-contained page."""
    title = f"{Path(str(analysis.recording.bag.path)).name}: valve report"
    return page(title, _sections(analysis))


def _sections(analysis: Analysis) -> dict[str, str]:
    about = about_bag(analysis)
    sections = {
        "Bag": table(["", ""], [(key, _plain(value)) for key, value in about.items() if key != "topics"])
        + table(["topic", "type"], list(about["topics"].items()))
        + notes(analysis.left_out)
    }
    for name, valve in analysis.valves.items():
        sections.update(_valve_sections(name, valve))
    return sections


def _plain(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else "" if value is None else str(value)


def index_table(rows: list[tuple[str, str, Indices, str]]) -> str:
    """Table of indices: name, law, I1-I5, remark."""
    return table(
        ["", "law", "e_M [V]", "e_F [V]", "e_rms [V]", "u_rms [V]", "c_u", ""],
        [(name, law, *(f"{value:.4f}" for value in values), remark) for name, law, values, remark in rows],
    )


def _valve_sections(name: str, valve: ValveAnalysis) -> dict[str, str]:
    sections: dict[str, str] = {}
    if valve.parts and valve.signals is not None:
        time = valve.signals.time
        rows = []
        for part in valve.parts:
            begin, end = time[part.segment.start], time[part.segment.end - 1]
            rows.append(
                (
                    f"{part.segment.name}, {begin:.2f} to {end:.2f} s",
                    part.controller,
                    part.indices,
                    "; ".join(filter(None, [part.change, time_in(part.time_in)])),
                )
            )
            if part.segment.kind == "run":
                rows += [(label, part.controller, values, "") for label, values in parts_of_modes(part)]
        sections[f"{name}: indices"] = index_table(rows) + notes(valve.left_out)
        if valve.spells:
            head = ["mode", "from [s]", "to [s]", "lasts [s]", "reasons"]
            rows_of_modes = _mode_rows(valve, len(valve.spells))
            text_of_modes = f"<p>{html.escape(_mode_summary(valve))}</p>"
            sections[f"{name}: modes"] = text_of_modes + (table(head, rows_of_modes) if rows_of_modes else "")
        changes = valve.valve.controller.changes if valve.valve.controller is not None else []
        marks = [at_time(valve.signals, change.time) for change in changes]
        bands = mode_bands(valve.spells, float(time[0]), float(time[-1]) + valve.signals.period)
        shown = sorted({spell.interval.mode for spell in listed(valve.spells, BANDS)})
        sections[f"{name}: signals"] = (legend(shown) if shown else "") + figure(
            _signal_plots(valve), "time [s]", marks=marks, bands=bands
        )
        spectra = [
            Plot(f"{label} [V/√Hz]", [Line(label, s.frequency, s.density, colour)], logarithmic=True)
            for label, s, colour in (
                ("error", valve.error_spectrum, "#D55E00"),
                ("voltage", valve.voltage_spectrum, "#0072B2"),
            )
            if len(s.frequency)
        ]
        if spectra:
            sections[f"{name}: spectra"] = notes(
                [text for text in valve.left_out if "spectra" in text]
            ) + figure(spectra, "frequency [Hz]", logarithmic_x=True)
    elif valve.left_out:
        sections[f"{name}: left out"] = notes(valve.left_out)
    head = ["signal", "messages", "rate [Hz]", "jitter p99 [ms]", "max [ms]", "gaps", "longest [ms]", "lost"]
    sections[f"{name}: sample rate"] = table(head, _timing_rows(valve))
    nodes = [node for node in (valve.valve.controller, valve.valve.simulator) if node is not None]
    for node in nodes:
        sections[f"Parameters of {node.name}"] = (
            "<details><summary>at the beginning</summary>"
            + table(["parameter", "value"], sorted(node.initial.items()))
            + "</details>"
            + (_changes(valve, node) if node.changes else "<p>not changed while recording</p>")
        )
    return sections


def _changes(valve: ValveAnalysis, node: Any) -> str:
    rows = [
        ("" if valve.signals is None else f"{at_time(valve.signals, change.time):.3f}", name, value)
        for change in node.changes
        for name, value in change.values.items()
    ]
    return table(["time [s]", "parameter", "new value"], rows)


def _signal_plots(valve: ValveAnalysis) -> list[Plot]:
    signals = valve.signals
    assert signals is not None
    plots = [
        Plot(
            "spool position [V]",
            [
                Line("command", signals.time, signals.command, "#000000"),
                Line("measurement", signals.time, signals.measurement, "#0072B2"),
            ],
        ),
        Plot("error [V]", [Line("error", signals.time, signals.measurement - signals.command, "#D55E00")]),
        Plot("voltage [V]", [Line("voltage", signals.time, signals.voltage, "#009E73")]),
    ]
    state = valve.valve.state
    if state is not None:
        time = seconds(state.stamp, int(signals.stamp[0]))
        if valve.valve.lockstep:
            time = (state.values["sample"] - state.values["sample"][0]) * signals.period
        theta = estimates(state)
        for name, values in theta.items():
            plots.append(Plot(f"θ̂ {name}", [Line(f"θ̂ {name}", time, values, "#CC79A7")]))
        if theta:
            plots.append(
                Plot(
                    "V2",
                    [
                        Line("V2", time, state.values["lyapunov"], "#56B4E9"),
                        Line("bound of V2", time, state.values["lyapunov_bound"], "#E69F00", dashed=True),
                    ],
                    logarithmic=True,
                )
            )
    return plots
