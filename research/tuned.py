# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m research.tuned``: every law with its tuned gains on random valves, beside the oracle."""

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from research import running
from valve_control.cli.common import Parser, check_outputs, say, write_json
from valve_control.control.analysis import figures
from valve_control.parameter import ParameterError

if TYPE_CHECKING:
    from research.comparison import Errors

BOXES = ("narrow", "wide")
SEED = 999  # of the valves; those of the searches had others
VALVES = 200
MOST = 100_000


def _options() -> Parser:
    parser = running.options(
        "tuned",
        "Every law with its gains of config/tuned on four commands, with and without preview, beside the "
        "oracle.",
    )
    parser.add_argument("--valves", type=int, default=VALVES, metavar="N", help=f"how many ({VALVES})")
    parser.add_argument("--seed", type=int, default=SEED, metavar="N", help=f"of the valves ({SEED})")
    parser.add_argument(
        "--box",
        choices=BOXES,
        default=BOXES[0],
        help="narrow: as they are; wide: speed and dead time vary too",
    )
    parser.add_argument(
        "--limit", type=float, default=0.25, metavar="C_U", help="chatter that the gains are tuned for (0.25)"
    )
    parser.add_argument("--gains", metavar="FOLDER", help="gains in another folder than config/tuned")
    parser.add_argument(
        "--figure", metavar="FILE", help="medians and 95th percentiles with preview as PNG or SVG"
    )
    return parser


def _compare(arguments: argparse.Namespace) -> None:
    from research import comparison
    from valve_control.control.parameters import ros_file

    check_outputs(arguments)
    count, seed, box, limit = arguments.valves, arguments.seed, arguments.box, arguments.limit
    if not 1 <= count <= MOST:
        raise ParameterError(f"--valves is {count}; it must lie between 1 and {MOST}")
    if seed < 0:
        raise ParameterError(f"--seed is {seed}; it must be 0 or more")
    if not 0.0 < limit < math.inf:
        raise ParameterError(f"--limit is {limit:g}; it must be above 0, and finite")
    folder = Path(arguments.gains) if arguments.gains else ros_file.config_folder() / "tuned"
    given = comparison.setups(folder, box, limit)
    found = comparison.compare(given, count, seed, box == "wide")
    if arguments.json != "-":
        print(
            f"true e_rms [mV], medians over {count} valves of the {box} box, gains tuned at c_u <= {limit:g}"
        )
        print(comparison.table(found))
    if arguments.figure is not None:
        _draw(Path(arguments.figure), found)
        say(arguments, f"wrote {arguments.figure}")
    laws = {
        setup.name: {"controller": setup.values["controller"], "preview_s": setup.preview} for setup in given
    }
    by_mode = {
        text: {name: comparison.summary(errors) for name, errors in by_name.items()}
        for text, by_name in found.items()
    }
    write_json(
        arguments,
        {
            "box": box,
            "limit_c_u": limit,
            "valves": count,
            "seed": seed,
            "unit": "mV",
            "laws": laws,
            **by_mode,
        },
    )


def _draw(path: Path, found: Mapping[str, Mapping[str, "Errors"]]) -> None:
    """Draw bars of the medians with preview, with a line up to the 95th percentile, by command and law."""
    import numpy as np
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogFormatter, StrMethodFormatter

    from research import comparison

    figure = Figure(figsize=(11.0, 4.0))
    axes = figure.add_subplot(1, 1, 1)
    heads = list(comparison.motions())
    by_name = found["with preview"]
    width = 0.8 / len(by_name)
    for i, (name, errors) in enumerate(by_name.items()):
        median, high = 1e3 * np.percentile(errors.rms, [50, 95], axis=1)
        at = np.arange(len(heads)) + (i - 0.5 * (len(by_name) - 1)) * width
        chatter = float(np.mean(errors.chatter))
        axes.bar(
            at,
            median,
            width,
            yerr=[np.zeros_like(median), high - median],
            color=running.LAW_COLOURS[name],
            error_kw={"lw": 1.0, "capsize": 2},
            label=f"{name}, c_u {chatter:.2f}",
        )
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.yaxis.set_minor_formatter(LogFormatter(labelOnlyBase=False, minor_thresholds=(2.0, 0.5)))
    axes.grid(axis="y", which="both", alpha=0.3)
    axes.set_axisbelow(True)
    axes.set_xticks(range(len(heads)), heads)
    axes.set_ylabel("true e_rms [mV]")
    axes.set_title("medians, lines up to the 95th percentile")
    axes.legend(fontsize="small", ncols=len(by_name), loc="upper center", bbox_to_anchor=(0.5, -0.08))
    figure.tight_layout()
    figures.save(figure, path)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; returns the exit status."""
    return running.run(_options(), _compare, argv)


if __name__ == "__main__":
    sys.exit(main())
