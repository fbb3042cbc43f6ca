# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reports a shadow or what-if replay."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.analysis import limit_cycle
from valve_control.control.analysis.indices import indices, rms
from valve_control.control.analysis.segments import Segment
from valve_control.recordings import report
from valve_control.recordings.analysis import segment_indices
from valve_control.recordings.report import BLACK, BLUE, GREEN, RED, Figure, Notes, Piece, Report, Table
from valve_control.recordings.shadow import Shadow
from valve_control.recordings.what_if import WhatIf


def _effort(voltage: Floats) -> dict[str, float]:
    known = np.isfinite(voltage)
    if not known.any():
        return {"u_rms": np.nan, "c_u": np.nan, "max": np.nan}
    got = indices(np.zeros(len(voltage)), voltage, 1.0, known)
    return {"u_rms": got.u_rms, "c_u": got.c_u, "max": float(np.max(np.abs(voltage[known])))}


def _report(
    mode: str, bag: str, valve: str, result: Shadow | WhatIf, about: Mapping[str, Any],
    columns: dict[str, Floats], section: str, pieces: Sequence[Piece],
    plots: Mapping[str, Sequence[tuple[str, Floats, str]]],
) -> Report:  # fmt: skip
    """Report of a replay in this ``mode``, with the ``pieces`` in the ``section`` before the signals."""
    head = {"bag": bag, "valve": valve, "mode": mode, "samples": len(result.time)}
    return Report(
        title=f"{bag}: {mode} replay with {about['controller']}",
        columns={"time_s": result.time, **columns},
        about={**head, **about, "left_out": result.left_out},
        sections={
            section: [*pieces, Notes(result.left_out)],
            "Signals": [Figure(report.plots_of(result.time, plots))],
        },
    )


def of_shadow(result: Shadow, bag: str, valve: str) -> Report:
    """Report of a shadow replay."""
    both = np.isfinite(result.recorded)
    difference = result.voltage - result.recorded
    times = result.time[result.differences]
    efforts = {"recorded": _effort(result.recorded), "shadow": _effort(result.voltage)}
    compared, differing = int(np.count_nonzero(both)), result.differing
    outcome = "the bag has no voltage to compare with"
    first = most = spread = None
    if compared:
        most, spread = float(np.max(np.abs(difference[both]))), rms(difference[both])
        outcome = f"all {compared} recorded voltages are the shadow's, bit for bit"
    if differing:
        first = float(times[0])
        outcome = (
            f"{differing} of {compared} voltages differ, the first at {first:.3f} s; by at most "
            f"{most:.4g} V, rms {spread:.4g} V"
        )
    about = {
        "controller": result.controller,
        "recorded_parameters": result.faithful,
        "compared": compared,
        "differing": differing,
        "bit_equal": compared > 0 and differing == 0,
        "first_difference_s": first,
        "difference_max_V": most,
        "difference_rms_V": spread,
        **efforts,
    }
    columns = {
        "command_V": result.command,
        "measurement_V": result.measurement,
        "recorded_voltage_V": result.recorded,
        "shadow_voltage_V": result.voltage,
    }
    parameters = ", recorded parameters" if result.faithful else ""
    head = f"shadow of {result.controller}, {len(result.time)} samples{parameters}"
    rows = [(name, *(f"{value:.4f}" for value in effort.values())) for name, effort in efforts.items()]
    pieces: list[Piece] = [head, Table(["", "u_rms [V]", "c_u", "max [V]"], rows), outcome]
    plots = {
        "spool position [V]": [("command", result.command, BLACK), ("measurement", result.measurement, BLUE)],
        "voltage [V]": [("recorded", result.recorded, BLUE), ("shadow", result.voltage, RED)],
        "shadow - recorded [V]": [("difference", difference, GREEN)],
    }
    return _report("shadow", bag, valve, result, about, columns, "Voltage", pieces, plots)


def of_what_if(result: WhatIf, bag: str, valve: str) -> Report:
    """Report of a what-if replay."""
    was, run = result.recorded, result.run
    recorded = segment_indices(result.original, Segment("run", "", 0, len(result.original.time)))
    cycle = limit_cycle.in_words(run.saturated, run.limit_cycle)
    table = report.index_table([("recorded", "", recorded, ""), ("what-if", run.controller, run.indices, "")])
    pieces: list[Piece] = [table, f"simulated minus recorded measurement: {result.distance:.4g} V rms"]
    pieces += [f"simulated: {cycle}"] if cycle else []
    about = {
        "controller": run.controller,
        "recorded": recorded._asdict(),
        "simulated": run.indices._asdict(),
        "true_error": run.true_error,
        "measurement_distance_rms_V": result.distance,
        "theta": run.theta,
        **limit_cycle.as_dict(run.saturated, run.limit_cycle),
        "warning": run.warning or None,
    }
    columns = {
        "command_V": was.command,
        "recorded_measurement_V": was.measurement,
        "recorded_voltage_V": was.voltage,
        "simulated_measurement_V": run.measurement,
        "simulated_position_V": run.position,
        "simulated_voltage_V": run.voltage,
    }
    errors = was.measurement - was.command, run.measurement - was.command
    plots = {
        "spool position [V]": [
            ("command", was.command, BLACK),
            ("recorded", was.measurement, BLUE),
            ("what-if", run.measurement, RED),
        ],
        "error [V]": [("recorded", errors[0], BLUE), ("what-if", errors[1], RED)],
        "voltage [V]": [("recorded", was.voltage, BLUE), ("what-if", run.voltage, RED)],
    }
    return _report("what-if", bag, valve, result, about, columns, "Indices", pieces, plots)
