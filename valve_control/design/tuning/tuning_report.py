# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reports what tuning found as one HTML page: verdict in words, front of every law, margins, responses."""

import html
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.analysis import page as pages
from valve_control.control.analysis.figures import COLOURS, Line, Plot
from valve_control.control.laws import linearisation
from valve_control.control.laws.registry import LAWS
from valve_control.control.linear import margins
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.simulation import batch
from valve_control.design.tuning import limit_cycles, limits, pauses, trial, verification
from valve_control.design.tuning.trial import Problem, TuningMotion
from valve_control.design.tuning.tuner import Aim, Tuned
from valve_control.parameter import number, updated

SINE = (10.0, 0.3, 1.0)  # Hz, V, s  of the sine that is shown


def page(
    unseen: Problem,
    aim: Aim,
    found: Mapping[str, Tuned],
    missing: Mapping[str, str],
    laws: Sequence[str],
    written: Mapping[str, str],
    command: str,
) -> str:
    """The report as one page.

    ``laws``: those that were asked for; ``written``: their files; ``command``: what was typed.
    """
    sections = {"Verdict": _verdict(aim, found, missing, laws, written)}
    if found:
        sections["Error against chatter"] = (
            "<p>Each line is the best that was found of one law in the search: error of the true position "
            "(geometric mean over the commands of that of median and 95th percentile over the valves) "
            "against mean chatter c_u. Lower left is better; a ring is the point that was chosen.</p>"
            + _fronts(found)
        )
        sections["On valves that the search did not see"] = _reached(found)
        sections["Margins in the box"] = _margins(unseen, found)
        sections["Limits that sets of gains missed"] = _limits(found)
        sections["Valves in the order of their error"] = _distribution(found)
        sections["Step and sine on a typical valve and on the worst one"] = _responses(unseen, found)
        sections["Parameters"] = _parameters(found)
    sections["How it was made"] = _made(unseen, found, command)
    return pages.page("Tuning", sections)


def _verdict(
    aim: Aim,
    found: Mapping[str, Tuned],
    missing: Mapping[str, str],
    laws: Sequence[str],
    written: Mapping[str, str],
) -> str:
    wanted = "the knee of the front"
    if aim.chatter is not None:
        wanted = f"the least error at c_u of at most {aim.chatter:g}"
    elif aim.error is not None:
        wanted = f"the least chatter at an error of at most {aim.error:g} V"
    reached = {name: verification.as_dict(one.chosen.verified) for name, one in found.items()}
    best = {name: reached[name]["e_rms"]["median"] for name, one in found.items() if one.chosen.holds}
    asked = [name for name in laws if name in best]
    if not asked:
        sentences = [f"No gains are accepted, neither for {' nor for '.join(laws)}."]
        if len(laws) == 1:
            sentences = [f"No gains of {laws[0]} are accepted."]
    elif len(laws) == 1:
        sentences = [f"The gains of {laws[0]} are accepted."]
    else:
        first = min(asked, key=lambda name: best[name])
        sentences = [f"{first} has the least error of the {len(asked)} laws whose gains are accepted."]
    if "pid" in best and len(best) > 1:
        other = min((name for name in best if name != "pid"), key=lambda name: best[name])
        sentences.append(
            f"{other} has {best[other] / best['pid']:.2f} times the error of the best PID, for which the "
            f"same number of gains was tried in each of its forms, at {_ratio(reached, other)} times its "
            "chatter."
        )
    sentences.append(f"Wanted was {wanted}, with the margins below on every valve of the box.")
    bad = []
    for name, one in found.items():
        r = reached[name]
        if one.chosen.holds:
            where = f", written to {written[name]}" if name in written else ""
            beside = "" if name in laws else " (beside the laws that were asked for)"
            sentences.append(
                f"{name}{beside} holds: e_rms {1e3 * best[name]:.1f} mV in the median of {r['valves']} "
                f"valves that the search did not see, {1e3 * r['e_rms']['p95']:.1f} mV at their 95th "
                f"percentile, c_u {r['c_u']:.3f}{where}."
            )
        else:
            bad.append(f"{name} is not accepted: {'; '.join(one.chosen.verified.reasons)}.")
    bad += [f"{name}: {note}." for name, one in found.items() for note in one.notes]
    return pages.paragraphs(sentences) + pages.notes([*bad, *(f"{text}." for text in missing.values())])


def _ratio(reached: Mapping[str, Mapping[str, Any]], name: str) -> str:
    return f"{reached[name]['c_u'] / reached['pid']['c_u']:.2f}"


def _made(unseen: Problem, found: Mapping[str, Tuned], command: str) -> str:
    tried = ", ".join(f"{one.tried} sets of gains of {name}" for name, one in found.items())
    commands = ", ".join(motion.name for motion in unseen.motions)
    return pages.paragraphs(
        [
            f"Tried were {tried or 'sets of gains of which none can be used'}.",
            f"The commands were {commands}; the valves that the search did not see had other noise, and "
            "these commands also turned over and a tenth slower.",
            f"The command line was: {command}",
        ]
    )


def _fronts(found: Mapping[str, Tuned]) -> str:
    lines: list[Line] = []
    for name, one in found.items():
        chatter = np.array([point.chatter for _, point in one.front])
        error = 1e3 * np.array([point.error for _, point in one.front])
        lines.append(Line(name, chatter, error, _colour(len(lines))))
    for i, one in enumerate(found.values()):
        point = one.chosen.point
        there = np.array([point.chatter]), np.array([1e3 * point.error])
        lines.append(Line("chosen", *there, _colour(i)))
    return pages.figure([Plot("error [mV]", lines, logarithmic=True)], "c_u", logarithmic_x=True, height=420)


def _colour(number: int) -> str:
    return COLOURS[number % len(COLOURS)]


