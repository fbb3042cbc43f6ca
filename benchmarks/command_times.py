# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks.command_times``: an upper level with a clock of its own, beside commands in time.

The gains of config/tuned on their valves, or (--commissioned) those that commissioning leaves on solenoid
valves, under strokes of 40 V/s, sines, and steps. The commands come at 1000, 500, 200 and 100 Hz, by clocks
that drift, with jitter, with late messages and with pauses. Each figure is the ratio to the same motion with
commands in time at the same rate: true rms error, c_u and largest voltage. Prints a table of
docs/explanation/command_course.md as Markdown.

With --dds the tuned gains run over DDS: controller, simulator and command source are processes with timers of
their own. Each figure is the ratio to the offline run with commands in time, with the error of the readings.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks import solenoid
from research import running
from valve_control.arrays import Floats
from valve_control.cli.common import Parser, write_json
from valve_control.control.analysis.indices import rms
from valve_control.control.commands import scenarios
from valve_control.control.parameters import build, files, ros_file
from valve_control.control.parameters.table import NODES
from valve_control.control.simulation import offline
from valve_control.control.simulation.delivery import Delivery
from valve_control.parameter import Values, defaults, updated

VALVES, LAWS = ("d3fxe", "d3fxe_experiment"), ("arc", "oarc", "dcarc", "pid")
SECONDS, SETTLED = 8.0, 1.2  # s
JITTER, LATE, PAUSE = 0.0007, 0.02, 0.006
STROKE = scenarios.Shape("point_to_point", 1.5, 0.0, 0.25, 1.0, 1.0, 40.0, 2500.0, 0.5, 1.0)
RATES = (1000, 500, 200, 100)  # Hz
DELIVERIES = {
    "0 ppm": Delivery(0.001),
    "100 ppm": Delivery(0.001, drift=1e-4),
    "1000 ppm": Delivery(0.001, drift=1e-3),
    "1000 ppm, jitter": Delivery(0.001, JITTER, drift=1e-3),
    "the same, 2 % late": Delivery(0.001, JITTER, drift=1e-3, late=LATE),
    "the same, pauses": Delivery(0.001, JITTER, drift=1e-3, late=LATE, pause=PAUSE),
}
ALL = "the same, pauses"
LIMITS = (1.25, 1.3, 1.2)  # of the three ratios


class Case(NamedTuple):
    """A controller and its valve."""

    name: str
    controller: Values
    valve: Values


class Outcome(NamedTuple):
    """A run after its beginning."""

    error: float  # V  true rms error
    chatter: float  # -  c_u
    peak: float  # V  of the voltage


def motions(rate: int) -> dict[str, Floats]:
    """Wanted motions [V], one entry a sample; a period of a sine has 20 commands at ``rate`` [Hz]."""
    t = np.arange(round(SECONDS / 0.001)) * 0.001
    ease = np.minimum(1.0, t / 0.3)
    ease *= ease * (3.0 - 2.0 * ease)
    fastest = min(15.0, rate / 20.0)
    sines = ((1.0, fastest / 5.0), (0.3, 0.6 * fastest), (0.1, fastest))
    return {
        "strokes": np.array([scenarios.command(STROKE, time) for time in t]),
        "sines": ease * sum(a * np.sin(2.0 * np.pi * f * t) for a, f in sines),
        "steps": 0.5 * (np.floor(t / 0.4) % 2.0),
    }


def tuned() -> list[Case]:
    """The eight sets of gains of config/tuned for the valves of config/."""
    config, cases = ros_file.config_folder(), []
    for valve in VALVES:
        for law in LAWS:
            settings = {node: defaults(table) for node, table in NODES.items()}
            for path in (config / f"{valve}.yaml", config / "tuned" / f"{valve}_{law}.yaml"):
                for node, values in files.load(str(path)).items():
                    settings[node] = updated(NODES[node], settings[node], values)
            cases.append(Case(f"{valve}_{law}", settings["controller"], settings["valve_simulator"]))
    return cases


def commissioned(seeds: Sequence[int], budget: int) -> list[Case]:
    """Solenoid valves of benchmarks.solenoid with the gains that commissioning leaves."""
    cases = []
    for seed in seeds:
        valve = solenoid.drawn(seed)
        result, _ = solenoid.commissioned(valve, "dcarc", solenoid.Options(budget, 0))
        print(f"valve {seed}: {'accepted' if result['accepted'] else result['reason']}", file=sys.stderr)
        if result["accepted"]:
            values = updated(NODES["controller"], defaults(NODES["controller"]), result["applied"])
            cases.append(Case(f"solenoid_{seed}", values, valve))
    return cases


def measured(case: Case, wanted: Floats, delivered: Delivery) -> Outcome:
    """A run of ``case`` under the motion ``wanted`` [V]."""
    run = offline.simulate(case.controller, case.valve, wanted, alone=True, delivered=delivered)
    begin = round(SETTLED / run.period)
    voltage, error = run.voltage[begin:], (run.position - run.command)[begin:]
    return Outcome(rms(error), rms(np.diff(voltage)) / rms(voltage), float(np.max(np.abs(voltage))))


