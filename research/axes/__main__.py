# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m research.axes``: what a fast valve buys, on random axes under five valves."""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from research import running
from valve_control.cli.common import MOST_THREADS, Parser, check_outputs, say, within, write_json

if TYPE_CHECKING:
    from research.axes.study import Result

_WAYS = {"lines": "by its own method", "exact_in_time": "by our steps"}


def _options() -> Parser:
    axes = running.options(
        "axes",
        "Random axes under five valves: as delivered, under three controllers, and an ideal "
        "servo valve of 100 Hz; each axis with half of its largest stable gain. docs/howto/axes.md.",
    )
    axes.add_argument(
        "--axes", type=within(1, 100_000), default=200, metavar="N", help="how many random axes (200)"
    )
    axes.add_argument(
        "--upper", choices=("axis_pid", "axis_arc"), default="axis_pid", help="upper level (axis_pid)"
    )
    axes.add_argument("--threads", type=within(1, MOST_THREADS), metavar="N", help="threads (all cores)")
    axes.add_argument(
        "--references", metavar="FOLDER", help="with Hopsan's Position Servo.hvd, to be compared"
    )
    axes.add_argument("--figure", metavar="FILE", help="bandwidths and errors of all axes as PNG or SVG")
    return axes


def _axes(arguments: argparse.Namespace) -> None:
    import numpy as np
    from tqdm import tqdm

    from research.axes import hopsan, study

    check_outputs(arguments)
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

    from valve_control.control.analysis.figures import Line, Plot, draw_columns

    share = 100.0 * (np.arange(len(next(iter(found.values())))) + 1.0) / len(next(iter(found.values())))
    picks: dict[str, Callable[[Result], float]] = {
        "bandwidth at most [Hz]": lambda r: r.bandwidth,
        "rms error at most [mm]": lambda r: 1e3 * r.motion.e_rms,
    }
    plots = [
        Plot(
            title,
            [
                Line(name, share, np.sort([pick(r) for r in results]), running.LAW_COLOURS[name])
                for name, results in found.items()
            ],
            True,
        )
        for title, pick in picks.items()
    ]
    draw_columns(
        [path],
        {"": plots},
        "share of the axes [%]",
        "servo valve of 100 Hz, and the slow valve under each law",
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; returns the exit status."""
    return running.run(_options(), _axes, argv)


if __name__ == "__main__":
    sys.exit(main())
