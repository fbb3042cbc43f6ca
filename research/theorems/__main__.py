# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m research.theorems``: both theorems, and the stability of dcarc, on random valves."""

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from research import running
from valve_control.cli.common import (
    CORES,
    MOST_THREADS,
    Parser,
    check_figure,
    check_outputs,
    say,
    within,
    write_json,
)
from valve_control.parameter import ParameterError

if TYPE_CHECKING:
    from research.theorems.bench import Progress

ERRATA_FIGURES = ("theorems", "sample_period")
COUNTS = ("valves", "adaptive_valves", "loop_valves", "learning_valves")


def _options() -> Parser:
    theorems = running.options(
        "theorems",
        "Put both theorems to the test on random valves: V2 against its guaranteed bound under "
        "bounded disturbances, and the error's decay under parametric uncertainty only, at sample periods "
        "from 1 ms down to 20 µs. And dcarc, at 1 ms: poles of the loop over boxes of valves of several "
        "sizes, what of the valve breaks it, and how fast it may learn.",
    )
    theorems.add_argument("--valves", type=int, default=2000, metavar="N", help="valves for the bound (2000)")
    theorems.add_argument(
        "--adaptive-valves", type=int, default=40, metavar="N", help="valves for the error's decay (40)"
    )
    theorems.add_argument(
        "--loop-valves", type=int, default=1000, metavar="N", help="valves for dcarc's poles (1000)"
    )
    theorems.add_argument(
        "--learning-valves", type=int, default=50, metavar="N", help="valves for dcarc's learning (50)"
    )
    theorems.add_argument("--seed", type=int, default=1, metavar="N", help="seed of valves and motions (1)")
    theorems.add_argument(
        "--processes", type=within(1, MOST_THREADS), default=CORES, metavar="N", help="(all cores)"
    )
    theorems.add_argument("--figure", metavar="FILE", help="the theorems as PNG or SVG")
    theorems.add_argument("--dcarc-figure", metavar="FILE", help="the stability of dcarc as PNG or SVG")
    theorems.add_argument(
        "--errata-figures",
        metavar="FOLDER",
        help="also find the sample period that each weight ρ of OARC allows; draw the figures of "
        "docs/reference/errata.md into FOLDER",
    )
    return theorems


@contextmanager
def _progress(title: str) -> Iterator["Progress"]:
    from tqdm import tqdm

    with tqdm(desc=title, file=sys.stderr, ascii=not sys.stderr.isatty(), mininterval=1.0) as bar:

        def show(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield show


def _theorems(arguments: argparse.Namespace) -> None:
    from research.theorems import adaptive, figures, learning, loop, robust, sampling, tables

    for name in COUNTS:
        if getattr(arguments, name) < 1:
            raise ParameterError(f"--{name.replace('_', '-')} must be at least 1")
    if arguments.seed < 0:
        raise ParameterError("--seed must not be negative")
    folder = None if arguments.errata_figures is None else Path(arguments.errata_figures)
    if folder is not None and not folder.is_dir():
        raise ParameterError(f"--errata-figures {folder}: there is no such folder")
    laws = loop.shipped()  # before what takes long, since its files may be missing
    drawn: dict[str, list[Path]] = {}
    if folder is not None:
        drawn = {name: [folder / f"{name}.{kind}" for kind in ("png", "svg")] for name in ERRATA_FIGURES}
    more = [arguments.dcarc_figure] if arguments.dcarc_figure is not None else []
    check_outputs(arguments, *(str(p) for paths in drawn.values() for p in paths), *more)
    check_figure(arguments.dcarc_figure)
    seed, processes = arguments.seed, arguments.processes
    with _progress("bound on V2") as progress:
        bound = robust.experiment(arguments.valves, seed, processes=processes, progress=progress)
    with _progress("error's decay") as progress:
        error = adaptive.experiment(arguments.adaptive_valves, seed, processes=processes, progress=progress)
    with _progress("dcarc's poles") as progress:
        poles = loop.study(arguments.loop_valves, seed, laws=laws, processes=processes, progress=progress)
    with _progress("dcarc's learning") as progress:
        learned = learning.experiment(arguments.learning_valves, seed, processes=processes, progress=progress)
    result = {"bound": tables.robust_data(bound), "error": tables.adaptive_data(error)}
    result["dcarc_loop"] = tables.loop_data(poles)
    result["dcarc_learning"] = tables.learning_data(learned)
    lines = [*tables.robust_lines(bound), "", *tables.adaptive_lines(error)]
    lines += ["", *tables.loop_lines(poles), "", *tables.learning_lines(learned)]
    if folder is not None:
        with _progress("sample period") as progress:
            limits = sampling.sample_period_limit(processes=processes, progress=progress)
        result["sample_period"] = tables.sampling_data(limits)
        lines += ["", *tables.sampling_lines(limits)]
    if arguments.json != "-":
        print("\n".join(lines))
    write_json(arguments, result)
    if arguments.figure is not None:
        figures.draw_theorems([Path(arguments.figure)], bound, error)
        say(arguments, f"wrote {arguments.figure}")
    if arguments.dcarc_figure is not None:
        figures.draw_dcarc([Path(arguments.dcarc_figure)], poles, learned)
        say(arguments, f"wrote {arguments.dcarc_figure}")
    if folder is not None:
        figures.draw_theorems(drawn["theorems"], bound, error)
        figures.draw_sample_period(drawn["sample_period"], limits)
        say(arguments, f"wrote theorems and sample_period as PNG and SVG to {folder}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; returns the exit status."""
    return running.run(_options(), _theorems, argv)


if __name__ == "__main__":
    sys.exit(main())
