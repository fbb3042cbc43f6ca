# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reports a commissioning as one HTML page: verdict in words, tests, model, gains, verification run."""

import math

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.analysis import page as pages
from valve_control.control.analysis.figures import Line, Plot
from valve_control.control.analysis.indices import Indices
from valve_control.control.linear import margins
from valve_control.control.parameters.ros_file import as_text
from valve_control.design.commissioning import plant
from valve_control.design.commissioning.bench import Record
from valve_control.design.commissioning.sequence import Result
from valve_control.design.identification import bode, result
from valve_control.design.tuning import limit_cycles, verification

THIN = 5  # every n-th sample of the slow triangle is drawn


def page(found: Result) -> str:
    """The report as one page."""
    times = [[name, f"{seconds:.1f}"] for name, seconds in found.seconds.items()]
    changes = [[name, as_text(found.before[name]), as_text(value)] for name, value in found.applied.items()]
    return pages.page(
        "Commissioning",
        {
            "Verdict": _verdict(found),
            "The valve": _valve(found),
            "Slow triangle": _triangle(found),
            "Frequency response": _response(found),
            "Margins in the box": _margins(found),
            "Verification run": _verification(found.verification.record),
            "Parameters that are different from before": pages.table(["parameter", "before", "now"], changes),
            "Time": pages.table(["step", "s"], times),
        },
    )


def _times(record: Record) -> Floats:
    times: Floats = np.arange(len(record.reading), dtype=np.float64) * record.period
    return times


def _verdict(found: Result) -> str:
    run, limits = found.verification, found.plan.limits

    def reached(indices: Indices) -> str:
        return f"{1e3 * indices.e_rms:.1f} mV and c_u {indices.c_u:.3f}"

    sentences = [
        f"The gains of {found.tuned.law} are accepted and in force: e_rms {reached(run.measured)} on the "
        f"running valve; its simulation says {reached(run.expected)}.",
    ]
    if run.former is not None:
        sentences.append(
            f"With the parameters from before ({found.before['controller']}) the simulation of this valve "
            f"gives {reached(run.former)} on the same commands."
        )
    if run.before is not None:
        sentences.append(
            f"On the running valve these parameters gave {reached(run.before)} in the same motion."
        )
    sentences.append(
        f"No voltage was beyond ±{limits.voltage:g} V, and in tests and verification no three readings in a "
        f"row were beyond ±{limits.travel:g} V."
    )
    sentences.append("valve-control commission --undo brings the parameters from before back.")
    return pages.notes([*sentences, *found.notes])


def _valve(found: Result) -> str:
    rest, static, valve = found.tests.rest, found.tests.static, found.tests.plant
    rows = [
        ["noise at rest", f"{1e3 * rest.noise:.3g} mV"],
        ["step of the converter", f"{1e3 * rest.resolution:.3g} mV" if rest.resolution else "none seen"],
        ["reading at 0 V", f"{1e3 * rest.position:.3g} mV"],
        ["static gain (slow triangle)", f"{static.gain:.4g} V/V"],
        ["static gain (model)", f"{valve.model.static_gain:.4g} V/V"],
        ["voltage that holds the spool at 0 V", f"{static.offset:.3g} V"],
        ["friction in motion", f"{valve.friction.coulomb:.3g} V"],
        ["friction at rest, over that", f"{valve.friction.static_ratio:.3g}"],
        [
            "presliding of its bristles",
            f"{1e3 * valve.presliding:.3g} mV" if valve.presliding else "none seen",
        ],
        ["dead zone after a turn", f"{static.dead_zone:.3g} V"],
        ["dead time", f"{1e3 * valve.delay:.3g} ms"],
        ["poles", result.roots_text(bode.roots(valve.model.denominator))],
        ["zeros", result.roots_text(bode.roots(valve.model.numerator))],
        ["-90° at", result.hertz(bode.model_corners(valve.model, valve.delay).minus_90)],
        ["rms residual over what noise and 3 % of the motion allow", f"{valve.error:.2g}"],
    ]
    if valve.magnet is not None:
        m = valve.magnet
        spool = f"{result.hertz(m.speed / math.tau)}, {m.damping:.3g}"
        rows += [
            ["natural frequency and damping of the spool", spool],
            ["time constant of the coil", f"{1e3 * m.coil:.3g} ms"],
            ["hysteresis of the magnet, full width", f"{m.hysteresis:.3g} V"],
            ["gains of the sides over their mean", f"{m.positive:.3g} and {m.negative:.3g}"],
            ["overlap", f"{m.overlap:.3g} V"],
        ]
    return pages.table(["", ""], rows)


def _triangle(found: Result) -> str:
    record, shown = found.tests.slow, slice(None, None, THIN)
    time, model = _times(record)[shown], plant.simulated(found.tests.plant, record)[shown]
    positions = [
        Line("reading", time, record.reading[shown]),
        Line("model", time, model, dashed=True),
    ]
    voltage = Plot("voltage [V]", [Line("voltage", time, record.voltage[shown])])
    return pages.figure([voltage, Plot("position [V]", positions)], "time [s]")


def _response(found: Result) -> str:
    measured, valve = found.tests.response, found.tests.plant
    frequency = np.geomspace(measured.frequency[0], measured.frequency[-1], 300)
    value = bode.held_response(valve.model, frequency, measured.period, valve.delay)
    plots = [
        Plot(
            title,
            [
                Line("measured", measured.frequency, read(measured.value)),
                Line("model", frequency, read(value), dashed=True),
            ],
        )
        for title, read in (("[dB]", bode.decibels), ("[deg]", bode.degrees))
    ]
    plots.append(Plot("coherence", [Line("measured", measured.frequency, measured.coherence)]))
    return (
        "<p>Measured: the first harmonic, friction taken out as a square wave; near 0 Hz the spool sticks at "
        "each turn, which the model knows and this response does not.</p>"
        + pages.figure(plots, "frequency [Hz]", logarithmic_x=True)
    )


def _margins(found: Result) -> str:
    worst = margins.as_dict(margins.worst(found.tuned.chosen.verified.margins))
    unseen = verification.as_dict(found.tuned.chosen.verified)
    rows: list[tuple[str, float | None]] = [
        ("gain up [dB]", worst["gain_db"]),
        ("gain down [dB]", worst["reduction_db"]),
        ("phase [deg]", worst["phase_deg"]),
        ("delay [ms]", None if worst["delay_s"] is None else 1e3 * worst["delay_s"]),
        ("peak of the sensitivity [dB]", worst["sensitivity_db"]),
        ("swing about rest that friction sustains in the loop [V]", worst["swing_v"]),
        (f"e_rms, median of {unseen['valves']} valves [mV]", 1e3 * (unseen["e_rms"]["median"] or np.nan)),
        ("e_rms, 95 % [mV]", 1e3 * (unseen["e_rms"]["p95"] or np.nan)),
        (f"valves that do not rest within {limit_cycles.HELD:g} s", unseen["restless"]),
    ]
    texts = [[name, "without end" if v is None else f"{v:.3g}"] for name, v in rows]
    return "<p>The least over a box around this valve.</p>" + pages.table(["", ""], texts)


def _verification(record: Record) -> str:
    time = _times(record)
    return pages.figure(
        [
            Plot(
                "position [V]", [Line("command", time, record.command), Line("reading", time, record.reading)]
            ),
            Plot("error [V]", [Line("error", time, record.reading - record.command)]),
            Plot("voltage [V]", [Line("voltage", time, record.voltage)]),
        ],
        "time [s]",
    )
