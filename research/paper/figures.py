# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Draws the paper's figures from our runs."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from research.paper.runs import BANDWIDTH, CLOSED_AMPLITUDE, FEEDBACK, OPEN_AMPLITUDE, open_loops
from research.paper.traces import Trace
from valve_control.control.analysis.figures import COLOURS, LAW_COLOURS, Line, Plot
from valve_control.control.laws import compensator_design
from valve_control.control.plant.transfer_functions import FOURTH_ORDER, SECOND_ORDER, TransferFunction
from valve_control.design.identification import bode
from valve_control.design.identification.bode_fit import hold
from valve_control.design.identification.response import Response, find_segments, stepped

Floats = npt.NDArray[np.float64]
GRID = np.geomspace(0.5, 100.0, 400)  # Hz
SETTLE = 0.2  # s before a steady sine
UNSURE = 0.1  # relative uncertainty from which on a frequency tells nothing of a corner


class Figure(NamedTuple):
    """One figure, its caption, and sentences about it."""

    name: str  # of its files
    title: str
    x_title: str
    plots: list[Plot]
    logarithmic_x: bool
    notes: list[str]


def _corners(measured: Response, static_gain: float) -> bode.Corners:
    """-3 dB below ``static_gain`` [V/V] and -90° of the response itself, read between its frequencies.

    The hold's half sample is taken off, so that they compare with those of a continuous model.
    """
    sure = measured.deviation < UNSURE * np.abs(measured.value)
    if np.count_nonzero(sure) < 2:
        return bode.Corners(None, None)
    frequency = measured.frequency[sure]
    value = measured.value[sure] / hold(frequency, measured.period)
    # Far below the lowest frequency the phase is 0.
    return bode.corners(np.append(bode.GRID[0], frequency), np.append(static_gain, value))


class Measured(NamedTuple):
    """Measured frequency response, and the frequency from which on the amplifier saturated."""

    response: Response
    saturated_from: float | None  # Hz

    def curve(self) -> tuple[Floats, npt.NDArray[np.complex128], bool]:
        """Frequency [Hz] and response as that of a continuous model: without the hold's half sample."""
        f = self.response.frequency
        return f, self.response.value / hold(f, self.response.period), False

    def said(self, label: str) -> str:
        """One sentence: gain at the lowest frequency, and the corner frequencies counted from there."""
        first = float(np.abs(self.response.value[0]))
        level, phase = map(_hertz, _corners(self.response, first))
        text = (
            f"{label}: {20.0 * np.log10(first):+.1f} dB at {self.response.frequency[0]:g} Hz, from there "
            f"-3 dB {level}, -90° {phase}"
        )
        if self.saturated_from is not None:
            text += f"; left out from {self.saturated_from:.1f} Hz on, where the amplifier saturates"
        return "; ".join([text, *self.response.notes])


def measured(trace: Trace, driver: Floats, u_max: float) -> Measured:
    """Response from ``driver`` [V], the command or the voltage, to the LVDT reading of a stepped sine."""
    usable = []
    saturated = None
    for segment in find_segments(driver, trace.period):
        if np.any(np.abs(trace.voltage[segment.first : segment.end]) >= u_max):
            saturated = segment.frequency
            break
        usable.append(segment)
    response = stepped(driver, trace.measurement, usable, trace.period, SETTLE)
    return Measured(response, saturated)


def _decibels(value: npt.NDArray[np.complex128]) -> Floats:
    return np.asarray(20.0 * np.log10(np.abs(value)))


def _degrees(value: npt.NDArray[np.complex128]) -> Floats:
    return np.asarray(np.degrees(np.unwrap(np.angle(value))))


def _bode(
    lines: Mapping[str, tuple[Floats, npt.NDArray[np.complex128], bool]],
    colours: Mapping[str, str] | None = None,
) -> list[Plot]:
    """Draw magnitude and phase of responses, by label: frequency [Hz], response, whether dashed."""
    return [
        Plot(
            title,
            [
                Line(label, f, read(value), (colours or {}).get(label, ""), "--" if dashed else "-")
                for label, (f, value, dashed) in lines.items()
            ],
        )
        for title, read in (("magnitude [dB]", _decibels), ("phase [°]", _degrees))
    ]


def _hertz(frequency: float | None) -> str:
    return "not reached" if frequency is None else f"{frequency:.1f} Hz"


def figure_1(runs: Mapping[str, Trace], u_max: float) -> Figure:
    """Draw Fig. 1: response of the valve and its two models."""
    run = runs["response_open_loop"]
    found = measured(run, run.voltage, u_max)
    label = f"calibrated valve, {OPEN_AMPLITUDE:g} V"
    lines = {
        label: found.curve(),
        "second order (2)": (GRID, bode.response(SECOND_ORDER, GRID), True),
        "fourth order (3)": (GRID, bode.response(FOURTH_ORDER, GRID), True),
    }
    notes = [found.said(label)]
    for label, model in (("(2)", SECOND_ORDER), ("(3)", FOURTH_ORDER)):
        corner = bode.model_corners(model)
        notes.append(f"{label}: -3 dB at {_hertz(corner.minus_3db)}, -90° at {_hertz(corner.minus_90)}")
    notes.append(
        "The paper says 'around 6.5 Hz'. The calibrated valve has friction and another gain, as its "
        "motion of 2 V shows; (2) and (3) are the paper's linear approximations of a test whose amplitude "
        "is not printed."
    )
    return Figure(
        "figure1", "Fig. 1: the valve and its approximations", "frequency [Hz]", _bode(lines), True, notes
    )


