# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reports a commissioning as one HTML page: verdict in words, tests, model, gains, verification run."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.analysis import page as pages
from valve_control.control.analysis.figures import COLOURS, Line, Plot
from valve_control.control.analysis.indices import Indices
from valve_control.control.parameters.ros_file import as_text
from valve_control.control.parameters.table import VALVE
from valve_control.design.commissioning import valve_fit
from valve_control.design.commissioning.bench import Record
from valve_control.design.commissioning.sequence import Result
from valve_control.design.identification import bode, result
from valve_control.design.tuning import checks, limits, verification
from valve_control.parameter import number

THIN = 5  # every n-th sample of the slow triangle is drawn


def page(found: Result) -> str:
    """The report as one page."""
    changes = [[name, as_text(found.before[name]), as_text(value)] for name, value in found.applied.items()]
    run = found.verification.record
    model = valve_fit.simulated(found.tests.plant, found.tests.slow)
    return pages.page(
        "Commissioning",
        {
            "Verdict": _verdict(found),
            "The valve": _valve(found),
            "Slow triangle": _figure(found.tests.slow, slice(None, None, THIN), "model", model),
            "Frequency response": _response(found),
            "Margins in the box": _margins(found),
            "Verification run": _figure(run, slice(None), "command", run.command),
            "Parameters that are different from before": pages.table(["parameter", "before", "now"], changes),
            "Time": _table({name: f"{seconds:.1f} s" for name, seconds in found.seconds.items()}),
        },
    )


def _table(rows: Mapping[str, Any]) -> str:
    return pages.table(["", ""], [[name, str(value)] for name, value in rows.items()])


def _verdict(found: Result) -> str:
    run, within = found.verification, found.plan.limits

    def reached(indices: Indices) -> str:
        return f"{1e3 * indices.e_rms:.1f} mV and c_u {indices.c_u:.3f}"

    sentences = [
        f"The gains of {found.tuned.law} are accepted and in force: e_rms {reached(run.measured)} on the "
        f"running valve; its simulation says {reached(run.expected)}.",
    ]
    if run.former is not None:
        sentences.append(
            f"With the previous parameters ({found.before['controller']}) the simulation of this valve "
            f"gives {reached(run.former)} on the same commands."
        )
    sentences.append(
        f"No voltage was beyond ±{within.voltage:g} V, and in tests and verification no three readings in a "
        f"row were beyond ±{within.travel:g} V."
    )
    sentences.append("valve-control commission --undo restores the previous parameters.")
    return pages.notes(sentences, "text") + pages.notes(found.notes)


def _valve(found: Result) -> str:
    rest, static, valve = found.tests.rest, found.tests.static, found.tests.plant
    corners = bode.model_corners(valve.model, valve.delay)
    rows = {
        "-90° at": result.hertz(corners.minus_90),
        "-3 dB at": result.hertz(corners.minus_3db),
        "hysteresis as in a data sheet": f"{100.0 * valve.hysteresis / 10.0:.1f} % of 10 V",
        "noise at rest": f"{1e3 * rest.noise:.3g} mV",
        "step of the converter": f"{1e3 * rest.resolution:.3g} mV",
        "reading at 0 V": f"{1e3 * rest.position:z.1f} mV",
        "static gain": f"{valve.model.static_gain:.4g} V/V",
        "voltage that holds the spool at 0 V": f"{static.offset:z.2f} V",
        "friction in motion": f"{valve.friction.coulomb:.3g} V",
        "friction at rest, over that in motion": f"{valve.friction.static_ratio:.3g}",
        "elastic travel before the spool slides": f"{1e3 * valve.presliding:.3g} mV",
        "dead time in all": f"{1e3 * valve.delay:z.2f} ms",
        "poles": result.roots_text(bode.roots(valve.model.denominator)),
        "zeros": result.roots_text(bode.roots(valve.model.numerator)),
        "rms residual over what noise and 3 % of the motion allow (below 1 is good)": f"{valve.error:.2g}",
    }
    if valve.magnet is not None:
        own = valve_fit.solenoid_values(valve.magnet, found.plan.sensor_delay)
        for p in VALVE:
            if p.name.startswith("solenoid.") and p.name in own:
                factor, unit = (1e3, "ms") if p.unit == "s" else (1.0, p.unit)
                rows[f"{p.text} ({p.name})"] = f"{factor * number(own, p.name):.3g} {unit}".removesuffix(" -")
    return _table(rows)


def _figure(record: Record, shown: slice, name: str, other: Any) -> str:
    """Reading, ``other`` position [V] of this ``name``, their difference and voltage."""
    time: Floats = (np.arange(len(record.reading), dtype=np.float64) * record.period)[shown]
    reading, other = record.reading[shown], other[shown]
    plots = [
        Plot("position [V]", [Line("reading", time, reading), Line(name, time, other, "black", "--")]),
        Plot("difference [V]", [Line(f"reading - {name}", time, reading - other, COLOURS[1])]),
        Plot("voltage [V]", [Line("voltage", time, record.voltage[shown], COLOURS[2])]),
    ]
    return pages.figure(plots, "time [s]")


def _response(found: Result) -> str:
    measured, valve = found.tests.response, found.tests.plant
    frequency = np.geomspace(measured.frequency[0], measured.frequency[-1], 300)
    value = bode.held_response(valve.model, frequency, measured.period, valve.delay)
    plots = []
    for title, read in (("[dB]", bode.decibels), ("[deg]", bode.degrees)):
        model = Line("model", frequency, read(value), style="--")
        plots.append(Plot(title, [Line("measured", measured.frequency, read(measured.value)), model]))
    plots.append(Plot("coherence", [Line("measured", measured.frequency, measured.coherence)]))
    return (
        "<p>Measured: the first harmonic, without the voltage that Coulomb friction takes; near 0 Hz the "
        "spool sticks at each turn, which the model knows and this response does not.</p>"
        + pages.figure(plots, "frequency [Hz]", logarithmic_x=True)
    )


def _margins(found: Result) -> str:
    verified = found.tuned.chosen.verified
    unseen, rows = verification.as_dict(verified), {}
    for name, worst in limits.worst(limits.of_margins(verified.margins)).items():
        rows[f"{name} [{limits.BY_NAME[name].unit or '-'}]"] = limits.BY_NAME[name].scale * worst
    for share, error in unseen["e_rms"].items():
        rows[f"e_rms, {share} of {unseen['valves']} valves [V]"] = error
    rows[f"valves that do not rest within {checks.HELD:g} s"] = unseen["restless"]
    texts = {name: f"{v:.3g}" if np.isfinite(v) else "without end" for name, v in rows.items()}
    return "<p>The least over a box around this valve.</p>" + _table(texts)
