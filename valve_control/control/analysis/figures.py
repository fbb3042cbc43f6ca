# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Draws runs over time and other curves with matplotlib, as PNG or SVG files."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from valve_control import outputs
from valve_control.arrays import Floats

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")


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
    dashed: bool = False


class Band(NamedTuple):
    """A coloured stretch of the horizontal axis, in all plots or as a strip in one."""

    start: float
    end: float
    colour: str
    opacity: float = 0.2
    plot: int | None = None  # which one, None: all
    low: float = 0.0  # part of its height from which ...
    high: float = 1.0  # ... to which it reaches


class Plot(NamedTuple):
    """One plot of a figure: its lines and axes."""

    title: str  # of its vertical axis
    lines: Sequence[Line]
    logarithmic: bool = False


def draw_traces(
    path: Path,
    groups: Mapping[str, Mapping[str, Trace]],
    title: str,
    bands: Sequence[Band] = (),
    own_commands: bool = False,
) -> None:
    """Draw command and position, error, and voltage over time; a column per group, a colour per run.

    ``own_commands``: the runs need not have one command. Raises OSError if ``path`` cannot be written.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(3, len(groups), figsize=(9.0 * len(groups), 8.5), sharex="col", squeeze=False)
    for column, (name, traces) in enumerate(groups.items()):
        _draw_column(axes[:, column], traces, own_commands)
        for band in bands:
            for axis in axes[:, column] if band.plot is None else [axes[band.plot, column]]:
                # Without its edge a band narrower than a pixel would not be seen.
                axis.axvspan(
                    band.start, band.end, band.low, band.high, color=band.colour, alpha=band.opacity, lw=0.5
                )
        axes[0, column].set_title(name)
    figure.suptitle(title)
    figure.tight_layout()
    outputs.write(str(path), outputs.figure_bytes(figure, str(path)))


def _draw_column(axes: Sequence[Any], traces: Mapping[str, Trace], own_commands: bool) -> None:
    top, middle, bottom = axes
    for i, (label, trace) in enumerate(traces.items()):
        colour = COLOURS[i % len(COLOURS)]
        if i == 0:
            top.plot(trace.time, trace.command, color="black", lw=1.2, label="command")
        elif own_commands:
            top.plot(trace.time, trace.command, color=colour, lw=1.0, ls="--")
        top.plot(trace.time, trace.position, color=colour, lw=1.0, label=label)
        middle.plot(trace.time, trace.position - trace.command, color=colour, lw=0.8, label=label)
        bottom.plot(trace.time, trace.voltage, color=colour, lw=0.8, label=label)
    top.set_ylabel("spool position [V]")
    middle.set_ylabel("error [V]")
    bottom.set_ylabel("solenoid voltage [V]")
    bottom.set_xlabel("time [s]")
    top.legend(loc="upper right")
    for axis in axes:
        axis.grid(True, alpha=0.3)


def draw_plots(
    paths: Sequence[Path], plots: Sequence[Plot], x_title: str, title: str, logarithmic_x: bool = False
) -> None:
    """Draw plots below each other with one horizontal axis, into each of ``paths`` (.png or .svg).

    Raises OSError if a path cannot be written.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    height = 1.2 + 2.4 * len(plots)
    figure, axes = plt.subplots(len(plots), 1, figsize=(9.0, height), sharex=True, squeeze=False)
    told: set[str] = set()  # lines that a legend above explains
    for axis, plot in zip(axes[:, 0], plots, strict=True):
        for i, line in enumerate(plot.lines):
            axis.plot(
                line.x,
                line.y,
                color=line.colour or COLOURS[i % len(COLOURS)],
                ls="--" if line.dashed else "-",
                lw=1.0,
                label=line.label,
            )
        axis.set_ylabel(plot.title)
        axis.grid(True, which="both", alpha=0.3)
        if plot.logarithmic:
            axis.set_yscale("log")
        if logarithmic_x:
            axis.set_xscale("log")
        labels = {line.label for line in plot.lines}
        if len(plot.lines) > 1 and not labels <= told:
            axis.legend(fontsize="small", ncols=2)
            told |= labels
    axes[-1, 0].set_xlabel(x_title)
    figure.suptitle(title)
    figure.tight_layout()
    for path in paths:
        outputs.write(str(path), outputs.figure_bytes(figure, str(path)))


def bode_axes(title: str, gain_title: str) -> tuple[Any, Any, Any]:
    """Figure with axes for gain [dB] and phase [°] over frequency [Hz], one above the other."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (top, bottom) = plt.subplots(2, 1, figsize=(9.0, 8.0), sharex=True)
    top.set_ylabel(gain_title)
    bottom.set_ylabel("phase [°]")
    bottom.set_xlabel("frequency [Hz]")
    for axis in (top, bottom):
        axis.grid(True, which="both", alpha=0.3)
    figure.suptitle(title)
    return figure, top, bottom
