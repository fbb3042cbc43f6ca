# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the sub-commands `simulate`, `compare` and `parameters`."""

import argparse
import io
import os
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from valve_control.arrays import Floats
from valve_control.axis.tables import ROS_NODES
from valve_control.cli import common
from valve_control.control import closed_loop
from valve_control.control.analysis import limit_cycle
from valve_control.control.analysis.figures import Trace, draw_traces
from valve_control.control.analysis.indices import HEADER, index_row
from valve_control.control.analysis.steps import in_words
from valve_control.control.commands import arrays
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters import build, files
from valve_control.control.parameters.table import NODES
from valve_control.control.simulation import delivery, offline
from valve_control.parameter import ParameterError, Values, defaults, lookup, number, updated

VALVES = lookup(NODES["valve_simulator"], "valve").choices
ARRAYS = {".csv", ".txt", ".tsv", ".dat"}  # suffixes of a log too, but only with --map
PARAMETERS = "List the parameters of all nodes, or those with a word such as 'arc.' in their names."
FIGURE = "command, position, error and voltage as PNG or SVG"
PERIOD = lookup(NODES["command_source"], "sample_period").default
SCENARIOS = lookup(NODES["command_source"], "scenario").choices


def valve_options() -> common.Parser:
    """Parser with the options that say which valve and gains, for what has no motion and no noise."""
    options = common.Parser(add_help=False)
    options.set_defaults(scenario=None, command=None, duration=None, seed=None)
    _valve_options(options.add_argument_group("valve and gains"), "controller or valve")
    return options


def setup_options(several: bool = False, log: str = "") -> common.Parser:
    """Parser with the options that say what is simulated; ``several`` commands; ``log``: what else is one."""
    options = common.Parser(add_help=False)
    group = options.add_argument_group("simulation")
    _valve_options(group, "controller, valve or command")
    group.add_argument("--scenario", choices=SCENARIOS[:-1], help="command shape (default: point_to_point)")
    group.add_argument(
        "--command",
        metavar="FILE",
        action="append" if several else "store",
        help="motion: CSV or NPY with one number [V] per sample period"
        + ("; can be repeated" if several else log),
    )
    group.add_argument("--duration", type=float, metavar="S", help="length [s] (6.0, or that of --command)")
    common.numbers(group, common.SEED if several else ("seed", int, None, "N", "seed of the LVDT noise (1)"))
    return options


def _valve_options(group: Any, nodes: str) -> None:
    text = "valve model (default: that of the files, else fourth_order)"
    group.add_argument("--valve", choices=VALVES, help=text)
    group.add_argument("--sample-period", type=float, metavar="S", help="sample period [s] (0.001)")
    common.parameter_options(group, f"any parameter of {nodes}; 'valve-control parameters' lists them")


def delivery_options(points: bool = True) -> common.Parser:
    """Parser with the options that say how the commands come; ``points``: also as a trajectory."""
    options = common.Parser(add_help=False)
    group = options.add_argument_group("delivery of the commands")
    common.numbers(
        group,
        ("command-period", float, None, "S", "time [s] from one command to the next (one sample period)"),
        ("command-jitter", float, None, "S", "mean delay [s]; a command is late by up to twice this (0)"),
        ("command-drift", float, None, "PPM", "drift of the upper level's clock [ppm] (0)"),
    )
    if points:
        text = "the command comes with its rate and acceleration, as points of a trajectory"
        group.add_argument("--preview", action="store_true", help=text)
    return options


def add_commands(commands: Any) -> None:
    """Add simulate, compare and parameters to the command's sub-commands."""
    simulate = commands.add_parser(
        "simulate",
        parents=[setup_options(log="; or from a bag or log"), delivery_options()],
        help="run one controller on one valve with one command",
        description="Run one controller on one simulated valve; print errors [V], rms voltage [V], chatter.",
    )
    common.law_option(simulate)
    common.bag_options(simulate.add_argument_group("command from a bag, or with --map from a log"))
    common.output_group(simulate, figure=FIGURE, csv="traces as CSV", npz="traces as NPZ")
    simulate.set_defaults(run=_simulate)
    compare = commands.add_parser(
        "compare",
        parents=[setup_options(), delivery_options()],
        help="simulate all or some controllers",
        description="Run every controller, or some, on one valve and one command.",
    )
    compare.add_argument("--controller", type=common.laws, metavar="LAW,…", help="laws to run (all)")
    common.output_group(compare, figure=FIGURE)
    compare.set_defaults(run=_compare)
    text = "list parameters with unit, range and meaning"
    parameters = commands.add_parser("parameters", help=text, description=PARAMETERS)
    parameters.add_argument("match", nargs="?", default="", metavar="WORD", help="part of the names")
    parameters.set_defaults(run=_parameters, json=None)


