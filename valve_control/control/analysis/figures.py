# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Draws runs over time and other curves with matplotlib, as PNG or SVG files."""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from valve_control import outputs
from valve_control.arrays import Floats

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#882255", "#44AA99")
_LAWS = ("dcarc", "pid", "oarc", "arc", "compensator", "open_loop")
LAW_COLOURS = dict(zip(_LAWS, (*COLOURS[:5], "#8C8C8C"), strict=True))
FAR = 6.0  # times the least error of several runs, beyond which an error would hide the others


class Trace(NamedTuple):
    """Signals of one run, as a figure shows them."""

    time: Floats  # s
    command: Floats  # V
    position: Floats  # V
    voltage: Floats  # V


class Line(NamedTuple):
    """One line of a plot, with its style."""

    label: str
    x: Floats
    y: Floats
    colour: str = ""
    style: str = "-"  # of matplotlib: "-", "--" or "o"


class Band(NamedTuple):
    """A coloured stretch of the horizontal axis, in all plots."""

    start: float
    end: float
    colour: str


class Plot(NamedTuple):
    """One plot of a figure: its lines and axes."""

    title: str  # of its vertical axis
    lines: Sequence[Line]
    logarithmic: bool = False


def draw_traces(paths: Sequence[Path], traces: Mapping[str, Trace], title: str, figure: Any = None) -> None:
    """Draw position, error and voltage of runs with one command over time, otherwise as ``draw_columns``."""
    first = next(iter(traces.values()))
    stroke = float(np.ptp(first.command))
    errors = {label: trace.position - trace.command for label, trace in traces.items()}
    sizes = {label: float(np.sqrt(np.nanmean(np.square(error)))) for label, error in errors.items()}
    others = sorted(traces.keys() - LAW_COLOURS.keys())  # laws of other packages
    colours = LAW_COLOURS | {label: COLOURS[5 + i % 3] for i, label in enumerate(others)}
    top, middle, bottom = list[Line](), list[Line](), list[Line]()
    for label, trace in traces.items():
        colour, time = colours[label], trace.time
        error, rms = errors[label], sizes[label]
        label += f": {float(f'{1e3 * rms:.3g}'):g} mV rms"
        label += f", {100.0 * rms / stroke:.2g} % of stroke" if stroke > 0.0 else ""
        top.append(Line(label, time, trace.position, colour))
        if rms <= FAR * np.nanmin([*sizes.values()]):
            middle.append(Line(label, time, 1e3 * error, colour))
        bottom.append(Line(label, time, trace.voltage, colour))
    top.append(Line("command", first.time, first.command, "black", "--"))
    name = "error [mV]" if len(middle) == len(traces) else "small errors [mV]"
    plots = [Plot("spool position [V]", top), Plot(name, middle), Plot("voltage [V]", bottom)]
    draw_columns(paths, {"": plots}, "time [s]", title, figure=figure)


def draw_columns(
    paths: Sequence[Path],
    columns: Mapping[str, Sequence[Plot]],
    x_title: str,
    title: str,
    logarithmic_x: bool = False,
    figure: Any = None,
) -> None:
    """Draw a column of plots for each name, into each of ``paths``; a column has one horizontal axis.

    ``figure``: an empty one of matplotlib to draw into. Raises OSError if a path cannot be written.
    """
    from matplotlib.figure import Figure

    rows = max(len(plots) for plots in columns.values())
    figure = Figure() if figure is None else figure
    figure.set_size_inches(9.0 * len(columns), 1.2 + 2.4 * rows)
    axes = figure.subplots(rows, len(columns), sharex="col", squeeze=False)
    for column, (name, plots) in zip(axes.T, columns.items(), strict=True):
        told: set[str] = set()  # lines that a legend above explains
        for axis, plot in zip(column, plots, strict=True):
            axis.grid(True, which="both", alpha=0.3)
            for i, line in enumerate(plot.lines):
                colour = line.colour or COLOURS[i % len(COLOURS)]
                axis.plot(line.x, line.y, line.style, color=colour, lw=1.0, ms=3.0, label=line.label)
            axis.set(ylabel=plot.title, yscale="log" if plot.logarithmic else "linear")
            if logarithmic_x:
                axis.set_xscale("log")
                axis.xaxis.set_major_formatter("{x:g}")
            labels = {line.label for line in plot.lines}
            if len(plot.lines) > 1 and not labels <= told:
                above = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "frameon": False}
                axis.legend(fontsize="small", ncols=2, borderaxespad=0.1, **above)
                told |= labels
        column[0].set_title(name, loc="left")
        column[-1].set_xlabel(x_title)
    figure.suptitle(title)
    figure.tight_layout()
    for path in paths:
        save(figure, path)


def save(figure: Any, path: Path) -> None:
    """Write a matplotlib figure to ``path``, as PNG or SVG by its ending. Raises OSError."""
    import matplotlib

    stream, kind = io.BytesIO(), path.suffix[1:].lower()
    with matplotlib.rc_context({"svg.hashsalt": "valve_control"}):  # one figure always gives the same bytes
        figure.savefig(stream, format=kind, dpi=110, metadata={"Date": None} if kind == "svg" else None)
    outputs.write(str(path), stream.getvalue())
