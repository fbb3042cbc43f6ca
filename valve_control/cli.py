"""The `valve-control` command."""

import argparse
import contextlib
import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from valve_control import __version__
from valve_control.parameters.table import (
    NODES,
    Parameter,
    ParameterError,
    Values,
    defaults,
    lookup,
    updated,
)

if TYPE_CHECKING:
    from valve_control.simulation.offline import Run

EXAMPLES = """examples:
  valve-control simulate --controller arc --figure arc.png
  valve-control simulate --controller oarc --scenario sine --set frequency=6.0 --set amplitude=1.0
  valve-control simulate --controller arc --params-file config/arc.yaml --json -
  valve-control compare --params-file config/d3fxe.yaml --figure compare.png
  valve-control parameters arc
"""
CONTROLLERS = lookup(NODES["controller"], "controller").choices
VALVES = lookup(NODES["valve_simulator"], "valve").choices
SCENARIOS = lookup(NODES["command_source"], "scenario").choices


class _Parser(argparse.ArgumentParser):
    """Prints one sentence, not the usage, when an argument is wrong."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def _setup_options() -> "_Parser":
    options = _Parser(add_help=False)
    group = options.add_argument_group("what is simulated")
    group.add_argument("--valve", choices=VALVES, help="linear valve model (default: fourth_order)")
    group.add_argument("--scenario", choices=SCENARIOS[:-1], help="command shape (default: point_to_point)")
    group.add_argument(
        "--command", metavar="FILE", help="command from a CSV or NPY array, one number per sample period"
    )
    group.add_argument("--sample-period", type=float, metavar="S", help="sample period [s] (0.001)")
    group.add_argument("--duration", type=float, metavar="S", help="length [s] (6.0, or the whole array)")
    group.add_argument("--seed", type=int, metavar="N", help="seed of the LVDT noise (1)")
    group.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="any parameter of controller, valve or command; again for more",
    )
    group.add_argument(
        "--params-file",
        action="append",
        default=[],
        metavar="FILE",
        help="ROS 2 parameter file; again for more, later ones win; --set wins over files",
    )
    output = options.add_argument_group("what comes out")
    output.add_argument("--json", metavar="FILE", help="results as JSON; - for standard output alone")
    output.add_argument("--figure", metavar="FILE", help="command, position, error and voltage as PNG")
    return options


def parser() -> argparse.ArgumentParser:
    """The command's argument parser."""
    top = _Parser(
        prog="valve-control",
        description="Local control of a proportional directional control valve: simulate and compare.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"valve-control {__version__}")
    commands = top.add_subparsers(dest="task", required=True, metavar="COMMAND")
    setup = _setup_options()
    simulate = commands.add_parser(
        "simulate",
        parents=[setup],
        help="one controller on one valve and one command",
        description="Run one controller on one simulated valve; print the indices I1-I5 of the paper.",
    )
    simulate.add_argument("--controller", choices=CONTROLLERS, help="control law (default: arc)")
    simulate.add_argument("--csv", metavar="FILE", help="traces as CSV")
    simulate.add_argument("--npz", metavar="FILE", help="traces as NPZ")
    commands.add_parser(
        "compare",
        parents=[setup],
        help="all controllers on one valve and one command, beside the paper's Table 1",
        description="Run every controller on one valve and one command, beside the paper's Table 1.",
    )
    parameters = commands.add_parser("parameters", help="list parameters with unit, range and meaning")
    parameters.add_argument("match", nargs="?", default="", help="only names that contain this")
    return top


def _settings(arguments: argparse.Namespace) -> dict[str, Values]:
    from valve_control.parameters import files

    changes: dict[str, dict[str, Any]] = {node: {} for node in NODES}
    for path in arguments.params_file:
        for node, values in files.load(path).items():
            changes[node].update(values)
    direct = {
        "controller": {"controller": getattr(arguments, "controller", None)},
        "valve_simulator": {"valve": arguments.valve, "seed": arguments.seed},
        "command_source": {"scenario": arguments.scenario, "duration": arguments.duration},
    }
    for node, options in direct.items():
        changes[node].update({k: v for k, v in options.items() if v is not None})
    if arguments.command is not None:
        changes["command_source"].update(scenario="array", command_file=arguments.command)
    if arguments.sample_period is not None:
        for node in direct:
            changes[node]["sample_period"] = arguments.sample_period
    for text in arguments.set:
        name, by_node = files.parse_setting(text)
        for node, value in by_node.items():
            changes[node][name] = value
    return {node: updated(table, defaults(table), changes[node]) for node, table in NODES.items()}


def _command(arguments: argparse.Namespace, values: Values) -> Any:
    from valve_control.simulation import offline

    if values["scenario"] == "array" and arguments.duration is None:
        return offline.read_commands(str(values["command_file"]))
    return offline.commands(values)


def _result(run: "Run", settings: Mapping[str, Values]) -> dict[str, Any]:
    return {
        "controller": run.controller,
        "valve": settings["valve_simulator"]["valve"],
        "scenario": settings["command_source"]["scenario"],
        "sample_period": run.period,
        "duration": len(run.command) * run.period,
        "seed": settings["valve_simulator"]["seed"],
        "indices": run.indices._asdict(),
        "true_error": run.true_error,
        "theta": run.theta,
        "warning": run.warning or None,
    }


def _check_outputs(paths: Sequence[str | None]) -> None:
    """Refuse outputs that cannot be written before the work begins."""
    for path in paths:
        if path is None or path == "-":
            continue
        folder = Path(path).resolve().parent
        if not folder.is_dir():
            raise ParameterError(f"{path} cannot be written: there is no folder {folder}")
        if Path(path).is_dir():
            raise ParameterError(f"{path} cannot be written: it is a folder")


def _say(arguments: argparse.Namespace, text: str) -> None:
    print(text, file=sys.stderr if arguments.json == "-" else sys.stdout)


def _write_json(arguments: argparse.Namespace, result: Any) -> None:
    if arguments.json is None:
        return
    text = json.dumps(_finite(result), indent=2, ensure_ascii=False, allow_nan=False)
    if arguments.json == "-":
        print(text)
        return
    Path(arguments.json).write_text(text + "\n", encoding="utf-8")
    _say(arguments, f"wrote {arguments.json}")


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _figure(arguments: argparse.Namespace, runs: Sequence["Run"], title: str) -> None:
    if arguments.figure is None:
        return
    from valve_control.analysis.figures import Trace, draw_traces

    traces = {r.controller: Trace(r.time, r.command, r.measurement, r.voltage) for r in runs}
    draw_traces(Path(arguments.figure), {title: traces}, "valve_control, offline")
    _say(arguments, f"wrote {arguments.figure}")


HEADER = f"{'':14}{'e_M [V]':>10}{'e_F [V]':>10}{'e_rms [V]':>11}{'u_rms [V]':>11}{'c_u':>9}"


def index_row(label: str, values: Sequence[float]) -> str:
    """One line of the table of indices."""
    e_m, e_f, e_rms, u_rms, c_u = values
    return f"{label:14}{e_m:10.4f}{e_f:10.4f}{e_rms:11.4f}{u_rms:11.3f}{c_u:9.4f}"


def _simulate(arguments: argparse.Namespace) -> None:
    from valve_control.simulation import offline

    _check_outputs([arguments.json, arguments.figure, arguments.csv, arguments.npz])
    settings = _settings(arguments)
    command = _command(arguments, settings["command_source"])
    run = offline.simulate(settings["controller"], settings["valve_simulator"], command)
    if run.warning:
        print(f"warning: {run.warning}", file=sys.stderr)
    if arguments.json != "-":
        print(HEADER)
        print(index_row(run.controller, run.indices))
        print(f"true position: e_M {run.true_error['e_M']:.4f} V, e_rms {run.true_error['e_rms']:.4f} V")
        if run.theta is not None:
            print("estimates at the end: " + ", ".join(f"{v:.4g}" for v in run.theta))
    _traces(arguments, run)
    _figure(arguments, [run], str(settings["command_source"]["scenario"]))
    _write_json(arguments, _result(run, settings))


def _traces(arguments: argparse.Namespace, run: "Run") -> None:
    import numpy as np

    columns = {
        "time": run.time,
        "command": run.command,
        "position": run.position,
        "measurement": run.measurement,
        "voltage": run.voltage,
        **run.terms,
    }
    if arguments.csv is not None:
        np.savetxt(
            arguments.csv,
            np.column_stack(list(columns.values())),
            delimiter=",",
            header=",".join(columns),
            comments="",
            fmt="%.10g",
        )
        _say(arguments, f"wrote {arguments.csv}")
    if arguments.npz is not None:
        with open(arguments.npz, "wb") as stream:
            np.savez_compressed(stream, allow_pickle=False, **columns)
        _say(arguments, f"wrote {arguments.npz}")


def _compare(arguments: argparse.Namespace) -> None:
    from valve_control.analysis.indices import PAPER_TABLE_1
    from valve_control.simulation import offline

    _check_outputs([arguments.json, arguments.figure])
    settings = _settings(arguments)
    command = _command(arguments, settings["command_source"])
    runs = []
    for controller in CONTROLLERS:
        values = updated(NODES["controller"], settings["controller"], {"controller": controller})
        run = offline.simulate(values, settings["valve_simulator"], command)
        if run.warning:
            print(f"warning: {run.warning}", file=sys.stderr)
        runs.append(run)
    if arguments.json != "-":
        print(HEADER)
        for run in runs:
            print(index_row(run.controller, run.indices))
            if run.controller in PAPER_TABLE_1:
                print(index_row("  paper", PAPER_TABLE_1[run.controller]))
    _figure(arguments, runs, str(settings["command_source"]["scenario"]))
    paper = {name: values._asdict() for name, values in PAPER_TABLE_1.items()}
    _write_json(arguments, {"runs": [_result(run, settings) for run in runs], "paper": paper})


def range_text(parameter: Parameter) -> str:
    """Range or choices of a parameter in words."""
    if parameter.choices:
        return ", ".join(parameter.choices)
    if isinstance(parameter.default, (str, bool)) or parameter.type_name == "list of strings":
        return ""
    return f"{parameter.low:g} to {parameter.high:g}"


def _parameters(arguments: argparse.Namespace) -> None:
    for node, table in NODES.items():
        for parameter in table:
            if arguments.match in parameter.name:
                unit = f" {parameter.unit}" if parameter.unit not in ("", "-") else ""
                print(f"{node}: {parameter.name} = {parameter.default}{unit}  ({range_text(parameter)})")
                print(f"    {parameter.text}")


TASKS = {"simulate": _simulate, "compare": _compare, "parameters": _parameters}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status: 0, 2 for bad input, 1 for an output that failed."""
    arguments = parser().parse_args(argv)
    try:
        TASKS[arguments.task](arguments)
    except ParameterError as error:
        print(f"valve-control: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        with contextlib.suppress(OSError):
            sys.stdout.close()
        return 1
    except OSError as error:
        print(
            f"valve-control: {error.filename or 'output'} cannot be written: {error.strerror or error}",
            file=sys.stderr,
        )
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
