# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the sub-command `study`: distributions of the indices over many valves, worst cases again."""

import argparse
import math
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from valve_control.cli.common import (
    Progress,
    check_outputs,
    check_processes,
    deliver,
    fix_option,
    say,
    tell_notes,
    write_json,
    wrote,
)
from valve_control.cli.simulate import settings_of, setup_options
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters.table import NODES
from valve_control.parameter import ParameterError, number, updated, word

if TYPE_CHECKING:
    from valve_control.control.simulation.robustness import Quantity, Study, StudyResult


def add_commands(commands: Any) -> None:
    """Add study to the command's sub-commands."""
    study = commands.add_parser(
        "study",
        parents=[setup_options()],
        help="run one controller on many valves: distributions, unstable share, worst valves",
        description="Run one controller on many valves drawn from a box of gains, speeds, friction, flow "
        "forces, drifts, noise, dead times and sample periods. Ctrl-C stops it; the same command resumes "
        "it.",
    )
    study.add_argument("--controller", choices=LAWS, help="control law (default: arc)")
    group = study.add_argument_group("study")
    group.add_argument("--valves", type=int, default=100_000, metavar="N", help="number of valves (100000)")
    fix_option(group)
    group.add_argument("--box", action="store_true", help="list the box and exit")
    group.add_argument("--study-seed", type=int, default=1, metavar="N", help="seed of the draw (1)")
    group.add_argument(
        "--limit",
        type=float,
        metavar="V",
        help="a loop with a larger error [V] in the last two seconds counts as unstable (0.15; if the "
        "command moves then, plus twice the tracking error of the valve without variations)",
    )
    group.add_argument("--replay", type=int, metavar="N", help="write only valve number N, to --output")
    group.add_argument(
        "--threads", type=int, default=os.cpu_count() or 1, metavar="N", help="number of threads (all cores)"
    )
    group.add_argument("--folder", help="folder of the results (out/study-…, one for each study)")
    output = study.add_argument_group("output")
    output.add_argument("--json", metavar="FILE", help="results as JSON; - for standard output alone")
    output.add_argument("--figure", metavar="FILE", help="distributions as PNG or SVG")
    output.add_argument("--output", metavar="FILE", help="with --replay: that valve as ROS 2 parameter file")
    study.set_defaults(run=_study)


def _study(arguments: argparse.Namespace) -> int:
    from valve_control.control.simulation import robustness
    from valve_control.design.tuning import verification

    _check(arguments)
    chosen = _chosen(arguments)
    if arguments.box:
        for q in chosen.box:
            say(arguments, f"{q.name:24}{q.low:10g} … {q.high:<10g}{q.unit}")
        say(arguments, f"{'sample_period':24}{', '.join(f'{p:g}' for p in chosen.periods):>24} s")
        box = [{"name": q.name, "low": q.low, "high": q.high, "unit": q.unit} for q in chosen.box]
        write_json(arguments, {"box": box, "sample_periods_s": chosen.periods})
        return 0
    if arguments.replay is not None:
        _write_valve(arguments, chosen)
        return 0
    folder = (
        Path("out", robustness.folder_name(chosen)) if arguments.folder is None else Path(arguments.folder)
    )
    progress, done = Progress(chosen.valves, "valves"), list[int]()  # valves

    def count(valves: int) -> None:
        if not done and valves > 0:
            print(f"{valves} of {chosen.valves} valves are in {folder} already", file=sys.stderr)
        done.append(valves)
        progress(valves)

    limit = robustness.fitting_limit(chosen) if arguments.limit is None else arguments.limit
    try:
        found = robustness.run(chosen, folder, count, arguments.threads)
    except KeyboardInterrupt:
        text = f"stopped; {max(done, default=0)} of {chosen.valves} valves are in {folder}"
        print(f"{text}; the same command goes on", file=sys.stderr)
        return 130
    result: dict[str, Any] = {
        "folder": str(folder),
        "controller": chosen.settings["controller"]["controller"],
        **robustness.summary(found, limit),
        "limits": verification.of_study(chosen, found, arguments.threads),
    }
    if arguments.json != "-":
        _print(result)
        print(f"all results are in {folder}")
    if arguments.figure is not None:
        _draw(Path(arguments.figure), found, result["controller"])
        wrote(arguments, arguments.figure)
    write_json(arguments, result)
    return 0


def _check(arguments: argparse.Namespace) -> None:
    check_outputs(arguments, [arguments.output], [arguments.figure])
    check_processes("threads", arguments.threads)
    if arguments.valves < 1:
        raise ParameterError(f"--valves is {arguments.valves}; it must be at least 1")
    if arguments.limit is not None and not 0.0 < arguments.limit < math.inf:
        raise ParameterError(f"--limit is {arguments.limit:g} V; it must be above 0 V, and finite")
    if (arguments.output is None) != (arguments.replay is None):
        raise ParameterError("--replay and --output write the parameters of one valve; give both")
    if arguments.replay is not None and arguments.figure is not None:
        raise ParameterError("--figure is of the whole study; leave it out, or --replay")
    if arguments.seed is not None:
        raise ParameterError("--seed says nothing here: each valve has a seed of its own; see --study-seed")