def _compensated(transfer: TransferFunction, frequency: Floats) -> npt.NDArray[np.complex128]:
    return bode.response(transfer, frequency) * bode.response(FOURTH_ORDER, frequency)


def figure_3(runs: Mapping[str, Trace], gain: float, u_max: float) -> Figure:
    """Draw Fig. 3: responses with each compensator and with feedback."""
    labels = {name: label for name, (label, _) in open_loops(gain).items()}
    labels |= {name: name.upper() for name in FEEDBACK}
    lines = {}
    notes = []
    colours = {name.upper(): LAW_COLOURS[name] for name in FEEDBACK}
    others = [colour for colour in (*COLOURS, "black") if colour not in colours.values()]
    colours |= dict(zip(labels.values(), others, strict=False))
    for name, label in labels.items():
        run = runs[f"response_{name}"]
        found = measured(run, run.command, u_max)
        lines[label] = found.curve()
        notes.append(found.said(label))
    for label, like, transfer in (
        ("(12) on (3)", "compensator_12", compensator_design.PRINTED_SECOND_ORDER),
        ("(13) on (3)", "compensator_13", compensator_design.PRINTED_FOURTH_ORDER),
        ("ours on (3)", "designed", compensator_design.pole_zero_compensator(FOURTH_ORDER, BANDWIDTH)),
    ):
        colours[label] = colours[labels[like]]
        lines[label] = (GRID, _compensated(transfer, GRID), True)
        corner_of = bode.corners(bode.GRID, _compensated(transfer, bode.GRID))
        gain_db = float(_decibels(_compensated(transfer, np.zeros(1)))[0])
        notes.append(
            f"{label}, linear: {gain_db:+.1f} dB at 0 Hz, from there -3 dB {_hertz(corner_of[0])}, "
            f"-90° {_hertz(corner_of[1])}"
        )
    notes.append(
        f"Without feedback measured with {OPEN_AMPLITUDE:g} V, with feedback with {CLOSED_AMPLITUDE:g} V; "
        "all curves without the hold's half sample. Friction takes gain and phase from small motions at low "
        "frequencies, from PID (slow integrator) most of all; the dashed lines have none."
    )
    notes.append(
        "The paper says that (13), made from the more accurate model, performs better than (12). As printed "
        "it does not: (13) leaves the zeros of (3) in the response (docs/reference/errata.md)."
    )
    return Figure(
        "figure3", "Fig. 3: responses with compensators and under feedback", "frequency [Hz]",
        _bode(lines, colours), True, notes,
    )  # fmt: skip


def figure_4(runs: Mapping[str, Trace], gain: float) -> Figure:
    """Draw Fig. 4: a sine of 6 Hz under the open-loop laws."""
    plots = []
    notes = []
    first = runs["sine_open_loop"]
    last = first.time >= 1.0
    positions, errors = [Line("command", first.time[last], first.command[last], "black")], []
    for colour, (name, (label, _)) in zip(COLOURS, open_loops(gain).items(), strict=False):
        run = runs[f"sine_{name}"]
        positions.append(Line(label, run.time[last], run.measurement[last], colour))
        errors.append(Line(label, run.time[last], (run.measurement - run.command)[last], colour))
        rms = float(np.sqrt(np.mean((run.measurement - run.command)[last] ** 2)))
        notes.append(f"{label}: rms error {rms:.3f} V of a sine of {np.max(run.command):.1f} V")
    plots = [Plot("spool position [V]", positions), Plot("error [V]", errors)]
    return Figure("figure4", "Fig. 4: a 6 Hz sine with the open-loop laws", "time [s]", plots, False, notes)


def feedback_figures(runs: Mapping[str, Trace]) -> list[Figure]:
    """Draw Figs. 5, 6 and 7: reference, errors, voltages of PID, ARC and OARC."""
    traces = {name: runs[f"table1_{name}"] for name in FEEDBACK}
    first = traces["pid"]
    rate = np.gradient(first.command, first.period)
    accel = np.gradient(rate, first.period)
    five = Figure(
        "figure5",
        "Fig. 5: reference trajectory",
        "time [s]",
        [
            Plot("command [V]", [Line("command", first.time, first.command, "black")]),
            Plot("velocity [V/s]", [Line("velocity", first.time, rate, "black")]),
            Plot("acceleration [V/s²]", [Line("acceleration", first.time, accel, "black")]),
        ],
        False,
        [
            f"largest velocity {np.max(np.abs(rate)):.3f} V/s, acceleration {np.max(np.abs(accel)):.2f} V/s² "
            "(the paper: 8 V/s, 64 V/s²); stroke, duration and shape are not printed and are calibrated"
        ],
    )
    errors = [
        Plot(f"{n.upper()} error [V]", [Line(n.upper(), t.time, t.measurement - t.command, LAW_COLOURS[n])])
        for n, t in traces.items()
    ]
    voltages = [
        Plot(f"{n.upper()} voltage [V]", [Line(n.upper(), t.time, t.voltage, LAW_COLOURS[n])])
        for n, t in traces.items()
    ]
    return [
        five,
        Figure("figure6", "Fig. 6: tracking errors", "time [s]", errors, False, []),
        Figure("figure7", "Fig. 7: control inputs", "time [s]", voltages, False, []),
    ]


def figures(runs: Mapping[str, Trace], gain: float, u_max: float) -> list[Figure]:
    """Draw all figures; ``gain`` [V/V]: static, of the valve; ``u_max`` [V]: limit of the amplifier."""
    return [
        figure_1(runs, u_max),
        figure_3(runs, gain, u_max),
        figure_4(runs, gain),
        *feedback_figures(runs),
    ]
