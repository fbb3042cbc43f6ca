# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Compares the runs in several bags: indices side by side, motions laid over each other."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from valve_control.control.analysis.figures import COLOURS, Line, Plot
from valve_control.control.analysis.segments import motions
from valve_control.recordings.analysis import NONE, Analysis, ValveAnalysis, modes_dict
from valve_control.recordings.analysis_report import time_in
from valve_control.recordings.recording import Aligned
from valve_control.recordings.report import Figure, Notes, Report, index_table, plain

BagRun = tuple[str, ValveAnalysis, list[str]]  # name of bag and valve, results, what is left out


def runs(path: str, analysis: Analysis) -> list[BagRun]:
    """The valves of a bag."""
    bag = Path(path).stem if Path(path).is_file() else Path(path).resolve().name
    return [
        (
            f"{bag}/{name}" if len(analysis.valves) > 1 else bag,
            valve._replace(valve=None),  # type: ignore[arg-type]  # the samples, which nothing here reads
            [f"{bag}: {text}" for text in (*analysis.left_out, *valve.left_out)],
        )
        for name, valve in analysis.valves.items()
    ]


def _overlay(signals: Aligned, over: Aligned) -> tuple[float, str]:
    """Time [s] by which ``signals`` move to begin with others, and what begins then, "" for the others."""
    if signals is over:
        return 0.0, ""
    both = (over, signals)
    what = "command" if all(np.isfinite(s.command).all() for s in both) else "measurement"
    found = [motions(getattr(s, what), s.period) for s in both]  # without a rest: from the first time on
    begins = [float(s.time[one[0].start if one else 0]) for s, one in zip(both, found, strict=True)]
    return begins[0] - begins[1], what


def report(runs: Sequence[BagRun]) -> Report:
    """Report of several runs, each laid over the first one with readings; with notes and indices of each."""
    names = [name for name, *_ in runs]
    over = next((valve.signals for _, valve, _ in runs if valve.signals is not None), None)
    rows, moves, about = [], [], []
    positions, errors, voltages = [], [], []
    for i, (name, valve, left_out) in enumerate(runs):
        name += f" ({names[: i + 1].count(name)})" * (names.count(name) > 1)
        shift_s, by = None, ""
        if valve.signals is not None and over is not None:
            s, colour = valve.signals, COLOURS[i % len(COLOURS)]
            shift_s, by = _overlay(s, over)
            time = s.time + shift_s
            positions.append(Line(f"{name}: command", time, s.command, colour, True))
            positions.append(Line(name, time, s.measurement, colour))
            errors.append(Line(name, time, s.measurement - s.command, colour))
            voltages.append(Line(name, time, s.voltage, colour))
        if by:
            moves.append(f"{name}: moved by {shift_s:+.3f} s, so that its {by} begins with that of the first")
        indices, only_ok, remark = NONE, NONE, ""
        for part in valve.parts[:1]:
            indices, only_ok, remark = part.indices, part.indices_only_ok, time_in(part.not_ok_s)
        rows.append((name, valve.controller, indices, remark))
        rows += [(f"{name}, only ok", valve.controller, only_ok, "")] if remark else []
        about.append(
            {
                "name": name,
                "controller": valve.controller or None,
                "indices": indices,
                "indices_only_ok": only_ok,
                "modes": modes_dict(valve),
                "shift_s": shift_s,
                "overlaid_by": by or None,
                "left_out": left_out,
            }
        )
    plots = [Plot("spool position [V]", positions), Plot("error [V]", errors), Plot("voltage [V]", voltages)]
    return Report(
        "valve_control: bags compared",
        {"runs": plain(about)},
        {
            "Indices": [index_table(rows), Notes([text for _, _, left_out in runs for text in left_out])],
            "Signals, overlaid by their motion": [*moves, Figure(plots)],
        },
    )