def box_of(arguments: argparse.Namespace) -> list["Quantity"]:
    """The quantities that vary: those of the study that --fix does not name. Raises ParameterError."""
    from valve_control.control.parameters import files
    from valve_control.design.tuning import box

    task = "the study" if arguments.task == "study" else arguments.task
    chosen = {files.parse_setting(text)[0] for text in arguments.set}
    varied = box.quantities(arguments.fix, chosen, task)
    for path in arguments.params_file:
        overridden = [q.name for q in varied if q.name in files.load(path)["valve_simulator"]]
        if overridden and getattr(arguments, "bag", None) is None:  # a recording tells them
            names = ", ".join(overridden)
            tell_notes([f"{task} varies {names}, whatever {path} says; --fix NAME keeps one"])
    return varied


def _chosen(arguments: argparse.Namespace) -> "Study":
    """Study that the options ask for. Raises ParameterError."""
    from valve_control.control.commands import arrays
    from valve_control.control.parameters import files
    from valve_control.control.simulation import robustness

    settings = settings_of(arguments)
    names = {files.parse_setting(text)[0] for text in arguments.set}
    if "seed" in names:
        raise ParameterError("--set seed says nothing here: each valve has its own; see --study-seed")
    period = number(settings["controller"], "sample_period")
    own = arguments.sample_period is not None or "sample_period" in names
    source = settings["command_source"]
    if source["scenario"] == "array":
        if not own:
            raise ParameterError("a command array has one number per sample period; give --sample-period too")
        if arguments.duration is None:  # the whole array
            length = len(arrays.read(word(source, "command_file")))
            settings["command_source"] = updated(
                NODES["command_source"], source, {"duration": length * period}
            )
    chosen = robustness.Study(
        settings,
        arguments.valves,
        arguments.study_seed,
        box_of(arguments),
        (period,) if own else robustness.PERIODS,
    )
    robustness.check_drift(chosen)
    return chosen


def _print(result: dict[str, Any]) -> None:
    from valve_control.design.tuning import limits

    percents = list(next(iter(result["percentiles"].values()), {}))
    print(f"{'percentile':16}" + "".join(f"{p:>9}" for p in percents))
    for name, row in result["percentiles"].items():
        label = name if name in ("c_u", "saturated") else f"{name} [V]"
        print(f"{label:16}" + "".join(f"{row[p]:9.4f}" for p in percents))
    # What has no integral action is off target with any disturbance, and need not be unstable.
    sign = "no sign of instability" if not LAWS[str(result["controller"])].feedback else "unstable"
    shares = [f"{p} s: {100.0 * s:.3f} %" for p, s in result["unstable_by_period"].items()]
    print(
        f"e_F above {result['limit']:.4g} V ({sign}): {100.0 * result['unstable']:.3f} % of "
        f"{result['valves']} valves ({', '.join(shares)})"
    )
    print(f"worst by e_rms (--replay N): {', '.join(map(str, result['worst']['e_rms']))}")
    if result["limits"]:
        print("\n".join(limits.as_text(result["limits"], "valves")))


def _draw(path: Path, found: "StudyResult", controller: str) -> None:
    import numpy as np

    from valve_control.control.analysis.figures import COLOURS, Line, Plot, draw_columns

    plots = []
    for name in ("e_rms", "e_M", "e_F"):
        lines = []
        for i, period in enumerate(np.unique(found.period)):
            values = np.sort(getattr(found.results, name)[(found.period == period) & found.results.finite])
            share = 100.0 * (np.arange(len(values)) + 1.0) / max(1, len(values))
            lines.append(Line(f"{1e3 * period:g} ms", values, share, COLOURS[i % len(COLOURS)]))
        plots.append(Plot(f"{name}: valves [%]", lines))
    title = f"{controller}: {len(found.period)} valves, by sample period"
    draw_columns([path], {"": plots}, "at most [V]", title, logarithmic_x=True)


def _write_valve(arguments: argparse.Namespace, chosen: "Study") -> None:
    """Write valve number --replay, with controller and command, for `simulate` and the nodes."""
    from valve_control.control.parameters import ros_file
    from valve_control.control.simulation import robustness

    if arguments.replay < 0:
        raise ParameterError(f"--replay is {arguments.replay}; valves are numbered from 0")
    settings = robustness.settings_of_number(chosen, arguments.replay)
    comment = f"valve {arguments.replay} of a study with seed {chosen.seed}"
    deliver(arguments, arguments.output, ros_file.as_yaml(settings, [comment]))
    write_json(arguments, {"number": arguments.replay, **settings})
