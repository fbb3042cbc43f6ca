# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reports the analysis of a bag as text for a terminal, as CSV, and as an HTML page."""

import html
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from valve_control import outputs
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
from valve_control.recordings.recording import at_time

LISTED = 12  # motions, and intervals of modes, in the terminal; all of them are in JSON and HTML
REASONS = 3  # of one interval in the terminal
BANDS = 500  # in one figure
COLOURS = {Mode.DEGRADED: "#E69F00", Mode.SAFE: "#CC0000", Mode.INACTIVE: "#777777", Mode.UNKNOWN: "#777777"}
SILENT = "nothing was heard of the controller"
DETAIL = 1.0  # s before and after the largest error, shown sample by sample


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
    if any(other.whole for other in valve.pace.others):
        head += f", LVDT readings every {1e3 * valve.pace.measured:.4g} ms"
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


def _reasons(spell: Spell, most: int | None = None) -> str:
    reasons = spell.interval.reasons
    if spell.interval.mode is Mode.UNKNOWN:
        return SILENT
    if not reasons:
        return "(the reason is not recorded)"
    more = len(reasons) - len(reasons[:most])
    return "; ".join(reasons[:most]) + (f" (and {more} more)" if more else "")


def _mode_lines(valve: ValveAnalysis) -> list[str]:
    about = modes_dict(valve)
    if about is None:
        return []
    grave = listed(valve.spells, LISTED)
    if not grave:
        return ["modes: ok throughout"]
    told = []
    for mode in Mode:
        entry = about[mode.name.lower()]
        if mode is not Mode.OK and entry["intervals"]:
            times = f"{entry['intervals']} time{'s' if entry['intervals'] > 1 else ''}"
            told.append(f"{mode.name.lower()} {times}, {entry['duration_s']:.3f} s")
    share = f"ok {100.0 * about['ok']['share']:.1f} % of the time" if about["ok"]["share"] is not None else ""
    lines = [f"modes: {'; '.join(filter(None, [share, *told]))}"]
    lines.append(f"{'':14}{'from [s]':>10}{'to [s]':>10}{'lasts [s]':>11}")
    for spell in grave:
        name, lasts = spell.interval.mode.name.lower(), spell.end - spell.start
        row = f"{name:14}{spell.start:10.3f}{spell.end:10.3f}{lasts:11.3f}"
        lines.append(f"{row}  {_reasons(spell, REASONS)}")
    more = sum(about[mode.name.lower()]["intervals"] for mode in Mode if mode is not Mode.OK) - len(grave)
    if more:
        lines.append(f"({more} more in --json and --html)")
    return lines


def mode_bands(spells: list[Spell], begin: float, end: float) -> list[Band]:
    """Bands for a figure from ``begin`` to ``end`` [s], where the mode is not ok."""
    return [
        Band(max(spell.start, begin), min(spell.end, end), COLOURS[spell.interval.mode])
        for spell in listed(spells, BANDS)
        if spell.start < end and spell.end > begin
    ]


def _mode_section(valve: ValveAnalysis) -> str:
    rows = [
        (
            spell.interval.mode.name.lower(),
            f"{spell.start:.3f}",
            f"{spell.end:.3f}",
            f"{spell.end - spell.start:.3f}",
            str(spell.samples),
            _reasons(spell),
        )
        for spell in listed(valve.spells, len(valve.spells))
    ]
    if not rows:
        return "<p>ok throughout</p>"
    head = ["mode", "from [s]", "to [s]", "lasts [s]", "samples", "reasons"]
    return f"<p>{html.escape(_mode_lines(valve)[0])}</p>" + table(head, rows)


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


def write_csv(path: Path, valve: ValveAnalysis) -> None:
    """Aligned signals of one valve, one reading a line. Raises OSError."""
    assert valve.signals is not None
    signals = valve.signals
    columns = {
        "time_s": signals.time,
        "stamp_ns": signals.stamp,
        "command_V": signals.command,
        "measurement_V": signals.measurement,
        "error_V": signals.measurement - signals.command,
        "voltage_V": signals.voltage,
    }
    lines = [",".join(columns) + "\n"]
    row = "%.9f,%d,%.17g,%.17g,%.17g,%.17g\n"
    for start in range(0, len(signals.time), 100_000):
        piece = zip(*(column[start : start + 100_000].tolist() for column in columns.values()), strict=True)
        lines.append("".join(row % numbers for numbers in piece))
    outputs.write(str(path), "".join(lines))


def write_html(path: Path, analysis: Analysis) -> None:
    """The report as one self-contained page. Raises OSError."""
    title = f"{Path(str(analysis.recording.bag.path)).name}: valve report"
    outputs.write(str(path), page(title, _sections(analysis)))


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
            sections[f"{name}: modes"] = _mode_section(valve)
        changes = valve.valve.controller.changes if valve.valve.controller is not None else []
        marks = [at_time(valve.signals, change.time) for change in changes]
        bands = mode_bands(valve.spells, float(time[0]), float(time[-1]) + valve.signals.period)
        shown = sorted({spell.interval.mode for spell in listed(valve.spells, BANDS)})
        sections[f"{name}: signals"] = (legend(shown) if shown else "") + figure(
            _signal_plots(valve), "time [s]", marks=marks, bands=bands
        )
        detail = _detail(valve)
        if detail:
            sections[f"{name}: around the largest error, sample by sample"] = detail
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
    sections[f"{name}: sample rate"] = table(head, _timing_rows(valve)) + _timing_figure(valve)
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


def _detail(valve: ValveAnalysis) -> str:
    signals = valve.signals
    assert signals is not None
    error = signals.measurement - signals.command
    if not np.any(np.isfinite(error)) or len(error) <= 4000:
        return ""
    worst = float(signals.time[int(np.nanargmax(np.abs(error)))])
    near = np.abs(signals.time - worst) <= DETAIL
    cut = valve._replace(
        signals=signals._replace(
            time=signals.time[near],
            stamp=signals.stamp[near],
            command=signals.command[near],
            measurement=signals.measurement[near],
            voltage=signals.voltage[near],
        ),
        valve=valve.valve._replace(state=None),
    )
    bands = mode_bands(valve.spells, worst - DETAIL, worst + DETAIL)
    return figure(_signal_plots(cut), "time [s]", bands=bands)


def _timing_figure(valve: ValveAnalysis) -> str:
    plots = []
    begin = int(valve.signals.stamp[0]) if valve.signals is not None else 0
    for part, samples in valve.valve.signals.items():
        if len(samples.time) > 1:
            time, intervals = seconds(samples.time[1:], begin), seconds(samples.time[1:], samples.time[:-1])
            plots.append(Plot(f"{part} [ms]", [Line(part, time, 1e3 * intervals)]))
    return "<p>Time between two messages:</p>" + figure(plots, "time [s]", height=180) if plots else ""
