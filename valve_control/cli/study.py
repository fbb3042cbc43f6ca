# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the sub-command `study`: distributions of the indices over many valves, worst cases again."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from valve_control import interrupts
from valve_control.cli import common
from valve_control.cli.simulate import settings_of, setup_options, title_of
from valve_control.control.commands import arrays
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters import files, ros_file
from valve_control.control.parameters.table import NODES
from valve_control.parameter import ParameterError, number, updated, word

if TYPE_CHECKING:
    from valve_control.control.simulation.robustness import Quantity, Study

LIMIT = (
    "a loop with a larger error [V] in the last two seconds counts as unstable (0.15; if the command moves "
    "then, plus twice the tracking error of the valve without variations)"
)
FIX = (
    "--fix", "NAME", "quantity of the box that keeps its value: gain, speed, flow_force, disturbance.offset, "
    "friction.coulomb, friction.static_ratio, drift.gain, drift.stiffness, lvdt.noise or lvdt.delay",
)  # fmt: skip


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
    common.law_option(study)
    group = study.add_argument_group("study")
    common.repeated(group, *FIX)
    group.add_argument("--box", action="store_true", help="list the quantities and ranges of the box; exit")
    common.numbers(
        group,
        ("valves", int, 100_000, "N", "number of valves (%(default)s)"),
        ("study-seed", int, 1, "N", "seed of the draw (%(default)s)"),
        ("limit", common.within(1e-6, 1e6), None, "V", LIMIT),
        ("replay", int, None, "N", "write only valve number N, to --output"),
        common.THREADS,
    )
    group.add_argument("--folder", help="folder of the results (out/study-…, one for each study)")
    valve = "with --replay: that valve as ROS 2 parameter file"
    common.output_group(study, figure="distributions as PNG or SVG", output=valve)
    study.set_defaults(run=_study)


def _study(arguments: argparse.Namespace) -> int:
    from valve_control.control.simulation import robustness

    if (arguments.output is None) != (arguments.replay is None):
        raise ParameterError("--replay and --output write the parameters of one valve; give both")
    if arguments.replay is not None:
        common.refuse(arguments, ["figure"], "study --replay")
    chosen = _chosen(arguments)
    if arguments.box:
        for q in chosen.box:
            common.say(arguments, f"{q.name:24}{q.low:10g} … {q.high:<10g}{q.unit}")
        common.say(arguments, f"{'sample_period':24}{', '.join(f'{p:g}' for p in chosen.periods):>24} s")
        box = [{"name": q.name, "low": q.low, "high": q.high, "unit": q.unit} for q in chosen.box]
        common.write_json(arguments, {"box": box, "sample_periods_s": chosen.periods})
        return 0
    if arguments.replay is not None:
        settings = robustness.settings_of_number(chosen, arguments.replay)
        comment = f"valve {arguments.replay} of a study with seed {chosen.seed}"
        common.deliver(arguments, arguments.output, ros_file.as_yaml(settings, [comment]))
        common.write_json(arguments, {"number": arguments.replay, **settings})
        return 0
    folder = Path(arguments.folder or Path("out", robustness.folder_name(chosen)))
    limit = robustness.fitting_limit(chosen) if arguments.limit is None else arguments.limit
    stored: list[int] = []  # valves from before
    with common.progress(chosen.valves, "valves") as bar:

        def count(valves: int) -> None:
            if not stored:
                bar.initial = bar.n = valves
                if valves > 0:
                    bar.write(f"{valves} of {chosen.valves} valves are in {folder} already", sys.stderr)
            stored.append(valves)
            bar.update(valves - bar.n)

        try:
            found = robustness.run(chosen, folder, count, arguments.threads)
        except KeyboardInterrupt:
            text = f"stopped; {bar.n} of {chosen.valves} valves are in {folder}; the same command goes on"
            bar.write(text, sys.stderr)
            return interrupts.STATUS
    result: dict[str, Any] = {
        "folder": str(folder),
        "controller": chosen.settings["controller"]["controller"],
        **robustness.summary(found, limit),
    }
    if arguments.json != "-":
        _print(result)
        print(f"all results are in {folder}")
    if arguments.figure is not None:
        title = title_of(arguments, result["controller"], chosen.settings)
        title += f", {len(found.period)} valves around it"
        robustness.draw_errors(Path(arguments.figure), found, title)
        common.wrote(arguments, arguments.figure)
    common.write_json(arguments, result)
    return 0


def box_of(arguments: argparse.Namespace) -> list["Quantity"]:
    """The quantities that vary: those of the study that --fix does not name. Raises ParameterError."""
    from valve_control.design.tuning import box

    task = "the study" if arguments.task == "study" else arguments.task
    chosen = {files.parse_setting(text)[0] for text in arguments.set}
    varied = box.quantities(arguments.fix, chosen, task)
    for path in arguments.params_file:
        overridden = [q.name for q in varied if q.name in files.load(path)["valve_simulator"]]
        if overridden:
            names = ", ".join(overridden)
            common.tell_notes([f'{task} varies {names}, whatever {path} says; --fix="NAME" keeps one'])
    return varied


def _chosen(arguments: argparse.Namespace) -> "Study":
    """Study that the options ask for. Raises ParameterError."""
    from valve_control.control.simulation import robustness

    settings = settings_of(arguments)
    names = {files.parse_setting(text)[0] for text in arguments.set}
    if arguments.seed is not None or "seed" in names:
        raise ParameterError("seed says nothing here: each valve has its own; see --study-seed")
    period = number(settings["controller"], "sample_period")
    own = arguments.sample_period is not None or "sample_period" in names
    source = settings["command_source"]
    if source["scenario"] == "array":
        if not own:
            raise ParameterError("a command array has one number per sample period; give --sample-period too")
        if arguments.duration is None:  # the whole array
            length = period * len(arrays.read(word(source, "command_file")))
            settings["command_source"] = updated(NODES["command_source"], source, {"duration": length})
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