def ratios(case: Case, rate: int, name: str) -> dict[str, tuple[float, float, float]]:
    """Of each motion: error, c_u and largest voltage over those with commands in time at this ``rate``."""
    found = {}
    for motion, wanted in motions(rate).items():
        even = measured(case, wanted, Delivery(1.0 / rate))
        one = measured(case, wanted, DELIVERIES[name]._replace(period=1.0 / rate))
        found[motion] = (one.error / even.error, one.chatter / even.chatter, one.peak / even.peak)
    return found


def table(found: dict[tuple[str, int, str], dict[str, tuple[float, float, float]]]) -> list[str]:
    """Rows of Markdown: median and largest of each ratio over the controllers, for each way of delivery."""
    lines = ["| rate | delivery | motion | error | $c_u$ | largest voltage |", "|---" * 6 + "|"]
    for rate, name in dict.fromkeys((rate, name) for _, rate, name in found):
        for motion in ("strokes", "sines", "steps"):
            rows = np.array([r[motion] for (_, f, n), r in found.items() if (f, n) == (rate, name)])
            cells = [f"{np.median(c):.2f}, {np.max(c):.2f}" for c in rows.T]
            lines.append(f"| {rate} Hz | {name} | {motion} | " + " | ".join(cells) + " |")
    return lines


def over_dds(folder: Path, message: str) -> dict[str, dict[str, Any]]:
    """Ratios of each set of tuned gains on strokes and a sine over DDS, and the longest pause [s]."""
    from research.campaigns import demo
    from research.campaigns.processes import bar

    found: dict[str, dict[str, Any]] = {}
    shapes = {
        "strokes": {
            "scenario": "point_to_point", "amplitude": STROKE.amplitude, "start": SETTLED,
            "max_velocity": STROKE.max_velocity, "max_accel": STROKE.max_accel, "cycle": STROKE.cycle,
        },
        "sine": {"scenario": "sine", "amplitude": 1.0, "frequency": 5.0, "start": SETTLED},
    }  # fmt: skip
    for valve in VALVES:
        for law in LAWS:
            for name, shape in shapes.items():
                settings = {**demo.PACE, **shape, "duration": SECONDS, "message": message}
                run = demo.DemoRun(
                    f"{valve}_{law}_{name}", "", (f"{valve}.yaml", f"tuned/{valve}_{law}.yaml"), settings
                )
                with bar(run.name, SECONDS) as progress:
                    got = demo.run_cascade(run, folder, progress)
                values = demo.values_of(run)
                twin = offline.simulate(
                    values["controller"], values["valve_simulator"], build.commands(values["command_source"]),
                    alone=True,
                )  # fmt: skip
                pairs = []
                for command, reading, voltage in (
                    (got.command, got.measurement, got.voltage),
                    (twin.command, twin.measurement, twin.voltage),
                ):
                    begin = round(SETTLED / got.period)
                    u, e = voltage[begin:], (reading - command)[begin:]
                    pairs.append((rms(e), rms(np.diff(u)) / rms(u), float(np.max(np.abs(u)))))
                ratios = [a / b for a, b in zip(*pairs, strict=True)]
                found[run.name] = {"ratios": ratios, "dds": pairs[0], "offline": pairs[1], "pause": got.pause}
                row = ", ".join(f"{ratio:.2f}" for ratio in ratios)
                print(f"{run.name}: error, c_u, voltage {row}; longest pause {1e3 * got.pause:.1f} ms")
    return found


def _options() -> Parser:
    parser = running.options("command_times", __doc__.splitlines()[0].partition(": ")[2])
    parser.add_argument("--commissioned", type=int, nargs="*", default=[], metavar="SEED")
    parser.add_argument("--budget", type=int, default=200, help="sets of gains of a commissioning (200)")
    parser.add_argument("--dds", action="store_true", help="over DDS, on this host")
    return parser


def _work(arguments: argparse.Namespace) -> None:
    if arguments.dds:
        from research.campaigns.processes import run_tool

        folder, live = Path("out/command_times"), dict[str, Any]()

        def work() -> int:
            live.update(over_dds(folder, "command"))
            return 0

        run_tool("command_times", folder, work)
        write_json(arguments, live)
        return
    cases = commissioned(arguments.commissioned, arguments.budget) if arguments.commissioned else tuned()
    found = {}
    for rate in RATES:
        for name in DELIVERIES if rate == RATES[0] else [ALL]:
            for case in cases:
                found[case.name, rate, name] = ratios(case, rate, name)
    if arguments.json != "-":
        print("\n".join(table(found)))
    write_json(arguments, {str(key): value for key, value in found.items()})


def main(argv: Sequence[str] | None = None) -> int:
    """Run the benchmark; returns the exit status."""
    return running.run(_options(), _work, argv)


if __name__ == "__main__":
    sys.exit(main())
