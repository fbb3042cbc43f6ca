"""Defines the sub-commands `axis` and `axes`: one hydraulic axis above the valve, and the study of many."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from valve_control import outputs
from valve_control.cli.common import check_outputs, check_processes, say, tell_notes, write_json
from valve_control.parameter import ParameterError, Values, lookup, updated
from valve_control.parameters.table import NODES

if TYPE_CHECKING:
    from valve_control.axis.run import Run, Setup
    from valve_control.axis.study import Result

CONTROLLERS = lookup(NODES["controller"], "controller").choices
_WAYS = {"lines": "by its own method", "exact_in_time": "by our steps"}


def add_commands(commands: Any) -> None:
    """Add axis and axes to the command's sub-commands."""
    axis = commands.add_parser(
        "axis",
        help="a hydraulic axis: cylinder and load, fed by the valve under its controller",
        description="Run one motion of a hydraulic axis: an upper level commands the spool, the valve's "
        "controller moves it, its edges feed a cylinder. Parameters: valve-control parameters axis_.",
    )
    group = axis.add_argument_group("what is simulated")
    group.add_argument("--controller", choices=CONTROLLERS, help="law of the valve (default: arc)")
    group.add_argument(
        "--upper", metavar="LEVEL", help="what commands the spool: axis_pid or axis_arc (axis_pid)"
    )
    group.add_argument("--duration", type=float, metavar="S", help="length [s] (3.0)")
    group.add_argument("--seed", type=int, metavar="N", help="seed of the sensors' noise (1)")
    group.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="any parameter of axis, upper level, valve or its controller; again for more",
    )
    group.add_argument(
        "--params-file",
        action="append",
        default=[],
        metavar="FILE",
        help="ROS 2 parameter file; again for more, later ones win; --set wins over files",
    )
    output = axis.add_argument_group("what comes out")
    output.add_argument("--json", metavar="FILE", help="results as JSON; - for standard output alone")
    output.add_argument("--csv", metavar="FILE", help="signals as CSV")
    output.add_argument("--figure", metavar="FILE", help="motion, error, spool and pressures as PNG or SVG")
    group.add_argument(
        "--delta",
        action="store_true",
        help="instead: the case of Delta Computer Systems' forum, under five valves (docs/axis.md)",
    )
    axis.set_defaults(run=_axis)
    axes = commands.add_parser(
        "axes",
        help="what a fast valve buys: random axes under five valves (make axis)",
        description="Random axes under five valves: as delivered, under three controllers, and an ideal "
        "servo valve of 100 Hz; each axis with half of its largest stable gain. docs/howto/axes.md.",
    )
    axes.add_argument("--axes", type=int, default=200, metavar="N", help="how many random axes (200)")
    axes.add_argument(
        "--upper", choices=("axis_pid", "axis_arc"), default="axis_pid", help="upper level (axis_pid)"
    )
    axes.add_argument("--threads", type=int, metavar="N", help="threads (all cores)")
    axes.add_argument(
        "--references", metavar="FOLDER", help="with Hopsan's Position Servo.hvd, to be compared"
    )
    axes.add_argument("--json", metavar="FILE", help="results as JSON; - for standard output alone")
    axes.add_argument("--figure", metavar="FILE", help="bandwidths and errors of all axes as PNG or SVG")
    axes.set_defaults(run=_axes)


def _settings(arguments: argparse.Namespace) -> dict[str, Values]:
    from valve_control.axis import run
    from valve_control.parameters import files
    from valve_control.parameters.axis import AXIS_NODES

    direct: dict[str, dict[str, Any]] = {
        "controller": {"controller": arguments.controller},
        "axis_controller": {"duration": arguments.duration, "upper_level": arguments.upper},
        "axis_simulator": {"seed": arguments.seed},
    }
    notes: list[str] = []
    changes = files.given(arguments.params_file, direct, arguments.set, notes, AXIS_NODES)
    tell_notes(notes)
    begun = run.default_settings()
    return {node: updated(table, begun[node], changes[node]) for node, table in AXIS_NODES.items()}