def settings_of(
    arguments: argparse.Namespace, law: str = "", recorded: Mapping[str, Values] | None = None
) -> dict[str, Values]:
    """Checked values by node from the options and files, for a comparison those of ``law``.

    ``recorded``: values of a recording, which count below these. Raises ParameterError.
    """
    more: dict[str, Any] = {}
    if arguments.command is not None:
        common.refuse(arguments, ["scenario"], "--command")
        more = {"scenario": "array", "command_file": arguments.command}
    if getattr(arguments, "preview", None):
        more["message"] = "trajectory"
    changes = common.changes_of(arguments, more=more, law=law, recorded=recorded is not None)
    usual = {node: defaults(table) for node, table in NODES.items()} | dict(recorded or {})
    return {node: updated(table, usual[node], changes[node]) for node, table in NODES.items()}


def _recorded(arguments: argparse.Namespace) -> tuple[dict[str, Values], Any]:
    """Values by node, and the command [V] of a bag or log. Raises ParameterError and BagError."""
    from valve_control.recordings import recorded_command
    from valve_control.recordings.recording import align

    common.refuse(arguments, ["duration"], "simulate with a bag")
    nodes = {node: NODES[node] for node in ("controller", "valve_simulator")}
    files.refuse_others(arguments.set, nodes, "simulate has the recorded command")
    loaded = common.load(arguments, arguments.command)
    valve = common.valve_of(arguments, arguments.command, loaded.valves)
    signals, notes = align(valve), [*loaded.problems, *valve.problems]
    settings = settings_of(arguments, recorded=recorded_command.parameters_of(valve, signals, notes))
    common.tell_notes(notes)
    return settings, recorded_command.command_of(valve, signals, settings["controller"])


def motion(arguments: argparse.Namespace, file: str, period: float) -> Floats:
    """The numbers [V] of ``file``; a note tells an unusual ``period`` [s] that a parameter file has."""
    numbers = arrays.read(file)
    if period != PERIOD and arguments.sample_period is None and "sample_period" not in str(arguments.set):
        named = [
            f for f in arguments.params_file if any("sample_period" in v for v in files.load(f).values())
        ]
        text = f"{len(numbers)} numbers at a sample period of {1e3 * period:.4g} ms ({Path(named[-1]).name})"
        common.tell_notes([f"{text}: {len(numbers) * period:.4g} s"])
    return numbers


def _command(arguments: argparse.Namespace, settings: Mapping[str, Values]) -> Any:
    values, limit = settings["command_source"], number(settings["controller"], "command_limit")
    if values["scenario"] == "array" and arguments.duration is None:
        command = motion(arguments, str(values["command_file"]), number(values, "sample_period"))
    else:
        build.check_memory(number(values, "duration") / number(values, "sample_period"))
        command = build.commands(values)
    if (most := np.max(np.abs(command))) > limit:
        common.tell_notes([f"the command reaches {most:g} V; command_limit cuts it at {limit:g} V"])
    if values["scenario"] == "array" and np.ptp(command) == 0.0:
        step, count = number(values, "sample_period"), len(command)
        common.tell_notes([f"the command does not move in {count} samples of {step:g} s"])
    return command


def delivery_of(arguments: argparse.Namespace, values: Values) -> delivery.Delivery | None:
    """How the options and the controller's ``values`` let commands come; None: one a sample, in time.

    Raises ParameterError.
    """
    asked = arguments.command_period, arguments.command_jitter, arguments.command_drift
    if asked == (None, None, None):
        return None
    period, jitter, drift = asked
    seed = 1 if arguments.seed is None else arguments.seed
    period = number(values, "sample_period") if period is None else period
    result = delivery.Delivery(period, jitter or 0.0, seed, 1e-6 * (drift or 0.0))
    delivery.check(values, result)
    return result


def title_of(arguments: argparse.Namespace, law: str, settings: Mapping[str, Values]) -> str:
    """Title of a figure: law, files of its gains, valve and motion."""
    source, frequency = settings["command_source"], build.highest_frequency(settings["command_source"])
    motion = f"{source['scenario']} of {source['amplitude']:g} V"
    motion += f", {frequency:g} Hz" if frequency else ""
    if source["scenario"] == "array":
        motion = Path(str(source["command_file"])).stem
    valve = settings["valve_simulator"]["valve"]
    gains = "recorded parameters" if _is_recording(arguments) else "default parameters"
    return f"{law} ({common.names_of_files(arguments, gains)}) on the valve {valve}: {motion}"


