# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reports shadow and what-if replays as text, CSV columns, JSON and HTML."""

from typing import Any

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.analysis import limit_cycle
from valve_control.control.analysis.figures import Line, Plot
from valve_control.control.analysis.indices import indices, rms
from valve_control.control.analysis.page import figure, notes, page, table
from valve_control.control.analysis.segments import Segment
from valve_control.control.analysis.tables import HEADER, index_row
from valve_control.recordings.analysis import segment_indices
from valve_control.recordings.analysis_report import index_table
from valve_control.recordings.shadow import Shadow
from valve_control.recordings.what_if import WhatIf


def _effort(voltage: Floats) -> dict[str, float]:
    known = np.isfinite(voltage)
    if not known.any():
        return {"u_rms": np.nan, "c_u": np.nan, "max": np.nan}
    got = indices(np.zeros(len(voltage)), voltage, 1.0, known)
    return {"u_rms": got.u_rms, "c_u": got.c_u, "max": float(np.max(np.abs(voltage[known])))}


def shadow_dict(result: Shadow, bag: str, valve: str) -> dict[str, Any]:
    """A shadow replay for JSON."""
    both = np.isfinite(result.recorded)
    difference = result.voltage[both] - result.recorded[both]
    first = result.first_difference
    return {
        "bag": bag,
        "valve": valve,
        "mode": "shadow",
        "controller": result.controller,
        "recorded_parameters": result.faithful,
        "samples": len(result.time),
        "compared": int(np.count_nonzero(both)),
        "differing": result.differing,
        "bit_equal": bool(np.any(both)) and result.differing == 0,
        "first_difference_s": None if first is None else float(result.time[first]),
        "difference_max_V": float(np.max(np.abs(difference))) if len(difference) else None,
        "difference_rms_V": rms(difference) if len(difference) else None,
        "recorded": _effort(result.recorded),
        "shadow": _effort(result.voltage),
        "left_out": result.left_out,
    }


def shadow_text(result: Shadow) -> str:
    """A shadow replay for a terminal."""
    about = shadow_dict(result, "", "")
    lines = [
        f"shadow of {result.controller}, {about['samples']} samples"
        + (", recorded parameters" if result.faithful else "")
    ]
    lines.append(f"{'voltage':14}{'u_rms [V]':>11}{'c_u':>9}{'max [V]':>9}")
    for name in ("recorded", "shadow"):
        effort = about[name]
        lines.append(f"{name:14}{effort['u_rms']:11.4f}{effort['c_u']:9.4f}{effort['max']:9.3f}")
    if about["bit_equal"]:
        lines.append(f"all {about['compared']} recorded voltages are the shadow's, bit for bit")
    elif about["compared"]:
        lines.append(
            f"{about['differing']} of {about['compared']} voltages differ, the first at "
            f"{about['first_difference_s']:.3f} s; by at most {about['difference_max_V']:.4g} V, "
            f"rms {about['difference_rms_V']:.4g} V"
        )
    else:
        lines.append("the bag has no voltage to compare with")
    return "\n".join([*lines, *(f"note: {text}" for text in result.left_out)])


def shadow_columns(result: Shadow) -> dict[str, Floats]:
    """A shadow replay for CSV."""
    return {
        "time_s": result.time,
        "command_V": result.command,
        "measurement_V": result.measurement,
        "recorded_voltage_V": result.recorded,
        "shadow_voltage_V": result.voltage,
    }


def shadow_page(result: Shadow, bag: str) -> str:
    """A shadow replay as an HTML page."""
    about = shadow_dict(result, bag, "")
    rows = [(name, *(f"{value:.4f}" for value in about[name].values())) for name in ("recorded", "shadow")]
    time = result.time
    plots = [
        Plot(
            "spool position [V]",
            [Line("command", time, result.command, "#000000"), Line("measurement", time, result.measurement)],
        ),
        Plot(
            "voltage [V]",
            [
                Line("recorded", time, result.recorded, "#0072B2"),
                Line("shadow", time, result.voltage, "#D55E00"),
            ],
        ),
        Plot(
            "shadow - recorded [V]", [Line("difference", time, result.voltage - result.recorded, "#009E73")]
        ),
    ]
    sections = {
        "Voltage": table(["", "u_rms [V]", "c_u", "max [V]"], rows)
        + f"<p>{shadow_text(result).splitlines()[4]}</p>"
        + notes(result.left_out),
        "Signals": figure(plots, "time [s]"),
    }
    return page(f"{bag}: shadow replay with {result.controller}", sections)


def _both(result: WhatIf) -> tuple[Any, Any]:
    recorded = segment_indices(result.original, Segment("run", "", 0, len(result.original.time)))
    return recorded, result.run.indices


def what_if_dict(result: WhatIf, bag: str, valve: str) -> dict[str, Any]:
    """A what-if replay for JSON."""
    recorded, simulated = _both(result)
    return {
        "bag": bag,
        "valve": valve,
        "mode": "what-if",
        "controller": result.run.controller,
        "samples": len(result.time),
        "recorded": recorded._asdict(),
        "simulated": simulated._asdict(),
        "true_error": result.run.true_error,
        "measurement_distance_rms_V": result.distance,
        "theta": result.run.theta,
        **limit_cycle.as_dict(result.run.saturated, result.run.limit_cycle),
        "warning": result.run.warning or None,
        "left_out": result.left_out,
    }


def what_if_text(result: WhatIf) -> str:
    """A what-if replay for a terminal."""
    recorded, simulated = _both(result)
    lines = [
        HEADER,
        index_row("recorded", recorded),
        index_row(f"what-if {result.run.controller}", simulated),
        f"simulated minus recorded measurement: {result.distance:.4g} V rms",
    ]
    cycle = limit_cycle.in_words(result.run.saturated, result.run.limit_cycle)
    if cycle:
        lines.append(f"simulated: {cycle}")
    return "\n".join([*lines, *(f"note: {text}" for text in result.left_out)])


def what_if_columns(result: WhatIf) -> dict[str, Floats]:
    """A what-if replay for CSV."""
    return {
        "time_s": result.time,
        "command_V": result.recorded.command,
        "recorded_measurement_V": result.recorded.measurement,
        "recorded_voltage_V": result.recorded.voltage,
        "simulated_measurement_V": result.run.measurement,
        "simulated_position_V": result.run.position,
        "simulated_voltage_V": result.run.voltage,
    }


def what_if_page(result: WhatIf, bag: str) -> str:
    """A what-if replay as an HTML page."""
    recorded, simulated = _both(result)
    time, was, run = result.time, result.recorded, result.run
    plots = [
        Plot(
            "spool position [V]",
            [
                Line("command", time, was.command, "#000000"),
                Line("recorded", time, was.measurement, "#0072B2"),
                Line("what-if", time, run.measurement, "#D55E00"),
            ],
        ),
        Plot(
            "error [V]",
            [
                Line("recorded", time, was.measurement - was.command, "#0072B2"),
                Line("what-if", time, run.measurement - was.command, "#D55E00"),
            ],
        ),
        Plot(
            "voltage [V]",
            [Line("recorded", time, was.voltage, "#0072B2"), Line("what-if", time, run.voltage, "#D55E00")],
        ),
    ]
    rows = [("recorded", "", recorded, ""), ("what-if", run.controller, simulated, "")]
    sections = {
        "Indices": index_table(rows) + notes(result.left_out),
        "Signals": figure(plots, "time [s]"),
    }
    return page(f"{bag}: what-if replay with {run.controller}", sections)
