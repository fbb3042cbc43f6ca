"""A study as text for a terminal, as CSV, and as an HTML page."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from valve_control.analysis.figures import Line, Plot
from valve_control.analysis.indices import Indices
from valve_control.analysis.page import figure, notes, page, table
from valve_control.analysis.tables import HEADER, index_row
from valve_control.recordings.cleaning import seconds
from valve_control.recordings.recording import at_time
from valve_control.recordings.study import Study, ValveStudy, about_bag, estimates, guarantee_use

Floats = npt.NDArray[np.float64]
LISTED = 12  # motions in the terminal; all of them are in JSON and HTML
DETAIL = 1.0  # s before and after the largest error, shown sample by sample


def text(study: Study) -> str:
    """The study as tables for a terminal."""
    about = about_bag(study)
    lines = [
        f"{about['path']}: {about['storage']}{', ' + about['compression'] if about['compression'] else ''}, "
        f"{about['bytes'] / 1e6:.1f} MB, {about['duration_s']:.3f} s from {about['start']}"
    ]
    for name, valve in study.valves.items():
        lines += ["", *_valve_lines(name, valve)]
    if study.left_out:
        lines += ["", *(f"note: {note}" for note in study.left_out)]
    return "\n".join(lines)


def _valve_lines(name: str, valve: ValveStudy) -> list[str]:
    period = valve.signals.period if valve.signals is not None else np.nan
    lines = [f"{name}: controller {valve.controller or 'unknown'}, sample period {1e3 * period:.4g} ms"]
    if valve.parts:
        lines.append(HEADER)
        motions = [part for part in valve.parts if part.segment.kind == "motion"]
        shown = [part for part in valve.parts if part.segment.kind != "motion" or part in motions[:LISTED]]
        for part in shown:
            lines.append(index_row(part.segment.name, part.indices))
        if len(motions) > LISTED:
            lines.append(f"({len(motions) - LISTED} more motions in --json and --html)")
        for part in shown:
            if part.change:
                lines.append(f"{part.segment.name}: {part.change}")
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


def _timing_rows(valve: ValveStudy) -> list[list[str]]:
    return [
        [
            part,
            str(entry.messages),
            f"{entry.rate_hz:.2f}",
            f"{1e3 * entry.jitter_s.p99:.3f}",
            f"{1e3 * entry.jitter_s.max:.3f}",
            str(entry.gaps),
            f"{1e3 * entry.longest_gap_s:.2f}",
            "?" if entry.lost is None else str(entry.lost),
        ]
        for part, entry in valve.timing.items()
    ]


def write_csv(path: Path, valve: ValveStudy) -> None:
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
    with path.open("w", encoding="utf-8") as stream:
        stream.write(",".join(columns) + "\n")
        row = "%.9f,%d,%.17g,%.17g,%.17g,%.17g\n"
        for start in range(0, len(signals.time), 100_000):
            piece = zip(
                *(column[start : start + 100_000].tolist() for column in columns.values()), strict=True
            )
            stream.writelines(row % numbers for numbers in piece)


def write_html(path: Path, study: Study) -> None:
    """The report as one self-contained page. Raises OSError."""
    path.write_text(
        page(f"{Path(str(study.recording.bag.path)).name}: valve report", _sections(study)), encoding="utf-8"
    )


def _sections(study: Study) -> dict[str, str]:
    about = about_bag(study)
    sections = {
        "Bag": table(["", ""], [(key, _plain(value)) for key, value in about.items() if key != "topics"])
        + table(["topic", "type"], list(about["topics"].items()))
        + notes(study.left_out)
    }
    for name, valve in study.valves.items():
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


def _valve_sections(name: str, valve: ValveStudy) -> dict[str, str]:
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
                    part.change,
                )
            )
        sections[f"{name}: indices"] = index_table(rows) + notes(valve.left_out)
        changes = valve.valve.controller.changes if valve.valve.controller is not None else []
        marks = [at_time(valve.signals, change.time) for change in changes]
        sections[f"{name}: signals"] = figure(_signal_plots(valve), "time [s]", marks=marks)
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
            sections[f"{name}: spectra"] = figure(spectra, "frequency [Hz]", logarithmic_x=True)
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


def _changes(valve: ValveStudy, node: Any) -> str:
    rows = [
        ("" if valve.signals is None else f"{at_time(valve.signals, change.time):.3f}", name, value)
        for change in node.changes
        for name, value in change.values.items()
    ]
    return table(["time [s]", "parameter", "new value"], rows)


def _signal_plots(valve: ValveStudy) -> list[Plot]:
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


def _detail(valve: ValveStudy) -> str:
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
    return figure(_signal_plots(cut), "time [s]")


def _timing_figure(valve: ValveStudy) -> str:
    plots = []
    begin = int(valve.signals.stamp[0]) if valve.signals is not None else 0
    for part, samples in valve.valve.signals.items():
        if len(samples.time) > 1:
            time, intervals = seconds(samples.time[1:], begin), seconds(samples.time[1:], samples.time[:-1])
            plots.append(Plot(f"{part} [ms]", [Line(part, time, 1e3 * intervals)]))
    return "<p>Time between two messages:</p>" + figure(plots, "time [s]", height=180) if plots else ""