def _axis(arguments: argparse.Namespace) -> None:
    from valve_control.axis import run
    from valve_control.compiling import explained

    check_outputs(arguments, [arguments.csv], [arguments.figure])
    if arguments.delta:
        _delta(arguments)
        return
    setup = run.setup(_settings(arguments))
    with explained(f"the law '{setup.law}'"):
        found = run.simulate(setup)
    i = found.indices
    if arguments.json != "-":
        print("                    e_max [mm]  e_end [mm]  e_rms [mm]  u_rms [V]      c_u  energy [kJ]")
        print(
            f"{setup.law:<18}{1e3 * i.e_max:>12.4f}{1e3 * i.e_end:>12.4f}{1e3 * i.e_rms:>12.4f}"
            f"{i.u_rms:>11.3f}{i.chatter:>9.4f}{1e-3 * i.energy:>13.3f}"
        )
        print("; ".join(_words(setup, found)))
    if arguments.csv is not None:
        columns = {"time": found.time, **found.signals}
        outputs.write(arguments.csv, outputs.csv_text(columns, "%.10g"))
        say(arguments, f"wrote {arguments.csv}")
    if arguments.figure is not None:
        _draw(Path(arguments.figure), setup, found)
        say(arguments, f"wrote {arguments.figure}")
    write_json(
        arguments, {"controller": setup.law, "upper_level": setup.level, **i._asdict(), **_extremes(found)}
    )


def _delta(arguments: argparse.Namespace) -> None:
    from tqdm import tqdm

    from valve_control.axis import delta, study

    names = ("controller", "upper", "duration", "seed", "csv", "figure")
    given = [f"--{name}" for name in names if getattr(arguments, name) is not None]
    given += ["--set"] * bool(arguments.set) + ["--params-file"] * bool(arguments.params_file)
    if given:
        raise ParameterError(f"--delta is a fixed case; {', '.join(given)} cannot be given with it")
    alone = delta.published(delta.Case(delta.NONE))
    with tqdm(total=len(study.VALVES) * len(delta.POLES), unit="pole") as bar:
        found = delta.study_valves(done=lambda: bar.update())
    if arguments.json != "-":
        print("largest error [mm] of a move of 500 mm: K, ζ, ω exact, 10 % low, worst corner of ±10 %")
        print("                      poles [rad/s]  lead [ms]     exact   all low     worst")
        for name, label, r in [
            (delta.NONE, "published", alone),
            *((name, "published", results[0]) for name, results in found.items()),
            *((name, "own", results[1]) for name, results in found.items()),
        ]:
            print(
                f"{name:<11}{label:<11}{r.pole:>13.1f}{1e3 * r.lead:>11.0f}"
                f"{_mm(r.nominal)}{_mm(r.low)}{_mm(r.worst)}"
            )
    write_json(
        arguments,
        {
            "published": alone._asdict(),
            "valves": {
                name: {"published": first._asdict(), "own": second._asdict()}
                for name, (first, second) in found.items()
            },
        },
    )


def _mm(error: float) -> str:
    return f"{1e3 * error:>10.4f}" if error < 0.5 else f"{'unstable':>10}"


