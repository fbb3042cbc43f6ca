# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Compares runs of several bags, shifted in time so that their motions coincide: JSON, PNG and HTML."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from valve_control.control.analysis.figures import COLOURS, Line, Plot, Trace, draw_traces
from valve_control.control.analysis.indices import Indices
from valve_control.control.analysis.overlay import TimedSignal, shift
from valve_control.control.analysis.tables import HEADER, index_row
from valve_control.recordings.analysis import NONE, Analysis, modes_dict
from valve_control.recordings.analysis_report import time_in
from valve_control.recordings.recording import Aligned
from valve_control.recordings.report import Figure, Notes, Report, index_table, noted


class BagRun(NamedTuple):
    """One valve of one bag, with its results."""

    name: str  # bag and valve
    controller: str
    indices: Indices
    signals: Aligned | None
    left_out: list[str]
    only_ok: Indices  # of what the controller did in the mode ok
    time_in: dict[str, float]  # s in the other modes
    modes: dict[str, Any] | None  # for JSON
    shift: float | None = None  # s, to lie over the first run; None without readings
    by: str = ""  # what shows that


def runs(path: str, analysis: Analysis) -> list[BagRun]:
    """The valves of a bag."""
    bag = Path(path).stem if Path(path).is_file() else Path(path).resolve().name
    many = len(analysis.valves) > 1
    return [
        BagRun(
            name=f"{bag}/{name}" if many else bag,
            controller=valve.controller,
            indices=valve.parts[0].indices if valve.parts else NONE,
            signals=valve.signals,
            left_out=[f"{bag}: {text}" for text in (*analysis.left_out, *valve.left_out)],
            only_ok=valve.parts[0].only_ok if valve.parts else NONE,
            time_in=valve.parts[0].time_in if valve.parts else {},
            modes=modes_dict(valve),
        )
        for name, valve in analysis.valves.items()
    ]


def overlaid(runs: Sequence[BagRun]) -> list[BagRun]:
    """``runs``, each with the time [s] that lays its motion over that of the first one with readings."""
    first = next((run.signals for run in runs if run.signals is not None), None)
    if first is None:
        return list(runs)
    return [
        run if run.signals is None else run._replace(shift=moved, by=by)
        for run in runs
        for moved, by in (_overlay(run.signals, first) if run.signals is not None else (0.0, ""),)
    ]


def _overlay(signals: Aligned, over: Aligned) -> tuple[float, str]:
    if signals is over:
        return 0.0, ""
    both = (signals, over)
    commanded = all(np.isfinite(s.command).all() for s in both)
    moved, alike = shift(
        *(TimedSignal(s.time, s.command if commanded else s.measurement, s.period) for s in both)
    )
    what = "command" if commanded else "measurement"
    return moved, what if alike else f"beginning of the {what}'s motion"


def moves(names: Sequence[str], runs: Sequence[BagRun]) -> list[str]:
    """By how much each run was shifted to lie over the first, in words."""
    return [
        f"{name}: moved by {run.shift:+.3f} s to lie over the first by its {run.by}"
        for name, run in zip(names, runs, strict=True)
        if run.shift is not None and run.by
    ]


def labels(names: Sequence[str]) -> list[str]:
    """``names``, numbered where two are the same."""
    return [
        f"{name} ({names[: i + 1].count(name)})" if names.count(name) > 1 else name
        for i, name in enumerate(names)
    ]


def as_dict(name: str, run: BagRun) -> dict[str, Any]:
    """One run for JSON."""
    return {
        "name": name,
        "controller": run.controller or None,
        "indices": run.indices._asdict(),
        "indices_only_ok": run.only_ok._asdict(),
        "modes": run.modes,
        "shift_s": run.shift,
        "overlaid_by": run.by or None,
        "left_out": run.left_out,
    }


def draw(path: Path, runs: Sequence[BagRun]) -> None:
    """Draw ``runs``, overlaid by their motion, as the PNG file ``path``. Raises OSError."""
    runs = overlaid(runs)
    names = labels([run.name for run in runs])
    traces = {
        name: Trace(
            run.signals.time + run.shift, run.signals.command, run.signals.measurement, run.signals.voltage
        )
        for name, run in zip(names, runs, strict=True)
        if run.signals is not None and run.shift is not None
    }
    draw_traces(path, {"recorded": traces}, "valve_control: bags", own_commands=True)


def report(runs: Sequence[BagRun]) -> Report:
    """Report of runs that are not overlaid yet, with indices and notes of each."""
    runs = overlaid(runs)
    names = labels([run.name for run in runs])
    width = max(14, *(len(name) + 2 for name in names))
    lines = [" " * (width - 14) + HEADER]
    rows, positions, errors, voltages = [], [], [], []
    for i, (name, run) in enumerate(zip(names, runs, strict=True)):
        remark = time_in(run.time_in)
        lines.append(index_row(f"{name:{width}}", run.indices) + (f"  {remark}" if remark else ""))
        rows.append((name, run.controller, run.indices, remark))
        if remark:
            lines.append(index_row(f"{'  only ok':{width}}", run.only_ok))
            rows.append((f"{name}, only ok", run.controller, run.only_ok, ""))
        if run.signals is None or run.shift is None:
            continue
        s, colour = run.signals, COLOURS[i % len(COLOURS)]
        time = s.time + run.shift
        positions.append(Line(f"{name}: command", time, s.command, colour, True))
        positions.append(Line(name, time, s.measurement, colour))
        errors.append(Line(name, time, s.measurement - s.command, colour))
        voltages.append(Line(name, time, s.voltage, colour))
    plots = [Plot("spool position [V]", positions), Plot("error [V]", errors), Plot("voltage [V]", voltages)]
    notes, shifts = [text for run in runs for text in run.left_out], moves(names, runs)
    return Report(
        "valve_control: bags compared",
        [*lines, *shifts, *noted(notes)],
        {"runs": [as_dict(name, run) for name, run in zip(names, runs, strict=True)]},
        {
            "Indices": [index_table(rows), Notes(notes)],
            "Signals, overlaid by their motion": [Notes(shifts), Figure(plots)],
        },
    )
