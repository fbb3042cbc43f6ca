# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reports a commissioning as one HTML page: verdict in words, tests, model, gains, verification run."""

import math

import numpy as np

from valve_control.arrays import Complexes, Floats
from valve_control.control.analysis import page as pages
from valve_control.control.analysis.figures import Line, Plot
from valve_control.control.linear import margins
from valve_control.control.parameters.build import as_text
from valve_control.design.commissioning import plant
from valve_control.design.commissioning.bench import Record
from valve_control.design.commissioning.sequence import Result
from valve_control.design.identification import bode, result
from valve_control.design.tuning import limit_cycles, pauses, verification

THIN = 5  # every n-th sample of the slow triangle is drawn


def page(found: Result) -> str:
    """The report as one page."""
    return pages.page(
        "Commissioning",
        {
            "Verdict": _verdict(found),
            "The valve": _valve(found),
            "Slow triangle": _triangle(found),
            "Frequency response": _response(found),
            "Margins in the box": _margins(found),
            "Verification run": _verification(found.verification.record),
            "Parameters that are different from before": _parameters(found),
            "Time": pages.table(["step", "s"], [[name, f"{s:.1f}"] for name, s in found.seconds.items()]),
        },
    )


def _times(record: Record) -> Floats:
    times: Floats = np.arange(len(record.reading), dtype=np.float64) * record.period
    return times


def _verdict(found: Result) -> str:
    made, limits = found.verification, found.plan.limits
    before = found.before["controller"]
    sentences = [
        f"The gains of {found.tuned.law} are accepted and in force: e_rms {1e3 * made.measured.e_rms:.1f} mV "
        f"and c_u {made.measured.c_u:.3f} on the running valve; its simulation says "
        f"{1e3 * made.expected.e_rms:.1f} mV and {made.expected.c_u:.3f}.",
    ]
    if made.former is not None:
        sentences.append(
            f"With the parameters from before ({before}) the simulation of this valve gives "
            f"{1e3 * made.former.e_rms:.1f} mV and c_u {made.former.c_u:.3f} on the same commands."
        )
    if made.before is not None:
        sentences.append(
            f"On the running valve these parameters gave {1e3 * made.before.e_rms:.1f} mV and c_u "
            f"{made.before.c_u:.3f} in the same motion."
        )
    sentences.append(
        f"No voltage was beyond ±{limits.voltage:g} V, and in tests and verification no three readings in a "
        f"row were beyond ±{limits.travel:g} V."
    )
    sentences.append("valve-control commission --undo brings the parameters from before back.")
    return pages.notes([*sentences, *found.notes])


def _valve(found: Result) -> str:
    made, rest = found.plant, found.rest
    rows = [
        ["noise at rest", f"{1e3 * rest.noise:.3g} mV"],
        ["step of the converter", f"{1e3 * rest.resolution:.3g} mV" if rest.resolution else "none seen"],
        ["reading at 0 V", f"{1e3 * rest.position:.3g} mV"],
        ["static gain (slow triangle)", f"{found.static.gain:.4g} V/V"],
        ["static gain (model)", f"{made.model.static_gain:.4g} V/V"],
        ["voltage that holds the spool at 0 V", f"{found.static.offset:.3g} V"],
        ["friction in motion", f"{made.friction.coulomb:.3g} V"],
        ["friction at rest, over that", f"{made.friction.static_ratio:.3g}"],
        ["presliding of its bristles", f"{1e3 * made.presliding:.3g} mV" if made.presliding else "none seen"],
        ["dead zone after a turn", f"{found.static.dead_zone:.3g} V"],
        ["dead time", f"{1e3 * made.delay:.3g} ms"],
        ["poles", result.roots_text(bode.roots(made.model.denominator))],
        ["zeros", result.roots_text(bode.roots(made.model.numerator))],
        ["-90° at", result.hertz(bode.model_corners(made.model, made.delay).minus_90)],
        ["rms residual over what noise and 3 % of the motion allow", f"{made.error:.2g}"],
    ]
    if made.magnet is not None:
        m = made.magnet
        rows += [
            [
                "natural frequency and damping of the spool",
                f"{result.hertz(m.speed / math.tau)}, {m.damping:.3g}",
            ],
            ["time constant of the coil", f"{1e3 * m.coil:.3g} ms"],
            ["hysteresis of the magnet, full width", f"{m.hysteresis:.3g} V"],
            ["gains of the sides over their mean", f"{m.positive:.3g} and {m.negative:.3g}"],
            ["overlap", f"{m.overlap:.3g} V"],
        ]
    return pages.table(["", ""], rows)


def _triangle(found: Result) -> str:
    record = found.slow
    shown = slice(None, None, THIN)
    time = _times(record)
    model = plant.simulated(found.plant, record)
    return pages.figure(
        [
            Plot("voltage [V]", [Line("voltage", time[shown], record.voltage[shown])]),
            Plot(
                "position [V]",
                [
                    Line("reading", time[shown], record.reading[shown]),
                    Line("model", time[shown], model[shown], dashed=True),
                ],
            ),
        ],
        "time [s]",
    )


def _response(found: Result) -> str:
    seen = found.response
    frequency = np.geomspace(seen.frequency[0], seen.frequency[-1], 300)
    value = bode.held_response(found.plant.model, frequency, seen.period, found.plant.delay)

    def decibel(v: Complexes) -> Floats:
        size: Floats = 20.0 * np.log10(np.abs(v))
        return size

    def degrees(v: Complexes) -> Floats:
        turn: Floats = np.degrees(np.unwrap(np.angle(v)))
        return turn

    return (
        "<p>Measured: the first harmonic, friction taken out as a square wave; near 0 Hz the spool sticks at "
        "each turn, which the model knows and this response does not.</p>"
        + pages.figure(
            [
                Plot(
                    title,
                    [
                        Line("measured", seen.frequency, turn(seen.value)),
                        Line("model", frequency, turn(value), dashed=True),
                    ],
                )
                for title, turn in (("[dB]", decibel), ("[deg]", degrees))
            ]
            + [Plot("coherence", [Line("measured", seen.frequency, seen.coherence)])],
            "frequency [Hz]",
            logarithmic_x=True,
        )
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
    pause = pauses.as_text(found.tuned.chosen.verified.pause_s)
    texts.append(["pause of the command after which the reference does not come back [ms]", pause])
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


def _parameters(found: Result) -> str:
    rows = [[name, as_text(found.before[name]), as_text(value)] for name, value in found.applied.items()]
    return pages.table(["parameter", "before", "now"], rows)
