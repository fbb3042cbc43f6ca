# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m research.solenoid``: the solenoid valves of config/solenoid on a slow loop, a step and sines.

Prints the table of docs/explanation/valve_model.md as Markdown, and draws its figure.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from research import running
from valve_control.cli.common import Parser, check_outputs, write_json
from valve_control.control.plant import solenoid

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]

PERIOD = 0.0001  # s
HEIGHT = 5.0  # V  of loop and step
SLOW = 20.0  # s  of the loop from end to end
STEP = 0.15  # s
SINE = 2.5  # V  amplitude: above the friction of each of the valves
CYCLES = 8  # of each sine; the last half counts
FREQUENCIES = 30
LOWEST, HIGHEST = 1.0, 500.0  # Hz


class Measured(NamedTuple):
    """One valve."""

    width: float  # V  of the loop at 0 V, at the output
    rise: float  # s  0 to 90 % of the step
    minus_3db: float  # Hz
    minus_90: float  # Hz
    loop: tuple["Array", "Array"]  # V  voltage and position
    step: "Array"  # V  position at each PERIOD
    frequency: "Array"  # Hz
    gain: "Array"  # dB  over that at LOWEST
    phase: "Array"  # °


def measured(path: Path) -> Measured:
    """The valve of a parameter file. Raises ParameterError."""
    import numpy as np

    from valve_control.control.parameters import build, files
    from valve_control.control.parameters.table import VALVE
    from valve_control.parameter import defaults, updated

    given = files.load(str(path))["valve_simulator"]
    p = build.valve_params(updated(VALVE, defaults(VALVE), {**given, "sample_period": PERIOD}))
    quarter = np.linspace(0.0, HEIGHT, round(SLOW / 2.0 / PERIOD), endpoint=False)
    n = len(quarter)
    u = np.concatenate([quarter, HEIGHT - quarter, -quarter, quarter - HEIGHT, quarter])
    x = _positions(p, u)
    width = float(x[2 * n] - x[4 * n])
    step = _positions(p, np.full(round(STEP / PERIOD), HEIGHT))
    cycles = np.round(1.0 / (PERIOD * np.geomspace(LOWEST, HIGHEST, FREQUENCIES)))  # whole samples
    frequency = 1.0 / (PERIOD * cycles)
    response = np.array([_response(p, float(f)) for f in frequency])
    gain = 20.0 * np.log10(np.abs(response) / np.abs(response[0]))
    phase = np.degrees(np.unwrap(np.angle(response)))
    return Measured(
        width=width,
        rise=float(np.argmax(step >= 0.9 * step[-1])) * PERIOD,
        minus_3db=_crossing(frequency, gain, -3.0),
        minus_90=_crossing(frequency, phase, -90.0),
        loop=(u[n:], x[n:]),
        step=step,
        frequency=frequency,
        gain=gain,
        phase=phase,
    )


def moved(p: solenoid.Params, state: solenoid.State, voltages: "Array", positions: "Array") -> None:
    """Position [V] at each sample under ``voltages`` [V]."""
    for k in range(len(voltages)):
        positions[k] = state.x.x0
        state = solenoid.step(p, state, voltages[k])


def _positions(p: solenoid.Params, voltages: "Array") -> "Array":
    """Position [V] at each sample under ``voltages`` [V], from rest."""
    import numpy as np

    from valve_control.control.compiling import compile_function

    made = np.empty(len(voltages))
    compile_function(moved)(p, solenoid.initial(p), voltages, made)
    return made


def _response(p: solenoid.Params, frequency: float) -> complex:
    """First harmonic of the position over a sine of SINE at ``frequency`` [Hz]."""
    import numpy as np

    cycle = round(1.0 / (frequency * PERIOD))
    turns = 2.0 * np.pi * np.arange(CYCLES * cycle) / cycle
    x = _positions(p, SINE * np.sin(turns))
    half = CYCLES * cycle // 2
    return complex(2j * np.mean(x[half:] * np.exp(-1j * turns[half:])) / SINE)


