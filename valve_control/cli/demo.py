# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the sub-command `demo`: one slow, sticky valve without control, under a PID, and under dcarc."""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from valve_control.arrays import Floats
from valve_control.cli.common import wrote
from valve_control.control.analysis.figures import LAW_COLOURS, Line, Plot, Trace, draw_columns
from valve_control.control.analysis.indices import indices
from valve_control.control.parameters import build, files, ros_file
from valve_control.control.parameters.table import NODES
from valve_control.control.simulation import offline
from valve_control.parameter import Value, Values, defaults, number, updated

LAWS = {  # in config/demo, and how the table calls them
    "open_loop": "uncontrolled",
    "pid": "best PID",
    "arc": "ARC",
    "oarc": "OARC",
    "dcarc": "dcarc",
}
DRAWN = {law: LAW_COLOURS[law] for law in ("open_loop", "pid", "dcarc")}
MOTION = {"strokes of 40 V/s": (1.15, 1.85), "sines": (3.6, 4.3)}  # s  of each that the figure shows
STROKES = 2.7  # s  until the sines begin
STROKE = 1.5  # V
BAND = 0.02  # of the stroke, within which the spool has settled
HEAD = (
    f"{'':14}{'rms error [%]':>18}{'largest error [%]':>18}{'settled after':>16}{'largest [V]':>14}{'c_u':>8}"
)


def files_of(law: str) -> tuple[str, ...]:
    """Files of the folder config with the valve, and with the gains of ``law``."""
    return ("demo/valve.yaml", f"demo/{law}.yaml")


def motion() -> dict[str, Value]:
    """Parameters of the command source."""
    file = str(ros_file.config_folder() / "commands/demo.csv")
    return {"scenario": "array", "command_file": file, "message": "trajectory"}


def values_of(law: str) -> dict[str, Values]:
    """All parameters of controller, simulated valve and command under ``law``. Raises ParameterError."""
    paths = [str(ros_file.config_folder() / name) for name in files_of(law)]
    changes = files.given(paths, {"command_source": motion()}, [])
    return {node: updated(table, defaults(table), changes[node]) for node, table in NODES.items()}


def settled(command: Floats, error: Floats, period: float) -> float:
    """Longest time [s] from the end of a stroke until the ``error`` [V] stays small; inf: it does not."""
    moves = np.abs(np.diff(command, prepend=command[0])) > 0.0
    samples = np.arange(len(command))
    moved = np.maximum.accumulate(np.where(moves, samples, -1))  # sample of the last move
    outside = ~moves & (moved >= 0) & (np.abs(error) > BAND * STROKE)
    never = np.any(outside & np.append(moves[1:], True))
    return np.inf if never else period * float(np.max((samples - moved)[outside], initial=0))


def draw(path: str, traces: Mapping[str, Trace], errors: Mapping[str, float], where: str) -> None:
    """Command and spool above, error below, of DRAWN; ``errors``: rms [% of stroke] by law.

    Raises OSError if ``path`` cannot be written.
    """
    columns = {}
    for part, (begin, end) in MOTION.items():
        top, bottom = [], []
        for law, colour in DRAWN.items():
            if (trace := traces.get(law)) is None:
                continue
            shown = (trace.time >= begin) & (trace.time <= end)
            time, command, position = trace.time[shown], trace.command[shown], trace.position[shown]
            top.append(Line(f"{LAWS[law]}: {errors[law]:.2g} % rms error", time, position, colour))
            if law != "open_loop":  # whose error would hide the others
                bottom.append(Line(top[-1].label, time, 100.0 * (position - command) / STROKE, colour))
        top.append(Line("command", time, command, "black", style="--"))
        columns[part] = [Plot("spool position [V]", top), Plot("error [% of the stroke]", bottom)]
    title = f"A slow, sticky solenoid valve (9 Hz) follows fast commands, {where}"
    draw_columns([Path(path)], columns, "time [s]", title)


def line(law: str, trace: Trace) -> tuple[str, float]:
    """Line of the table for a run under ``law``, and its rms error [% of stroke]."""
    error, period = trace.position - trace.command, float(trace.time[1] - trace.time[0])
    reached = indices(error, trace.voltage, period)
    strokes = trace.time < STROKES
    settling = settled(trace.command[strokes], error[strokes], period)
    rest = f"{1e3 * settling:.0f} ms" if np.isfinite(settling) else "never"
    rms, most = 100.0 * reached.e_rms / STROKE, 100.0 * reached.e_M / STROKE
    voltage = float(np.max(np.abs(trace.voltage)))
    return f"{LAWS[law]:14}{rms:18.2f}{most:18.1f}{rest:>16}{voltage:14.1f}{reached.c_u:8.2f}", rms


def _demo(arguments: argparse.Namespace) -> None:
    traces, errors = {}, {}
    print(HEAD)
    for law in LAWS:
        values = values_of(law)
        command = build.commands(values["command_source"])
        moved = build.derivatives(command, number(values["controller"], "sample_period"))
        run = offline.simulate(
            values["controller"], values["valve_simulator"], command, compiled=False, derivatives=moved
        )
        traces[law] = Trace(run.time, run.command, run.measurement, run.voltage)
        text, errors[law] = line(law, traces[law])
        print(text, flush=True)
    draw(arguments.figure, traces, errors, "in simulation")
    wrote(arguments, arguments.figure)


def add_commands(commands: Any) -> None:
    """Add `demo`."""
    text = "one slow, sticky valve without control, under the best PID, and under dcarc"
    options = commands.add_parser("demo", help=text, description=f"Simulates {text}.")
    options.add_argument("--figure", metavar="FILE", default="demo.png", help="figure to write (demo.png)")
    options.set_defaults(run=_demo, json=None)