def _mV(value: float | None) -> str:
    return "not finite" if value is None else f"{1e3 * value:.2f}"


def _reached(found: Mapping[str, Tuned]) -> str:
    rows = []
    for name, one in found.items():
        r = verification.as_dict(one.chosen.verified)
        rows.append(
            [
                name,
                _mV(r["e_rms"]["median"]),
                _mV(r["e_rms"]["p95"]),
                _mV(r["e_max"]["p95"]),
                "" if r["c_u"] is None else f"{r['c_u']:.3f}",
                f"{100.0 * r['saturated']:.2g} %",
                _mV(r["unseen_commands"]["e_rms"]["median"]),
                str(r["restless"]),
            ]
        )
    head = [
        "law",
        "e_rms [mV]",
        "95 % [mV]",
        "e_M, 95 % [mV]",
        "c_u",
        "saturated",
        "other commands [mV]",
        f"not at rest after {limit_cycles.HELD:g} s",
    ]
    return pages.table(head, rows)


def _margins(unseen: Problem, found: Mapping[str, Tuned]) -> str:
    asked = unseen.limits

    def text(value: float | None, scale: float = 1.0) -> str:
        return "without end" if value is None else f"{scale * value + 0.0:.3g}"

    rows = [
        [
            "wanted",
            f"{asked.gain_db:g}",
            f"{asked.gain_db:g}",
            f"{asked.phase_deg:g}",
            f"{1e3 * asked.delay_s:g}",
            f"{asked.sensitivity_db:g}",
            "",
            f"{asked.swing:g}",
            f"{1e3 * asked.pause_s:g}",
        ]
    ]
    for name, one in found.items():
        worst = margins.as_dict(margins.worst(one.chosen.verified.margins))
        rows.append(
            [
                name,
                text(worst["gain_db"]),
                text(worst["reduction_db"]),
                text(worst["phase_deg"]),
                text(worst["delay_s"], 1e3),
                text(worst["sensitivity_db"]),
                text(worst["response_db"]),
                text(worst["swing_v"]),
                pauses.as_text(one.chosen.verified.pause_s),
            ]
        )
    head = [
        "law",
        "gain up [dB]",
        "down [dB]",
        "phase [deg]",
        "delay [ms]",
        "sensitivity [dB]",
        "response [dB]",
        "swing [V]",
        "pause [ms]",
    ]
    return (
        "<p>The least of each over all valves, of the peaks the largest. Pause: the shortest one of the "
        "command after which the reference does not come back while the motion lasts.</p>"
        + pages.table(head, rows)
    )


def _limits(found: Mapping[str, Tuned]) -> str:
    """How many sets missed each limit, and the best that one reached."""
    lines = [limits.as_text(one.limits, f"sets of gains of {name}") for name, one in found.items()]
    return "".join(f"<pre>{html.escape(chr(10).join(some))}</pre>" for some in lines)


def _distribution(found: Mapping[str, Tuned]) -> str:
    lines = []
    for name, one in found.items():
        values = np.sort(np.exp(np.mean(np.log(one.chosen.verified.seen.e_rms), axis=0)))
        lines.append(Line(name, 100.0 * (np.arange(len(values)) + 1.0) / len(values), 1e3 * values))
    return pages.figure([Plot("e_rms [mV]", lines, logarithmic=True)], "valves [%]", height=300)


def _shown_motions(period: float) -> list[TuningMotion]:
    frequency, amplitude, duration = SINE
    times = np.arange(round(duration / period)) * period
    sine = amplitude * np.sin(2.0 * math.pi * frequency * times)
    return [limit_cycles.steps(period), TuningMotion(f"sine of {frequency:g} Hz", sine)]


def _responses(unseen: Problem, found: Mapping[str, Tuned]) -> str:
    made = ""
    for name, one in found.items():
        law = LAWS[name]
        errors = np.mean(np.nan_to_num(one.chosen.verified.seen.e_rms, nan=np.inf), axis=0)
        order = np.argsort(errors)
        shown = {"typical valve": int(order[len(order) // 2]), "worst valve": int(order[-1])}
        problem = unseen._replace(values=updated(CONTROLLER, unseen.values, one.chosen.variant))
        values = trial.values_with(problem, one.chosen.point.gains)
        params, period = law.build(values), number(values, "sample_period")
        loop = linearisation.behind(values, params)
        for motion in _shown_motions(period):
            sender = problem._replace(preview=problem.preview and motion.name != limit_cycles.STEPS_NAME)
            led = trial.given(law, params, values, one.chosen.point.gains, sender, motion.wanted)
            plants: list[Any] = [unseen.plants[i] for i in shown.values()]
            traces = np.empty((len(plants), len(led), 3))
            seeds = [unseen.seed + i for i in shown.values()]
            batch.simulate(
                batch.Batch(name, loop, batch.records(plants), seeds, motion.wanted, led=led), 1, traces
            )
            times: Floats = np.arange(len(led), dtype=np.float64) * period
            positions = [Line("wanted", times, motion.wanted, "#888888", True)]
            voltages = []
            for i, (text, trace) in enumerate(zip(shown, traces, strict=True)):
                positions.append(Line(text, times, trace[:, 0], _colour(i)))
                voltages.append(Line(text, times, trace[:, 2], _colour(i)))
            plots = [Plot("position [V]", positions), Plot("voltage [V]", voltages)]
            made += f"<p>{name}: {motion.name}</p>" + pages.figure(plots, "time [s]")
    return made


def _parameters(found: Mapping[str, Tuned]) -> str:
    rows: list[list[Any]] = []
    for name, one in found.items():
        for parameter, value in one.chosen.changes.items():
            rows.append([name, parameter, value])
    return pages.table(["law", "parameter", "value"], rows)
