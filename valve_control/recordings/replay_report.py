# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reports a shadow replay."""

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.analysis.indices import indices, rms
from valve_control.recordings import report
from valve_control.recordings.report import BLACK, BLUE, GREEN, RED, Figure, Notes, Report, Table
from valve_control.recordings.shadow_replay import Shadow


def _effort(voltage: Floats) -> dict[str, float]:
    known = np.isfinite(voltage)
    if not known.any():
        return {"u_rms": np.nan, "c_u": np.nan, "max": np.nan}
    got = indices(np.zeros(len(voltage)), voltage, 1.0, known)
    return {"u_rms": got.u_rms, "c_u": got.c_u, "max": float(np.max(np.abs(voltage[known])))}


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
        "bag": bag,
        "valve": valve,
        "mode": "shadow",
        "samples": len(result.time),
        "controller": result.controller,
        "recorded_parameters": result.faithful,
        "compared": compared,
        "differing": differing,
        "bit_equal": compared > 0 and differing == 0,
        "first_difference_s": first,
        "difference_max_V": most,
        "difference_rms_V": spread,
        **efforts,
        "left_out": result.left_out,
    }
    columns = {
        "time_s": result.time,
        "command_V": result.command,
        "measurement_V": result.measurement,
        "recorded_voltage_V": result.recorded,
        "shadow_voltage_V": result.voltage,
    }
    parameters = ", recorded parameters" if result.faithful else ""
    head = f"shadow of {result.controller}, {len(result.time)} samples{parameters}"
    rows = [(name, *(f"{value:.4f}" for value in effort.values())) for name, effort in efforts.items()]
    table = Table(["", "u_rms [V]", "c_u", "max [V]"], rows)
    plots = {
        "spool position [V]": [("command", result.command, BLACK), ("measurement", result.measurement, BLUE)],
        "voltage [V]": [("recorded", result.recorded, BLUE), ("shadow", result.voltage, RED)],
        "shadow - recorded [V]": [("difference", difference, GREEN)],
    }
    return Report(
        f"{bag}: shadow replay with {result.controller}",
        about,
        {
            "Voltage": [head, table, outcome, Notes(result.left_out)],
            "Signals": [Figure(report.plots_of(result.time, plots))],
        },
        columns,
    )