def _figure(
    arguments: argparse.Namespace, runs: Sequence[offline.Run], settings: Mapping[str, Values]
) -> None:
    traces = {r.controller: Trace(r.time, r.command, r.measurement, r.voltage) for r in runs}
    law = runs[0].controller if len(runs) == 1 else f"{len(runs)} laws"
    arguments.draw = partial(draw_traces, traces=traces, title=title_of(arguments, law, settings))
    if arguments.figure is not None:
        arguments.draw([Path(arguments.figure)])
        common.wrote(arguments, arguments.figure)


def _run(arguments: argparse.Namespace, settings: Mapping[str, Values], command: Any) -> offline.Run:
    """Run with these ``settings`` under ``command`` [V]; a warning about it is printed."""
    source, derivatives = settings["command_source"], None
    delivered = delivery_of(arguments, settings["controller"])
    if source["message"] == "trajectory":
        if delivered is not None:
            raise ParameterError("points of a trajectory have their times; leave --command-period out")
        derivatives = build.derivatives(command, number(source, "sample_period"))
    with common.progress(len(command), "samples", len(command) > offline.PIECE) as bar:
        run = offline.finite_run(
            settings["controller"],
            settings["valve_simulator"],
            command,
            told=bar.update,
            delivered=delivered,
            derivatives=derivatives,
        )
    if run.warning:
        print(f"warning: {run.warning}", file=sys.stderr)
    return run


def _print(run: offline.Run, alone: bool = False) -> None:
    print(index_row(run.controller, run.indices))
    if alone:
        print(f"true position: e_M {run.true_error['e_M']:.4f} V, e_rms {run.true_error['e_rms']:.4f} V")
        if run.steps is not None:
            print(f"steps: {in_words(*run.steps)}")
    if text := limit_cycle.in_words(run.saturated, run.limit_cycle):
        print(f"{run.controller}: {text}")


def _is_recording(arguments: argparse.Namespace) -> bool:
    """Whether --command names a bag or log, and no array."""
    file = arguments.command
    if not file:
        return False
    if getattr(arguments, "map", None) or os.path.isdir(file):
        return True
    from valve_control.recordings.bags import bag, logs

    return Path(file).suffix.lower() in {*bag.KINDS, *bag.ZSTD, *logs.KINDS} - ARRAYS


def _simulate(arguments: argparse.Namespace) -> None:
    if _is_recording(arguments):
        settings, command = _recorded(arguments)
    else:
        common.refuse(arguments, common.WITH_BAG, "simulate without a bag")
        settings = settings_of(arguments)
        command = _command(arguments, settings)
    arguments.settings, run = settings, _run(arguments, settings, command)
    if arguments.json != "-":
        print(HEADER)
        _print(run, alone=True)
        if run.theta is not None:
            names = get_type_hints(LAWS[run.controller].module.State)["theta"]._fields
            estimates = zip(names, run.theta, strict=True)
            print("estimates at the end: " + ", ".join(f"{name} {v:.4g}" for name, v in estimates))
    _traces(arguments, run)
    _figure(arguments, [run], settings)
    common.write_json(arguments, offline.as_dict(run, settings))


def _traces(arguments: argparse.Namespace, run: offline.Run) -> None:
    columns = {name: getattr(run, name) for name in ("time", "command", *closed_loop.SIGNALS)}
    columns |= {f"{run.controller}.{n}" if n in columns else n: row for n, row in run.terms.items()}
    if arguments.csv is not None:
        common.deliver(arguments, arguments.csv, common.csv_text(columns, "%.10g"))
    if arguments.npz is not None:
        stream = io.BytesIO()
        np.savez_compressed(stream, allow_pickle=False, **columns)
        common.deliver(arguments, arguments.npz, stream.getvalue())


def _compare(arguments: argparse.Namespace) -> None:
    if any(text.partition("=")[0].strip() == "controller" for text in arguments.set):
        raise ParameterError("compare takes no --set controller; --controller LAW,… names the laws to run")
    laws, arguments.controller = arguments.controller or LAWS, None  # settings_of takes one law
    settings = settings_of(arguments)
    command, runs = _command(arguments, settings), []
    for law in laws:
        own = {**settings_of(arguments, law)["controller"], "controller": law}
        runs.append(_run(arguments, {**settings, "controller": own}, command))
    if arguments.json != "-":
        print(HEADER)
        for run in runs:
            _print(run)
    _figure(arguments, runs, settings)
    common.write_json(arguments, {"runs": [offline.as_dict(run, settings) for run in runs]})


def _parameters(arguments: argparse.Namespace) -> None:
    tables, word = ROS_NODES.items(), arguments.match
    rows = [f"{node}: {one.described}" for node, table in tables for one in table if word in one.name]
    if not rows:
        raise ParameterError(f"no parameter has '{word}' in its name")
    print("\n".join(rows))
