# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Compares runs of several bags, shifted in time so that their motions coincide: JSON, PNG and HTML."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from valve_control.control.analysis.figures import COLOURS, Line, Plot, Trace, draw_traces
from valve_control.control.analysis.overlay import TimedSignal, shift
from valve_control.recordings.analysis import NONE, Analysis, ValveAnalysis, modes_dict
from valve_control.recordings.analysis_report import time_in
from valve_control.recordings.recording import Aligned
from valve_control.recordings.report import Figure, Notes, Report, index_table, plain


class BagRun(NamedTuple):
    """One valve of one bag, with its results."""

    name: str  # bag and valve
    valve: ValveAnalysis
    left_out: list[str]
    shift: float | None = None  # s, to lie over the first run; None without readings
    by: str = ""  # what shows that

    @property
    def signals(self) -> Aligned | None:
        """Its signals, None without readings."""
        return self.valve.signals


def runs(path: str, analysis: Analysis) -> list[BagRun]:
    """The valves of a bag."""
    bag = Path(path).stem if Path(path).is_file() else Path(path).resolve().name
    return [
        BagRun(
            name=f"{bag}/{name}" if len(analysis.valves) > 1 else bag,
            valve=valve,
            left_out=[f"{bag}: {text}" for text in (*analysis.left_out, *valve.left_out)],
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


def labels(names: Sequence[str]) -> list[str]:
    """``names``, numbered where two are the same."""
    return [
        f"{name} ({names[: i + 1].count(name)})" if names.count(name) > 1 else name
        for i, name in enumerate(names)
    ]


def as_dict(name: str, run: BagRun) -> dict[str, Any]:
    """One run for JSON."""
    whole = run.valve.parts[0] if run.valve.parts else None
    about: dict[str, Any] = plain(
        {
            "name": name,
            "controller": run.valve.controller or None,
            "indices": whole.indices if whole is not None else NONE,
            "indices_only_ok": whole.indices_only_ok if whole is not None else NONE,
            "modes": modes_dict(run.valve),
            "shift_s": run.shift,
            "overlaid_by": run.by or None,
            "left_out": run.left_out,
        }
    )
    return about


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
    rows, positions, errors, voltages = [], [], [], []
    for i, (name, run) in enumerate(zip(names, runs, strict=True)):
        for whole in run.valve.parts[:1]:
            remark = time_in(whole.not_ok_s)
            rows.append((name, run.valve.controller, whole.indices, remark))
            if remark:
                rows.append((f"{name}, only ok", run.valve.controller, whole.indices_only_ok, ""))
        if run.signals is None or run.shift is None:
            continue
        s, colour = run.signals, COLOURS[i % len(COLOURS)]
        time = s.time + run.shift
        positions.append(Line(f"{name}: command", time, s.command, colour, True))
        positions.append(Line(name, time, s.measurement, colour))
        errors.append(Line(name, time, s.measurement - s.command, colour))
        voltages.append(Line(name, time, s.voltage, colour))
    moves = [
        f"{name}: moved by {run.shift:+.3f} s to lie over the first by its {run.by}"
        for name, run in zip(names, runs, strict=True)
        if run.shift is not None and run.by
    ]
    plots = [Plot("spool position [V]", positions), Plot("error [V]", errors), Plot("voltage [V]", voltages)]
    return Report(
        "valve_control: bags compared",
        {"runs": [as_dict(name, run) for name, run in zip(names, runs, strict=True)]},
        {
            "Indices": [index_table(rows), Notes([text for run in runs for text in run.left_out])],
            "Signals, overlaid by their motion": [*moves, Figure(plots)],
        },
    )