def _axes(arguments: argparse.Namespace) -> None:
    import numpy as np
    from tqdm import tqdm

    from valve_control.axis import hopsan, study

    check_outputs(arguments, (), [arguments.figure])
    if not 1 <= arguments.axes <= 100_000:
        raise ParameterError(f"--axes is {arguments.axes}; it must lie between 1 and 100000")
    if arguments.threads is not None:
        check_processes("threads", arguments.threads)
    against = {} if arguments.references is None else hopsan.compare(Path(arguments.references))
    with tqdm(total=arguments.axes * len(study.VALVES), unit="axis") as bar:
        found = study.study(arguments.axes, arguments.threads, bar.update, arguments.upper)

    def middle(name: str, pick: Callable[["Result"], float]) -> float:
        return float(np.median([pick(result) for result in found[name]]))

    columns: dict[str, Callable[[Result], float]] = {
        "gain": lambda r: r.gain,
        "bandwidth_hz": lambda r: r.bandwidth,
        "e_rms_m": lambda r: r.motion.e_rms,
        "e_max_m": lambda r: r.motion.e_max,
        "energy_j": lambda r: r.motion.energy,
        "chatter": lambda r: r.motion.chatter,
        "reach_hz": lambda r: r.reach,
    }
    medians = {
        column: {name: middle(name, pick) for name in study.VALVES} for column, pick in columns.items()
    }
    if arguments.json != "-":
        print(f"medians of {arguments.axes} axes under {arguments.upper}; reach: of any law")
        print(
            "           gain [1/s]  bandwidth [Hz]  e_rms [mm]  e_max [mm]  energy [kJ]      c_u  reach [Hz]"
        )
        for name in study.VALVES:
            m = {column: values[name] for column, values in medians.items()}
            print(
                f"{name:<11}{m['gain']:>10.1f}{m['bandwidth_hz']:>16.2f}{1e3 * m['e_rms_m']:>12.3f}"
                f"{1e3 * m['e_max_m']:>12.3f}{1e-3 * m['energy_j']:>13.3f}{m['chatter']:>9.4f}"
                f"{m['reach_hz']:>12.2f}"
            )
        for way, by_name in against.items():
            worst = ", ".join(f"{name} {value:.2g}" for name, value in by_name.items())
            print(f"Hopsan's Position Servo {_WAYS[way]}, largest deviation over the range: {worst}")
    if arguments.figure is not None:
        _draw_axes(Path(arguments.figure), found)
        say(arguments, f"wrote {arguments.figure}")
    told: dict[str, Any] = {**against["lines"], "exact_in_time": against["exact_in_time"]} if against else {}
    write_json(
        arguments, {"hopsan": told or None, **medians, "axes": arguments.axes, "upper_level": arguments.upper}
    )


def _draw_axes(path: Path, found: "Mapping[str, Sequence[Result]]") -> None:
    import numpy as np

    from valve_control.analysis.figures import Line, Plot, draw_plots

    share = 100.0 * (np.arange(len(next(iter(found.values())))) + 1.0) / len(next(iter(found.values())))
    picks: dict[str, Callable[[Result], float]] = {
        "bandwidth at most [Hz]": lambda r: r.bandwidth,
        "rms error at most [mm]": lambda r: 1e3 * r.motion.e_rms,
    }
    plots = [
        Plot(
            title,
            [Line(name, share, np.sort([pick(r) for r in results])) for name, results in found.items()],
            True,
        )
        for title, pick in picks.items()
    ]
    draw_plots([path], plots, "axes [%]", "what a fast valve buys")


def _extremes(found: "Run") -> dict[str, float]:
    s = found.signals
    return {
        "speed_max": float(abs(s["velocity"]).max()),
        "pressure_min": float(min(s["pressure_a"].min(), s["pressure_b"].min())),
        "pressure_max": float(max(s["pressure_a"].max(), s["pressure_b"].max())),
        "pressure_supply_min": float(s["pressure_supply"].min()),
    }


def _words(setup: "Setup", found: "Run") -> list[str]:
    e = _extremes(found)
    words = [
        f"fastest {e['speed_max']:.3g} m/s",
        f"pressures {1e-5 * e['pressure_min']:.4g} to {1e-5 * e['pressure_max']:.4g} bar",
    ]
    if e["pressure_min"] <= setup.machine.axis.vapour:
        words.append("the oil cavitates")
    stroke = setup.machine.axis.cylinder.stroke
    if found.signals["position"].min() <= 0.0 or found.signals["position"].max() >= stroke:
        words.append("the piston meets a stop")
    return words


def _draw(path: Path, setup: "Setup", found: "Run") -> None:
    from valve_control.analysis.figures import Line, Plot, draw_plots

    s, t = found.signals, found.time
    draw_plots(
        [path],
        [
            Plot("position [m]", [Line("goal", t, s["goal"], dashed=True), Line("axis", t, s["position"])]),
            Plot("error [mm]", [Line("goal less position", t, 1e3 * (s["goal"] - s["position"]))]),
            Plot(
                "spool [V]",
                [Line("command", t, s["spool_command"], dashed=True), Line("spool", t, s["spool"])],
            ),
            Plot(
                "pressure [bar]",
                [
                    Line("a", t, 1e-5 * s["pressure_a"]),
                    Line("b", t, 1e-5 * s["pressure_b"]),
                    Line("supply", t, 1e-5 * s["pressure_supply"]),
                ],
            ),
        ],
        "time [s]",
        f"axis under {setup.law}",
    )
