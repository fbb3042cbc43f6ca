"""Robustness study: distributions of the indices over many valves, and its worst cases again."""

import argparse
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from valve_control.analysis.tables import HEADER, index_row
from valve_control.cli.common import check_outputs, say, write_json
from valve_control.cli.simulate import CONTROLLERS, settings_of, setup_options
from valve_control.parameters.table import ParameterError

if TYPE_CHECKING:
    from valve_control.simulation.study import Found


def add_commands(commands: Any) -> None:
    """Add study to the command's sub-commands."""
    study = commands.add_parser(
        "study",
        parents=[setup_options()],
        help="one controller on many valves: distributions, share unstable, worst cases",
        description="Run one controller on many valves drawn from a box of gains, speeds, frictions, flow "
        "forces, drifts, noises, delays and sample periods. Ctrl-C stops it; the same command goes on.",
    )
    study.add_argument("--controller", choices=CONTROLLERS, help="control law (default: arc)")
    group = study.add_argument_group("study")
    group.add_argument("--valves", type=int, default=100_000, metavar="N", help="how many (100000)")
    group.add_argument("--folder", default="out/study", help="where results are kept (out/study)")
    group.add_argument("--study-seed", type=int, default=1, metavar="N", help="seed of the draw (1)")
    group.add_argument("--threads", type=int, default=os.cpu_count() or 1, metavar="N", help="(all cores)")
    group.add_argument(
        "--limit",
        type=float,
        default=0.15,
        metavar="V",
        help="a loop with a larger error in the last two seconds counts as unstable (0.15)",
    )
    group.add_argument("--replay", type=int, metavar="N", help="run valve number N again, alone")
    group.add_argument("--box", action="store_true", help="list the box and leave")
    output = study.add_argument_group("what comes out")
    output.add_argument("--json", metavar="FILE", help="results as JSON; - for standard output alone")
    output.add_argument("--figure", metavar="FILE", help="distributions as PNG; with --replay the run")
    study.set_defaults(run=_study)


def _study(arguments: argparse.Namespace) -> None:
    from valve_control.simulation import study

    check_outputs([arguments.json], [arguments.figure])
    for name in ("valves", "threads"):
        if getattr(arguments, name) < 1:
            raise ParameterError(f"--{name} is {getattr(arguments, name)}; it must be at least 1")
    settings = settings_of(arguments)
    periods = study.PERIODS if arguments.sample_period is None else (arguments.sample_period,)
    chosen = study.Study(settings, arguments.valves, arguments.study_seed, study.BOX, periods)
    if arguments.box:
        for q in study.BOX:
            say(arguments, f"{q.name:24}{q.low:10g} … {q.high:<10g}{q.unit}")
        say(arguments, f"{'sample_period':24}{', '.join(f'{p:g}' for p in periods):>24} s")
        return
    if arguments.replay is not None:
        _replay(arguments, chosen)
        return
    try:
        found = study.run(chosen, Path(arguments.folder), _Progress(arguments.valves), arguments.threads)
    except KeyboardInterrupt:
        print(f"stopped; the same command goes on from {arguments.folder}", file=sys.stderr)
        sys.exit(130)
    result = study.summary(found, arguments.limit)
    if arguments.json != "-":
        _print(result)
    if arguments.figure is not None:
        _draw(Path(arguments.figure), found)
        say(arguments, f"wrote {arguments.figure}")
    write_json(arguments, result)


class _Progress:
    """A line of progress every few seconds, with the time left."""

    def __init__(self, valves: int) -> None:
        self._valves = valves
        self._began = self._said = time.monotonic()
        self._kept = -1  # valves that were there from the start

    def __call__(self, valves: int) -> None:
        now = time.monotonic()
        if self._kept < 0 or now - self._began < 1.0:
            self._kept = valves
        if now - self._said < 5.0 or valves == self._kept:
            return
        self._said = now
        left = (now - self._began) * (self._valves - valves) / (valves - self._kept)
        print(f"{valves} of {self._valves} valves, {left:.0f} s left", file=sys.stderr)


def _print(result: dict[str, Any]) -> None:
    percents = list(next(iter(result["percentiles"].values()), {}))
    print(f"{'percentile':12}" + "".join(f"{p:>9}" for p in percents))
    for name, row in result["percentiles"].items():
        print(f"{name:12}" + "".join(f"{row[p]:9.4f}" for p in percents))
    shares = [f"{p} s: {100.0 * s:.3f} %" for p, s in result["unstable_by_period"].items()]
    print(f"unstable: {100.0 * result['unstable']:.3f} % of {result['valves']} valves ({', '.join(shares)})")
    print(f"worst by e_rms (--replay N): {', '.join(map(str, result['worst']['e_rms']))}")


def _draw(path: Path, found: "Found") -> None:
    import numpy as np

    from valve_control.analysis.figures import COLOURS, Line, Plot, draw_plots

    plots = []
    for name in ("e_rms", "e_M", "e_F"):
        lines = []
        for i, period in enumerate(np.unique(found.period)):
            values = np.sort(getattr(found.results, name)[(found.period == period) & found.results.finite])
            share = 100.0 * (np.arange(len(values)) + 1.0) / max(1, len(values))
            lines.append(Line(f"{1e3 * period:g} ms", values, share, COLOURS[i % len(COLOURS)]))
        plots.append(Plot(f"{name}: valves [%]", lines))
    draw_plots([path], plots, "at most [V]", f"{len(found.period)} valves, by sample period", True)


def _replay(arguments: argparse.Namespace, chosen: Any) -> None:
    from valve_control.simulation import offline, study

    if arguments.replay < 0:
        raise ParameterError(f"--replay is {arguments.replay}; valves are numbered from 0")
    settings = study.settings_of_number(chosen, arguments.replay)
    command = offline.commands(settings["command_source"])
    run = offline.simulate(settings["controller"], settings["valve_simulator"], command)
    names = ["numerator", "denominator", "sample_period", "seed", *(q.name for q in study.BOX[2:])]
    drawn = {name: settings["valve_simulator"][name] for name in names}
    if arguments.json != "-":
        print(HEADER)
        print(index_row(run.controller, run.indices))
        for name, value in drawn.items():
            print(f"{name} = {value}")
    if arguments.figure is not None:
        from valve_control.analysis.figures import Trace, draw_traces

        trace = Trace(run.time, run.command, run.measurement, run.voltage)
        draw_traces(Path(arguments.figure), {f"valve {arguments.replay}": {run.controller: trace}}, "study")
        say(arguments, f"wrote {arguments.figure}")
    write_json(arguments, {"number": arguments.replay, "indices": run.indices._asdict(), "valve": drawn})
