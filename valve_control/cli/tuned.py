"""Runs `compare --tuned`: all laws with their tuned gains on random valves."""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from valve_control import outputs
from valve_control.cli.common import check_outputs, say, write_json
from valve_control.parameter import ParameterError

if TYPE_CHECKING:
    from valve_control.simulation.comparison import Errors

BOXES = ("narrow", "wide")
SEED = 999  # of the valves; those of the searches had others
VALVES = 200
MOST = 100_000


def add_options(compare: argparse.ArgumentParser) -> None:
    """Add the options of `compare --tuned`."""
    group = compare.add_argument_group("tuned laws on random valves")
    group.add_argument(
        "--tuned",
        action="store_true",
        help="every law with its gains of config/tuned on four commands, with and without preview, beside "
        "the oracle; --seed draws the valves",
    )
    group.add_argument("--valves", type=int, metavar="N", help=f"how many ({VALVES})")
    group.add_argument("--box", choices=BOXES, help="narrow: as they are; wide: speed and dead time vary too")
    group.add_argument(
        "--limit", type=float, metavar="C_U", help="chatter that the gains are tuned for (0.25)"
    )
    group.add_argument("--gains", metavar="FOLDER", help="gains in another folder than config/tuned")


def compare_tuned(arguments: argparse.Namespace) -> None:
    """Measure, print, write."""
    from valve_control.parameters import files
    from valve_control.simulation import comparison

    check_outputs(arguments, figures=[arguments.figure])
    count = VALVES if arguments.valves is None else arguments.valves
    if not 1 <= count <= MOST:
        raise ParameterError(f"--valves is {count}; it must lie between 1 and {MOST}")
    seed = SEED if arguments.seed is None else arguments.seed
    if seed < 0:
        raise ParameterError(f"--seed is {seed}; it must be 0 or more")
    box = arguments.box or BOXES[0]
    limit = 0.25 if arguments.limit is None else arguments.limit
    folder = Path(arguments.gains) if arguments.gains else files.config_folder() / "tuned"
    given = comparison.setups(folder, box, limit)
    found = comparison.compare(given, count, seed, box == "wide")
    if arguments.json != "-":
        print(
            f"true e_rms [mV], medians over {count} valves of the {box} box, gains tuned at c_u <= {limit:g}"
        )
        print(comparison.table(found))
    if arguments.figure is not None:
        outputs.write(arguments.figure, _figure(found, arguments.figure))
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


def _figure(found: Mapping[str, Mapping[str, "Errors"]], path: str) -> bytes:
    """Bars of the medians with a line up to the 95th percentile, by command and law."""
    import numpy as np
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogFormatter, StrMethodFormatter

    from valve_control.analysis.figures import COLOURS
    from valve_control.simulation import comparison

    figure = Figure(figsize=(11.0, 4.0 * len(found)))
    heads = list(comparison.motions())
    for plot, (text, by_name) in enumerate(found.items()):
        axes = figure.add_subplot(len(found), 1, plot + 1)
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
                color="0.6" if name == comparison.ORACLE else COLOURS[i % len(COLOURS)],
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
        axes.set_title(f"{text}: medians, lines up to the 95th percentile")
        axes.legend(fontsize="small", ncols=len(by_name), loc="upper center", bbox_to_anchor=(0.5, -0.08))
    figure.tight_layout()
    return outputs.figure_bytes(figure, path)
