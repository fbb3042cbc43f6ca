# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reports a shadow or what-if replay."""

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.analysis import limit_cycle
from valve_control.control.analysis.indices import indices, rms
from valve_control.control.analysis.segments import Segment
from valve_control.recordings import report
from valve_control.recordings.analysis import segment_indices
from valve_control.recordings.report import BLACK, BLUE, GREEN, RED, Figure, Notes, Report, Table
from valve_control.recordings.shadow import Shadow
from valve_control.recordings.what_if import WhatIf


def _effort(voltage: Floats) -> dict[str, float]:
    known = np.isfinite(voltage)
    if not known.any():
        return {"u_rms": np.nan, "c_u": np.nan, "max": np.nan}
    got = indices(np.zeros(len(voltage)), voltage, 1.0, known)
    return {"u_rms": got.u_rms, "c_u": got.c_u, "max": float(np.max(np.abs(voltage[known])))}


def of_shadow(result: Shadow, bag: str, valve: str) -> Report:
    """Report of a shadow replay."""
    both = np.isfinite(result.recorded)
    difference = result.voltage[both] - result.recorded[both]
    times = result.time[result.differences]
    efforts = {"recorded": _effort(result.recorded), "shadow": _effort(result.voltage)}
    about = {
        "bag": bag,
        "valve": valve,
        "mode": "shadow",
        "controller": result.controller,
        "recorded_parameters": result.faithful,
        "samples": len(result.time),
        "compared": int(np.count_nonzero(both)),
        "differing": result.differing,
        "bit_equal": bool(np.any(both)) and result.differing == 0,
        "first_difference_s": float(times[0]) if len(times) else None,
        "difference_max_V": float(np.max(np.abs(difference))) if len(difference) else None,
        "difference_rms_V": rms(difference) if len(difference) else None,
        **efforts,
        "left_out": result.left_out,
    }
    if about["bit_equal"]:
        outcome = f"all {about['compared']} recorded voltages are the shadow's, bit for bit"
    elif len(times):
        outcome = (
            f"{about['differing']} of {about['compared']} voltages differ, the first at "
            f"{about['first_difference_s']:.3f} s; by at most {about['difference_max_V']:.4g} V, "
            f"rms {about['difference_rms_V']:.4g} V"
        )
    else:
        outcome = "the bag has no voltage to compare with"
    parameters = ", recorded parameters" if result.faithful else ""
    head = f"shadow of {result.controller}, {len(result.time)} samples{parameters}"
    rows = [(name, *(f"{value:.4f}" for value in effort.values())) for name, effort in efforts.items()]
    plots = {
        "spool position [V]": [
            ("command", result.command, BLACK),
            ("measurement", result.measurement, BLUE),
        ],
        "voltage [V]": [("recorded", result.recorded, BLUE), ("shadow", result.voltage, RED)],
        "shadow - recorded [V]": [("difference", result.voltage - result.recorded, GREEN)],
    }
    return Report(
        title=f"{bag}: shadow replay with {result.controller}",
        columns={
            "time_s": result.time,
            "command_V": result.command,
            "measurement_V": result.measurement,
            "recorded_voltage_V": result.recorded,
            "shadow_voltage_V": result.voltage,
        },
        about=about,
        sections={
            "Voltage": [
                head,
                Table(["", "u_rms [V]", "c_u", "max [V]"], rows),
                outcome,
                Notes(result.left_out),
            ],
            "Signals": [Figure(report.plots_of(result.time, plots))],
        },
    )


def of_what_if(result: WhatIf, bag: str, valve: str) -> Report:
    """Report of a what-if replay."""
    was, run = result.recorded, result.run
    recorded = segment_indices(result.original, Segment("run", "", 0, len(result.original.time)))
    cycle = limit_cycle.in_words(run.saturated, run.limit_cycle)
    table = report.index_table([("recorded", "", recorded, ""), ("what-if", run.controller, run.indices, "")])
    sentences = [f"simulated minus recorded measurement: {result.distance:.4g} V rms"]
    sentences += [f"simulated: {cycle}"] if cycle else []
    plots = {
        "spool position [V]": [
            ("command", was.command, BLACK),
            ("recorded", was.measurement, BLUE),
            ("what-if", run.measurement, RED),
        ],
        "error [V]": [
            ("recorded", was.measurement - was.command, BLUE),
            ("what-if", run.measurement - was.command, RED),
        ],
        "voltage [V]": [("recorded", was.voltage, BLUE), ("what-if", run.voltage, RED)],
    }
    return Report(
        title=f"{bag}: what-if replay with {run.controller}",
        columns={
            "time_s": result.time,
            "command_V": was.command,
            "recorded_measurement_V": was.measurement,
            "recorded_voltage_V": was.voltage,
            "simulated_measurement_V": run.measurement,
            "simulated_position_V": run.position,
            "simulated_voltage_V": run.voltage,
        },
        about={
            "bag": bag,
            "valve": valve,
            "mode": "what-if",
            "controller": run.controller,
            "samples": len(result.time),
            "recorded": recorded._asdict(),
            "simulated": run.indices._asdict(),
            "true_error": run.true_error,
            "measurement_distance_rms_V": result.distance,
            "theta": run.theta,
            **limit_cycle.as_dict(run.saturated, run.limit_cycle),
            "warning": run.warning or None,
            "left_out": result.left_out,
        },
        sections={
            "Indices": [table, *sentences, Notes(result.left_out)],
            "Signals": [Figure(report.plots_of(result.time, plots))],
        },
    )
