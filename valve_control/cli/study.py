# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the sub-command `study`: distributions of the indices over many valves, worst cases again."""

import argparse
import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from valve_control.cli.common import (
    Progress,
    check_outputs,
    check_processes,
    cluster_option,
    deliver,
    fix_option,
    say,
    workers,
    write_json,
    wrote,
)
from valve_control.cli.simulate import settings_of, setup_options
from valve_control.control.analysis.tables import HEADER, index_row
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters.table import NODES
from valve_control.parameter import ParameterError, number, updated, word

if TYPE_CHECKING:
    from valve_control.control.simulation.robustness import Quantity, Study, StudyResult

LOOKED_AT = 64  # valves of a study, whose limits are looked at


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
    group.add_argument("--replay", type=int, metavar="N", help="run only valve number N again")
    group.add_argument(
        "--threads", type=int, default=os.cpu_count() or 1, metavar="N", help="number of threads (all cores)"
    )
    cluster_option(group)
    group.add_argument("--folder", help="folder of the results (out/study-…, one for each study)")
    output = study.add_argument_group("output")
    output.add_argument("--json", metavar="FILE", help="results as JSON; - for standard output alone")
    output.add_argument("--figure", metavar="FILE", help="distributions as PNG or SVG; with --replay the run")
    output.add_argument("--output", metavar="FILE", help="with --replay: that valve as ROS 2 parameter file")
    study.set_defaults(run=_study)


def _study(arguments: argparse.Namespace) -> int:
    from valve_control.control.simulation import robustness

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
        _replay(arguments, chosen)
        return 0
    folder = (
        Path("out", robustness.folder_name(chosen)) if arguments.folder is None else Path(arguments.folder)
    )
    progress = Progress(chosen.valves, "valves")
    done = -1

    def told(valves: int) -> None:
        nonlocal done
        if done < 0 < valves:
            print(f"{valves} of {chosen.valves} valves are in {folder} already", file=sys.stderr)
        done = valves
        progress(valves)

    limit = robustness.fitting_limit(chosen) if arguments.limit is None else arguments.limit
    try:
        with workers(arguments) as cluster:
            found = robustness.run(chosen, folder, told, arguments.threads, cluster)
    except KeyboardInterrupt:
        print(
            f"stopped; {max(0, done)} of {chosen.valves} valves are in {folder}; the same command goes on",
            file=sys.stderr,
        )
        return 130
    result: dict[str, Any] = {
        "folder": str(folder),
        "controller": chosen.settings["controller"]["controller"],
        **robustness.summary(found, limit),
    }
    result["limits"] = _limits(chosen, found, arguments.threads)
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
    if arguments.output is not None and arguments.replay is None:
        raise ParameterError("--output writes the parameters of one valve; say which with --replay")
    if arguments.seed is not None:
        raise ParameterError("--seed says nothing here: each valve has a seed of its own; see --study-seed")


def box_of(arguments: argparse.Namespace) -> list["Quantity"]:
    """The quantities that vary: those of the study that --fix does not name. Raises ParameterError."""
    from valve_control.control.parameters import files
    from valve_control.control.simulation import robustness

    who = "the study" if arguments.task == "study" else arguments.task
    names = [q.name for q in robustness.BOX]
    for name in arguments.fix:
        if name not in names:
            raise ParameterError(f"--fix {name}: there is no such quantity; there are {', '.join(names)}")
    box = [q for q in robustness.BOX if q.name not in arguments.fix]
    given = {files.parse_setting(text)[0] for text in arguments.set}
    for q in box:
        if q.name in given:
            unit = "" if q.unit == "-" else f" {q.unit}"
            raise ParameterError(
                f"{who} varies {q.name} from {q.low:g} to {q.high:g}{unit}; leave --set {q.name} out, or "
                f"keep its value with --fix {q.name}"
            )
    for path in arguments.params_file:
        overridden = [q.name for q in box if q.name in files.load(path)["valve_simulator"]]
        if overridden and getattr(arguments, "bag", None) is None:  # a recording tells them
            print(
                f"note: {who} varies {', '.join(overridden)}, whatever {path} says; --fix NAME keeps one",
                file=sys.stderr,
            )
    return box


def _chosen(arguments: argparse.Namespace) -> "Study":
    """Study that the options ask for. Raises ParameterError."""
    from valve_control.control.parameters import files
    from valve_control.control.simulation import robustness

    settings = settings_of(arguments)
    given = {files.parse_setting(text)[0] for text in arguments.set}
    if "seed" in given:
        raise ParameterError(
            "--set seed says nothing here: each valve has a seed of its own; see --study-seed"
        )
    box = box_of(arguments)
    periods: Sequence[float] = robustness.PERIODS
    if arguments.sample_period is not None or "sample_period" in given:
        periods = (number(settings["controller"], "sample_period"),)
    source = settings["command_source"]
    if source["scenario"] == "array":
        if len(periods) > 1:
            raise ParameterError("a command array has one number per sample period; give --sample-period too")
        if arguments.duration is None:  # the whole array
            from valve_control.control.commands import arrays

            length = len(arrays.read(word(source, "command_file")))
            settings["command_source"] = updated(
                NODES["command_source"], source, {"duration": length * periods[0]}
            )
    chosen = robustness.Study(settings, arguments.valves, arguments.study_seed, box, periods)
    _check_drift(chosen)
    return chosen


