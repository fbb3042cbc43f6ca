# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m research.late_commands``: the gains of config/tuned under an upper level that pauses.

Bare commands and trajectories, at 1 kHz and at 100 Hz, with and without pauses of 3 to 10 ms, five a second.
Prints a table of docs/howto/cascade.md as Markdown.
"""

import argparse
import math
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from research import running
from valve_control.cli.common import Parser, write_json

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from valve_control.control.supervision.command_course import Motion
    from valve_control.parameter import Values

VALVES = ("d3fxe", "d3fxe_experiment")
LAWS = ("arc", "oarc", "dcarc", "pid")
SINES = ((1.0, 3.0), (0.3, 9.0), (0.1, 15.0))  # V, Hz
FADE = 0.3  # s  in which they begin
SETTLED = 400  # samples
SAMPLES = 4000
PAUSES = (0.003, 0.01)  # s  the shortest and the longest
PER_SECOND = 5


class Upper(NamedTuple):
    """An upper level."""

    trajectory: bool  # whether it sends its derivatives too
    every: int  # samples from one message to the next
    queued: bool = False  # whether what it would have sent in a pause comes after it, all at once


class Outcome(NamedTuple):
    """A run after its beginning."""

    peak: float  # V  of the voltage
    chatter: float  # -  c_u
    error: float  # V  true rms error
    limited: float  # -  share of the samples with the largest voltage


def motion(time: float) -> "Motion":
    """The wanted motion at ``time`` [s]: sines that fade in, and their derivatives."""
    from valve_control.control.supervision.command_course import Motion

    s = min(1.0, time / FADE)
    inside = 1.0 if s < 1.0 else 0.0
    ease, rate, bend = s * s * (3.0 - 2.0 * s), inside * 6.0 * s * (1.0 - s) / FADE, 0.0
    bend = inside * (6.0 - 12.0 * s) / FADE**2
    x = v = a = 0.0
    for amplitude, frequency in SINES:
        w = 2.0 * math.pi * frequency
        x += amplitude * math.sin(w * time)
        v += amplitude * w * math.cos(w * time)
        a -= amplitude * w * w * math.sin(w * time)
    return Motion(ease * x, rate * x + ease * v, bend * x + 2.0 * rate * v + ease * a)


def sent(upper: Upper, pauses: bool, period: float) -> "tuple[list[float], list[float]]":
    """Times of sending and of arrival [s] of the messages of ``upper``."""
    import numpy as np

    step = upper.every * period
    due = np.arange(0.0, SAMPLES * period - 1e-9, step)
    if not pauses:
        return due.tolist(), due.tolist()
    random = np.random.default_rng(7)
    free = 1.0 / PER_SECOND
    begins = (np.arange(1.0, SAMPLES * period * PER_SECOND) + random.uniform(-0.3, 0.3)) * free
    arrivals = due.copy()
    for begin, length in zip(begins, random.uniform(*PAUSES, len(begins)), strict=True):
        if upper.every > 1:  # a pause meets the next message
            begin = due[min(np.searchsorted(due, begin), len(due) - 1)] - 0.5 * period
        paused = (due > begin) & (due < begin + length)
        arrivals[paused] = begin + length
    if upper.queued:
        return due.tolist(), arrivals.tolist()
    # It goes on with the motion of the present: of those that were held up one is sent.
    times = np.unique(arrivals)
    return times.tolist(), times.tolist()


def run(settings: "dict[str, Values]", upper: Upper, pauses: bool) -> "npt.NDArray[np.float64]":
    """Rows of voltage, true position and wanted position [V], one a sample."""
    import numpy as np

    from valve_control.control.parameters import build
    from valve_control.control.plant import valve
    from valve_control.control.supervision.supervisor import Supervisor
    from valve_control.parameter import number

    values = settings["controller"]
    period = number(values, "sample_period")
    supervisor = Supervisor()
    supervisor.apply(values, build.law_params(values))
    p = build.valve_params(settings["valve_simulator"])
    s = valve.initial(p)
    random = np.random.default_rng(5)
    times, arrivals = sent(upper, pauses, period)
    at, last, rows = 0, -1.0, []
    for k in range(SAMPLES):
        now = k * period
        while at < len(times) and arrivals[at] <= now + 1e-9:
            wanted, interval = motion(times[at]), times[at] - last if at else 0.0
            if upper.trajectory:
                supervisor.trajectory(wanted, interval)
            else:
                supervisor.command(wanted.position, interval if supervisor.joins else 0.0)
            last = times[at]
            at += 1
        voltage = supervisor.sample(valve.read(p, s, float(random.standard_normal())), k + 1)
        rows.append((voltage, s.x.x0, motion(now).position))
        s = valve.step(p, s, voltage)
    return np.array(rows)


def measured(valve: str, law: str, upper: Upper, pauses: bool, **changes: "str | float") -> Outcome:
    """The gains of ``law`` on the valve that they are for; ``changes`` of the controller, ``__`` for dots."""
    import numpy as np

    from valve_control.control.analysis.indices import rms
    from valve_control.control.parameters import files
    from valve_control.control.parameters.table import NODES
    from valve_control.parameter import defaults, updated

    config = files.config_folder()
    settings = {node: defaults(table) for node, table in NODES.items()}
    for path in (config / f"{valve}.yaml", config / "tuned" / f"{valve}_{law}.yaml"):
        for node, given in files.load(str(path)).items():
            settings[node] = updated(NODES[node], settings[node], given)
    changed = {name.replace("__", "."): value for name, value in changes.items()}
    settings["controller"] = updated(NODES["controller"], settings["controller"], changed)
    voltage, position, wanted = run(settings, upper, pauses)[SETTLED:].T
    peak = float(np.max(np.abs(voltage)))
    return Outcome(
        peak,
        rms(np.diff(voltage)) / rms(voltage),
        rms(position - wanted),
        float(np.mean(np.abs(voltage) >= 9.999)),
    )


def table(rows: "dict[tuple[str, str, Upper, str], tuple[Outcome, Outcome, Outcome]]") -> list[str]:
    """Rows of Markdown: each case without pauses, with pauses that are not bridged, and bridged."""
    heads = ["gains", "upper level", "peak [V]", "$c_u$", "true rms error [mV]"]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for (valve, law, upper, kind), found in rows.items():
        sender = f"{'trajectory' if upper.trajectory else 'command'}, {1000 // upper.every} Hz, `{kind}`"
        peaks = ", ".join(f"{one.peak:.1f}" for one in found)
        chatter = ", ".join(f"{one.chatter:.2f}" for one in found)
        errors = ", ".join(f"{1e3 * one.error:.0f}" for one in found)
        lines.append(f"| `{valve}_{law}.yaml` | {sender} | {peaks} | {chatter} | {errors} |")
    return lines


def case(valve: str, law: str, upper: Upper, kind: str) -> tuple[Outcome, Outcome, Outcome]:
    """Without pauses; with pauses that are not bridged; with pauses that are."""
    without = "hold" if kind == "bridge" else kind  # what is there where nothing is bridged
    return (
        measured(valve, law, upper, False, command__interpolation=kind),
        measured(valve, law, upper, True, command__interpolation=without, command__bridge=0.0),
        measured(valve, law, upper, True, command__interpolation=kind),
    )


def _options() -> Parser:
    parser = running.options("late_commands", "The gains of config/tuned under an upper level that pauses.")
    parser.add_argument("--queued", action="store_true", help="what was held up in a pause comes after it")
    return parser


def _pausing(arguments: argparse.Namespace) -> None:
    rows = {}
    for valve in VALVES:
        for law in LAWS:
            for trajectory in (False, True):
                for every, kind in ((1, "hold"), (10, "hold"), (10, "bridge")):
                    if kind == "hold" and every > 1 and not trajectory:
                        continue  # a staircase is at the limit of the voltage without pauses, too
                    upper = Upper(trajectory, every, arguments.queued)
                    rows[valve, law, upper, kind] = case(valve, law, upper, kind)
    if arguments.json != "-":
        print("\n".join(table(rows)))
    write_json(arguments, {str(key): [one._asdict() for one in found] for key, found in rows.items()})


def main(argv: Sequence[str] | None = None) -> int:
    """Run the measurement; returns the exit status."""
    return running.run(_options(), _pausing, argv)


if __name__ == "__main__":
    sys.exit(main())