def _crossing(frequency: "Array", values: "Array", level: float) -> float:
    """First frequency [Hz] at which falling ``values`` pass ``level``; NaN if they do not."""
    import numpy as np

    below = np.flatnonzero(values < level)
    if len(below) == 0 or below[0] == 0:
        return float("nan")
    i = below[0]
    share = (values[i - 1] - level) / (values[i - 1] - values[i])
    return float(frequency[i - 1] * (frequency[i] / frequency[i - 1]) ** share)


def table(found: dict[str, Measured]) -> list[str]:
    """Rows of Markdown, one for each valve."""
    lines = ["| valve | hysteresis [%] | 0 to 90 % [ms] | -3 dB [Hz] | -90° [Hz] |", "|---|---|---|---|---|"]
    for name, one in found.items():
        width = 100.0 * one.width / 20.0
        figures = f"{width:.2f} | {1e3 * one.rise:.1f} | {one.minus_3db:.3g} | {one.minus_90:.3g}"
        lines.append(f"| `{name}` | {figures} |")
    return lines


def draw(path: Path, found: dict[str, Measured]) -> None:
    """Loop, step and frequency response of each valve. Raises OSError if ``path`` cannot be written."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    import numpy as np

    from valve_control.control.analysis.figures import COLOURS, save

    figure, ((loop, step), (gain, phase)) = plt.subplots(2, 2, figsize=(10.0, 7.5))
    for colour, (name, one) in zip(COLOURS, found.items(), strict=False):
        u, x = one.loop
        loop.plot(u[::50], x[::50], color=colour, lw=0.9, label=name)
        step.plot(1e3 * PERIOD * np.arange(len(one.step)), one.step, color=colour, lw=1.2)
        gain.semilogx(one.frequency, one.gain, color=colour, lw=1.2)
        seen = one.gain > -50.0  # below, the phase is that of rounding and of the bristles
        phase.semilogx(one.frequency[seen], one.phase[seen], color=colour, lw=1.2)
    titles = (
        (loop, "voltage [V]", "position [V]"),
        (step, "time [ms]", "position [V]"),
        (gain, "frequency [Hz]", "gain [dB]"),
        (phase, "frequency [Hz]", "phase [°]"),
    )
    for axes, below, beside in titles:
        axes.set_xlabel(below)
        axes.set_ylabel(beside)
        axes.grid(True, which="both", alpha=0.3)
    gain.set_ylim(-30.0, 6.0)
    phase.set_ylim(-270.0, 0.0)
    gain.axhline(-3.0, color="grey", lw=0.8)
    phase.axhline(-90.0, color="grey", lw=0.8)
    figure.legend(*loop.get_legend_handles_labels(), loc="upper center", ncols=len(found), frameon=False)
    figure.tight_layout(rect=(0.0, 0.0, 1.0, 0.96))
    save(figure, path)


def _options() -> Parser:
    parser = running.options("solenoid", "The valves of config/solenoid: slow loop, step and sines.")
    parser.add_argument("--figure", metavar="FILE", help="figure, .png or .svg")
    return parser


def _solenoid(arguments: argparse.Namespace) -> None:
    from valve_control.control.parameters import ros_file

    check_outputs(arguments)
    paths = sorted((ros_file.config_folder() / "solenoid").glob("*.yaml"))
    found = {path.stem: measured(path) for path in paths}
    if arguments.json != "-":
        print("\n".join(table(found)))
    if arguments.figure:
        draw(Path(arguments.figure), found)
    shown = ("width", "rise", "minus_3db", "minus_90")
    write_json(arguments, {name: {key: getattr(one, key) for key in shown} for name, one in found.items()})


def main(argv: Sequence[str] | None = None) -> int:
    """Run the measurement; returns the exit status."""
    return running.run(_options(), _solenoid, argv)


if __name__ == "__main__":
    sys.exit(main())