def _check_drift(chosen: "Study") -> None:
    """Raise ParameterError if a valve of the study may lose its whole gain within the run."""
    duration = number(chosen.settings["command_source"], "duration")
    for q in chosen.box:
        if q.name == "drift.gain" and 1.0 + q.low * duration <= 0.0:
            raise ParameterError(
                f"with a drift.gain of {q.low:g} {q.unit} nothing is left of a valve's gain after "
                f"{-1.0 / q.low:g} s, and the duration is {duration:g} s; keep the gain with --fix drift.gain"
            )


def _print(result: dict[str, Any]) -> None:
    percents = list(next(iter(result["percentiles"].values()), {}))
    print(f"{'percentile':16}" + "".join(f"{p:>9}" for p in percents))
    for name, row in result["percentiles"].items():
        label = name if name in ("c_u", "saturated") else f"{name} [V]"
        print(f"{label:16}" + "".join(f"{row[p]:9.4f}" for p in percents))
    # What has no integral action is off target with any disturbance, and need not be unstable.
    from valve_control.control.laws.registry import LAWS

    sign = "no sign of instability" if not LAWS[str(result["controller"])].feedback else "unstable"
    shares = [f"{p} s: {100.0 * s:.3f} %" for p, s in result["unstable_by_period"].items()]
    print(
        f"e_F above {result['limit']:.4g} V ({sign}): {100.0 * result['unstable']:.3f} % of "
        f"{result['valves']} valves ({', '.join(shares)})"
    )
    print(f"worst by e_rms (--replay N): {', '.join(map(str, result['worst']['e_rms']))}")
    from valve_control.design.tuning import limits

    if result["limits"]:
        print("\n".join(limits.as_text(result["limits"], f"of the first {LOOKED_AT} valves")))


def _limits(chosen: "Study", found: "StudyResult", threads: int) -> list[dict[str, Any]]:
    """How many of the first LOOKED_AT valves miss each limit of `tune`; [] for a command that rests."""
    import numpy as np

    from valve_control.control.parameters import build
    from valve_control.control.simulation import robustness
    from valve_control.design.tuning import limits, trial, verification

    asked, counts = trial.USUAL._replace(overshoot=trial.OVERSHOOT), []
    count = min(LOOKED_AT, chosen.valves)
    points, periods = robustness.draw(chosen, 0, count)
    for period in np.unique(periods):
        values = robustness.sampled(chosen, "controller", float(period))
        wanted = build.commands(robustness.sampled(chosen, "command_source", float(period)))
        if np.ptp(wanted) == 0.0:
            return []
        own = np.flatnonzero(periods == period)
        plants = [
            build.valve_params(robustness.valve_of(chosen, int(i), points[i], float(period))) for i in own
        ]
        problem = trial.Problem(
            values, [trial.TuningMotion("command", wanted)], plants, plants, asked, False, False, chosen.seed
        )
        law = LAWS[word(values, "controller")]
        counts.append(verification.of_valves(law, problem, found.results.saturated[own], threads))
    return limits.as_rows(limits.together(counts), limits.asked(asked))


def _draw(path: Path, found: "StudyResult", controller: str) -> None:
    import numpy as np

    from valve_control.control.analysis.figures import COLOURS, Line, Plot, draw_plots

    plots = []
    for name in ("e_rms", "e_M", "e_F"):
        lines = []
        for i, period in enumerate(np.unique(found.period)):
            values = np.sort(getattr(found.results, name)[(found.period == period) & found.results.finite])
            share = 100.0 * (np.arange(len(values)) + 1.0) / max(1, len(values))
            lines.append(Line(f"{1e3 * period:g} ms", values, share, COLOURS[i % len(COLOURS)]))
        plots.append(Plot(f"{name}: valves [%]", lines))
    draw_plots(
        [path], plots, "at most [V]", f"{controller}: {len(found.period)} valves, by sample period", True
    )


def _replay(arguments: argparse.Namespace, chosen: "Study") -> None:
    from valve_control.control.analysis import limit_cycle
    from valve_control.control.parameters import build, files
    from valve_control.control.simulation import offline, robustness

    if arguments.replay < 0:
        raise ParameterError(f"--replay is {arguments.replay}; valves are numbered from 0")
    settings = robustness.settings_of_number(chosen, arguments.replay)
    command = build.commands(settings["command_source"])
    controller = settings["controller"]
    run = offline.finite_run(controller, settings["valve_simulator"], command)
    if run.warning:
        print(f"warning: {run.warning}", file=sys.stderr)
    varied = [q.name for q in chosen.box if q.name in settings["valve_simulator"]]
    names = ["numerator", "denominator", "sample_period", "seed", *varied]
    drawn = {name: settings["valve_simulator"][name] for name in names}
    if arguments.json != "-":
        print(HEADER)
        print(index_row(run.controller, run.indices))
        cycle = limit_cycle.in_words(run.saturated, run.limit_cycle)
        if cycle:
            print(f"{run.controller}: {cycle}")
        for name, value in drawn.items():
            print(f"{name} = {value}")
    title = f"valve {arguments.replay}"
    if arguments.output is not None:
        comment = f"{title} of a study with seed {chosen.seed}"
        deliver(arguments, arguments.output, files.as_yaml(settings, [comment]))
    if arguments.figure is not None:
        from valve_control.control.analysis.figures import Trace, draw_traces

        trace = Trace(run.time, run.command, run.measurement, run.voltage)
        draw_traces(Path(arguments.figure), {title: {run.controller: trace}}, "study")
        wrote(arguments, arguments.figure)
    result = {
        "number": arguments.replay,
        "indices": run.indices._asdict(),
        **limit_cycle.as_dict(run.saturated, run.limit_cycle),
        "warning": run.warning or None,
        "valve": drawn,
    }
    write_json(arguments, result)
