# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the sub-command `axis`: one hydraulic axis above the valve."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from valve_control.cli import common
from valve_control.control.analysis.figures import COLOURS, Line, Plot, draw_columns
from valve_control.control.compiling import explained
from valve_control.control.laws.registry import LAWS
from valve_control.parameter import updated

if TYPE_CHECKING:
    from valve_control.axis.run import Run, Setup


def add_commands(commands: Any) -> None:
    """Add axis to the command's sub-commands."""
    axis = commands.add_parser(
        "axis",
        help="simulate a hydraulic axis: upper level, controlled valve, cylinder and load",
        description="Run one motion of a hydraulic axis: an upper level commands the spool, the valve's "
        "controller moves the spool, and the edges of the spool feed a cylinder. 'valve-control "
        "parameters' lists the parameters of axis_simulator and axis_controller.",
    )
    group = axis.add_argument_group("simulation")
    common.law_option(group, "law of the valve (default: that of the files, else arc)")
    text = "upper level: axis_pid or axis_arc (axis_pid)"
    group.add_argument("--upper", dest="upper_level", metavar="LEVEL", help=text)
    group.add_argument("--duration", type=float, metavar="S", help="length [s] (3.0)")
    group.add_argument("--seed", type=int, metavar="N", help="seed of the sensors' noise (1)")
    common.parameter_options(group, "any parameter of axis, upper level, valve or its controller")
    common.output_group(axis, csv="signals as CSV", figure="motion, error, spool and pressures as PNG or SVG")
    axis.set_defaults(run=_axis)


def _axis(arguments: argparse.Namespace) -> None:
    from valve_control.axis import run
    from valve_control.axis.axis_parameters import AXIS_NODES

    usual, changes = run.default_settings(), common.changes_of(arguments, AXIS_NODES)
    setup = run.setup({n: updated(table, usual[n], changes[n]) for n, table in AXIS_NODES.items()})
    with explained(LAWS[setup.law].title):
        found = run.simulate(setup)
    i = found.indices
    if arguments.json != "-":
        print("                    e_max [mm]  e_end [mm]  e_rms [mm]  u_rms [V]      c_u  energy [kJ]")
        print(
            f"{setup.law:<18}{1e3 * i.e_max:>12.4f}{1e3 * i.e_end:>12.4f}{1e3 * i.e_rms:>12.4f}"
            f"{i.u_rms:>11.3f}{i.chatter:>9.4f}{1e-3 * i.energy:>13.3f}"
        )
        print(_notes(setup, found))
    if arguments.csv is not None:
        columns = {"time": found.time, **found.signals}
        common.deliver(arguments, arguments.csv, common.csv_text(columns, "%.10g"))
    if arguments.figure is not None:
        title = f"axis under {setup.level}, valve under {setup.law} ({common.names_of_files(arguments)})"
        _draw(Path(arguments.figure), found, title)
        common.wrote(arguments, arguments.figure)
    levels = {"controller": setup.law, "upper_level": setup.level}
    common.write_json(arguments, {**levels, **i._asdict(), **_extremes(found)})


def _extremes(found: "Run") -> dict[str, float]:
    s = found.signals
    return {
        "speed_max": float(abs(s["velocity"]).max()),
        "pressure_min": float(min(s["pressure_a"].min(), s["pressure_b"].min())),
        "pressure_max": float(max(s["pressure_a"].max(), s["pressure_b"].max())),
        "pressure_supply_min": float(s["pressure_supply"].min()),
    }


def _notes(setup: "Setup", found: "Run") -> str:
    e, position, machine = _extremes(found), found.signals["position"], setup.machine.axis
    text = (
        f"fastest {e['speed_max']:.3g} m/s; "
        f"pressures {1e-5 * e['pressure_min']:.4g} to {1e-5 * e['pressure_max']:.4g} bar"
    )
    text += "; the oil cavitates" * (e["pressure_min"] <= machine.vapour)
    meets = position.min() <= 0.0 or position.max() >= machine.cylinder.stroke
    return f"{text}; the piston meets a stop" if meets else text


def _draw(path: Path, found: "Run", title: str) -> None:
    s, t, lag = found.signals, found.time, 1e3 * (found.signals["goal"] - found.signals["position"])
    plots = [
        Plot("position [m]", [Line("axis", t, s["position"]), Line("goal", t, s["goal"], "black", "--")]),
        Plot("goal - position [mm]", [Line("goal - position", t, lag, COLOURS[1])]),
        Plot(
            "spool [V]",
            [Line("spool", t, s["spool"]), Line("command", t, s["spool_command"], "black", "--")],
        ),
        Plot(
            "pressure [bar]",
            [
                Line("a", t, 1e-5 * s["pressure_a"]),
                Line("b", t, 1e-5 * s["pressure_b"]),
                Line("supply", t, 1e-5 * s["pressure_supply"]),
            ],
        ),
    ]
    draw_columns([path], {"": plots}, "time [s]", title)
