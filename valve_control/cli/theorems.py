"""Both theorems as experiments."""

import argparse
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from valve_control import outputs
from valve_control.cli.common import check_outputs, say, write_json
from valve_control.parameters.table import ParameterError

if TYPE_CHECKING:
    from valve_control.theorems.bench import Progress

ERRATA_FIGURES = ("theorems", "sample_period")


def add_commands(commands: Any) -> None:
    """Add theorems to the command's sub-commands."""
    theorems = commands.add_parser(
        "theorems",
        help="both theorems of the paper on random valves, over the sample period",
        description="Put both theorems to the test on random valves: V2 against its guaranteed bound under "
        "bounded disturbances, and the error's decay under parametric uncertainty only, at sample periods "
        "from 1 ms down to 20 µs.",
    )
    theorems.add_argument("--valves", type=int, default=2000, metavar="N", help="valves for the bound (2000)")
    theorems.add_argument(
        "--adaptive-valves", type=int, default=40, metavar="N", help="valves for the error's decay (40)"
    )
    theorems.add_argument("--seed", type=int, default=1, metavar="N", help="seed of valves and motions (1)")
    theorems.add_argument(
        "--processes", type=int, default=os.cpu_count() or 1, metavar="N", help="(all cores)"
    )
    theorems.add_argument("--json", metavar="FILE", help="results as JSON; - for standard output alone")
    theorems.add_argument("--figure", metavar="FILE", help="both studies as PNG or SVG")
    theorems.add_argument(
        "--errata-figures",
        metavar="FOLDER",
        help="also find the sample period that each weight ρ of OARC allows; draw the figures of "
        "docs/errata.md into FOLDER",
    )
    theorems.set_defaults(run=_theorems)


@contextmanager
def _progress(title: str) -> Iterator["Progress"]:
    from tqdm import tqdm

    with tqdm(desc=title, file=sys.stderr, ascii=not sys.stderr.isatty(), mininterval=1.0) as bar:

        def show(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield show


def _theorems(arguments: argparse.Namespace) -> None:
    from valve_control.theorems import adaptive, figures, robust, sampling, tables

    for name in ("valves", "adaptive_valves", "processes"):
        if getattr(arguments, name) < 1:
            raise ParameterError(f"--{name.replace('_', '-')} must be at least 1")
    if arguments.seed < 0:
        raise ParameterError("--seed must not be negative")
    folder = None if arguments.errata_figures is None else Path(arguments.errata_figures)
    if folder is not None and not folder.is_dir():
        raise ParameterError(f"--errata-figures {folder}: there is no such folder")
    drawn: dict[str, list[Path]] = {}
    if folder is not None:
        drawn = {name: [folder / f"{name}.{kind}" for kind in ("png", "svg")] for name in ERRATA_FIGURES}
    check_outputs([arguments.json], [arguments.figure, *(str(p) for paths in drawn.values() for p in paths)])
    outputs.check_figure(arguments.figure)
    seed, jobs = arguments.seed, arguments.processes
    with _progress("bound on V2") as progress:
        bound = robust.study(arguments.valves, seed, jobs=jobs, progress=progress)
    with _progress("error's decay") as progress:
        error = adaptive.study(arguments.adaptive_valves, seed, jobs=jobs, progress=progress)
    result = {"bound": tables.robust_data(bound), "error": tables.adaptive_data(error)}
    lines = [*tables.robust_lines(bound), "", *tables.adaptive_lines(error)]
    if folder is not None:
        with _progress("sample period") as progress:
            limits = sampling.sample_period_limit(jobs=jobs, progress=progress)
        result["sample_period"] = tables.sampling_data(limits)
        lines += ["", *tables.sampling_lines(limits)]
    if arguments.json != "-":
        print("\n".join(lines))
    write_json(arguments, result)
    if arguments.figure is not None:
        figures.draw_theorems([Path(arguments.figure)], bound, error)
        say(arguments, f"wrote {arguments.figure}")
    if folder is not None:
        figures.draw_theorems(drawn["theorems"], bound, error)
        figures.draw_sample_period(drawn["sample_period"], limits)
        say(arguments, f"wrote theorems and sample_period as PNG and SVG to {folder}")
