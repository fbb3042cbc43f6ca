# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks.commissioned``: ``commission`` over DDS on random valves, from paper gains.

The valves are five linear ones, or with --solenoid those of benchmarks.solenoid with the same seeds.
Simulator, controller and ``valve-control commission`` are processes of their own. The controller begins
with the defaults (the paper's ARC); what comes out is a tuned law, or a sentence and the parameters from
before. Every voltage from the first limit on is looked at. Beside the verification run on the running valve,
strokes and sines of another size are simulated on the true one, with the gains from before and the new ones;
on a solenoid valve the four motions of benchmarks.solenoid, with preview and with the command alone.
With --pauses one of the three processes is stopped for some milliseconds every some seconds. Controller and
simulator then have the usual patience with single readings.
"""

import argparse
import json
import math
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rclpy
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python
from rclpy.signals import SignalHandlerOptions

from benchmarks import solenoid
from benchmarks.invented import invented, motions
from research.campaigns.processes import Listener, process, wait_until
from valve_control import outputs
from valve_control.control.parameters import build, ros_file
from valve_control.control.parameters.table import CONTROLLER, NODES
from valve_control.control.simulation import offline
from valve_control.nodes.adapter import EVERYTHING
from valve_control.nodes.transport import RANGE, use_own_profile
from valve_control.parameter import Value, Values, defaults, number, updated

# Second, third and fourth order; slow with much friction, fast with little; much and little noise.
SEEDS = (4, 8, 9, 11, 12)
SOLENOIDS = range(1000, 1020)
LEAST = 100  # voltages, after which the loop runs
LONGEST = 400.0  # s  after which a commissioning counts as hung
ANSWER = 20.0  # s
SWING = 20.0  # V  the largest motion that can be believed, as a sine of the valve's bandwidth
SIZE = 0.5  # of the motions of benchmarks.invented, which are larger than what the limits let a valve follow
WANTED_SECONDS = 180.0
STOPPED, APART = (0.005, 0.06), (5.0, 15.0)  # s  that a process stands still, and from one time to the next
# The simulated valve waits for its voltage, and the controller for readings: a busy machine is no dead time.
PATIENT_VALVE = {"patience": 1.0}
PATIENT = {"lvdt.hold_samples": 5000, "lvdt.period_limit": 1000.0, "lvdt.frozen_samples": 0}


def arguments_of(values: Mapping[str, Any]) -> list[str]:
    """``values`` as arguments of a node."""
    return [word for name, value in values.items() for word in ("-p", f"{name}:={ros_file.as_text(value)}")]


class Seen(Listener):
    """Every voltage and reading, the limits of the voltage, and the parameters of the controller."""

    def __init__(self) -> None:
        super().__init__("seen", ("valve_voltage", "spool_position"))
        self.limits: list[tuple[int, float]] = []  # times [ns] and values [V] of u_max
        self.create_subscription(ParameterEvent, "/parameter_events", self._note, EVERYTHING)
        self._got = self.create_client(GetParameters, "/controller/get_parameters")

    def _note(self, event: ParameterEvent) -> None:
        stamp = event.stamp.sec * 10**9 + event.stamp.nanosec
        self.limits += [
            (stamp, changed.value.double_value)
            for changed in event.changed_parameters
            if event.node == "/controller" and changed.name == "u_max"
        ]

    def look(self) -> bool:
        """Take what has come."""
        rclpy.spin_once(self, timeout_sec=0.01)
        self.fetch()
        return True

    def parameters(self) -> Values:
        """All parameters of the controller."""
        names = [parameter.name for parameter in CONTROLLER]
        wait_until(lambda: self.look() and self._got.service_is_ready(), "the controller's services", ())
        future = self._got.call_async(GetParameters.Request(names=names))
        wait_until(lambda: self.look() and future.done(), "the parameters", (), ANSWER)
        return {
            name: value if isinstance(value, (bool, int, float, str)) else list(value)
            for name, value in zip(names, map(parameter_value_to_python, future.result().values), strict=True)
        }

    def largest(self) -> float:
        """The largest voltage [V] while the first limit was in force."""
        if not self.limits:
            return math.nan
        stamps = np.array(self.stamps["valve_voltage"])
        until = self.limits[1][0] if len(self.limits) > 1 else np.inf
        during = (stamps > self.limits[0][0]) & (stamps < until)
        return float(np.max(np.abs(np.array(self.values["valve_voltage"])[during]), initial=0.0))


class Drawn(NamedTuple):
    """A random valve."""

    frequency: float  # Hz
    order: int
    values: dict[str, Value]  # of the simulator
    errors: Callable[[Values], list[float]]  # V  true e_rms of a controller with these parameters, by motion


def _linear(seed: int, period: float) -> Drawn:
    frequency, valve = invented(np.random.default_rng(seed))
    values: dict[str, Value] = {**valve, "sample_period": period}
    true = updated(NODES["valve_simulator"], defaults(NODES["valve_simulator"]), values)

    def errors(controller: Values) -> list[float]:
        return [
            offline.simulate(controller, true, SIZE * motion[:: round(period / 0.001)]).true_error["e_rms"]
            for motion in motions(frequency).values()
        ]

    return Drawn(frequency, len(list(valve["denominator"])) - 1, values, errors)  # type: ignore[arg-type]


def _with_solenoids(seed: int, period: float) -> Drawn:
    values = {**solenoid.drawn(seed), "sample_period": period}
    plant = build.valve_params(values)

    def errors(controller: Values) -> list[float]:
        ahead = number(controller, "reshaping.lead")
        return [
            solenoid.on_the_valve(plant, controller, ahead, previewed)["e_rms"]
            for previewed in solenoid.MODES.values()
        ]

    return Drawn(number(values, "solenoid.natural_frequency"), 3, values, errors)


@contextmanager
def pausing(children: Sequence["subprocess.Popen[bytes]"], seed: int) -> Iterator[list[float]]:
    """Within the block one of the ``children`` after another stands still; yields for how long [s]."""
    chosen, over, stood = random.Random(seed), threading.Event(), list[float]()

    def stop() -> None:
        while children and not over.wait(chosen.uniform(*APART)):
            child, length = chosen.choice(children), chosen.uniform(*STOPPED)
            child.send_signal(signal.SIGSTOP)
            time.sleep(length)
            child.send_signal(signal.SIGCONT)
            stood.append(length)

    helper = threading.Thread(target=stop)
    helper.start()
    try:
        yield stood
    finally:
        over.set()
        helper.join()


def gone_through(
    folder: Path,
    seed: int,
    period: float,
    wanted: Sequence[str],
    travel: float,
    draw: Callable[[int, float], Drawn] = _linear,
    pauses: bool = False,
) -> dict[str, Any]:
    """Commission the valve ``seed``; ``wanted``: arguments of ``commission``; ``pauses``: of processes."""
    frequency, order, valve, errors = draw(seed, period)
    # What a user has to say of a valve that is faster than that of the defaults.
    fastest = max(500.0, 2.0 * math.pi * frequency * SWING)
    usual = {"sample_period": period, "lvdt.max_rate": fastest, **({} if pauses else PATIENT)}
    patience = {} if pauses else PATIENT_VALVE
    about: dict[str, Any] = {"seed": seed, "frequency_hz": frequency, "order": order, "valve": valve}
    kept = folder / "kept"
    with (
        process(
            "valve_simulator", arguments_of({**valve, **patience}), folder / "simulator.log"
        ) as simulator,
        process("controller", arguments_of(usual), folder / "controller.log") as controller,
    ):
        seen = Seen()
        try:
            wait_until(lambda: seen.look() and len(seen.values["valve_voltage"]) > LEAST, "voltages", ())
            before = seen.parameters()
            command = [
                sys.executable,
                "-m",
                "valve_control.cli",
                "commission",
                "--yes",
                "--folder",
                str(kept),
            ]
            began = time.monotonic()
            with (folder / "said.log").open("w") as said:
                child = subprocess.Popen(
                    [*command, "--travel", str(travel), *wanted], stdout=said, stderr=said,
                    stdin=subprocess.DEVNULL,
                )  # fmt: skip
                hung = False
                try:
                    with pausing([simulator, controller, child] if pauses else [], seed) as stood:
                        wait_until(lambda: seen.look() and child.poll() is not None, "its end", (), LONGEST)
                except RuntimeError:
                    hung = time.monotonic() - began > LONGEST
                    if not hung:
                        raise
                finally:
                    child.kill()
                    child.wait()
            about["seconds"] = time.monotonic() - began
            about["status"] = child.returncode
            about["stood_still_s"] = stood
            after = seen.parameters()
            about["largest_voltage"] = seen.largest()
            about["readings"] = len(seen.values["spool_position"])
        finally:
            seen.destroy_node()
    if about["status"] != 0:
        lines = (folder / "said.log").read_text().strip().splitlines()
        last = lines[-1] if lines else f"it ended with status {about['status']}"
        about["reason"] = f"it was not over after {LONGEST:g} s" if hung else last
        about["as_before"] = after == before
        return about
    found = json.loads((kept / "commission.json").read_text())
    about.update(
        {name: found[name] for name in ("verification", "applied", "seconds", "notes", "pauses", "way_s")}
    )
    about["seconds"] = {**found["seconds"], "all": sum(found["seconds"].values())}
    about["found"] = found["valve"]
    about["as_told"] = after == {**before, **found["applied"]}
    about["on_the_valve"] = {"before": errors(before), "after": errors(after)}
    return about


def told(row: Mapping[str, Any]) -> str:
    """One line of the table."""
    valve = row["valve"]
    late = valve["lvdt.delay"] + valve.get("solenoid.dead_time", 0.0)
    head = (
        f"{row['seed']:5}{row['order']:7}{row['frequency_hz']:10.1f}{valve['friction.coulomb']:14.2f}"
        f"{1e3 * late:12.2f}{1e3 * valve['lvdt.noise']:12.1f}"
    )
    if row["status"] != 0:
        return f"{head}  {row['reason']} ({'as before' if row['as_before'] else 'NOT as before'})"
    made, on = row["verification"], row["on_the_valve"]
    former = made["simulated_before"]
    means = [_told_errors(row, on[name]) for name in ("before", "after")]
    return (
        f"{head}{row['seconds']['all']:9.0f}{1e3 * made['measured']['e_rms']:12.1f}"
        f"{1e3 * made['simulated']['e_rms']:12.1f}"
        + (f"{1e3 * former['e_rms']:12.1f}" if former else f"{'unstable':>12}")
        + f"{means[0]:>12}{means[1]:>12}"
    )


def _told_errors(row: Mapping[str, Any], errors: Sequence[float]) -> str:
    """Geometric mean of the motions [mV]; of a solenoid valve both kinds of command."""
    if row["valve"]["valve"] == "solenoid":
        return "/".join(f"{1e3 * e:.1f}" for e in errors)
    return f"{1e3 * math.exp(float(np.mean(np.log(errors)))):.1f}"


HEAD = (
    f"{'valve':>5}{'order':>7}{'f [Hz]':>10}{'friction [V]':>14}{'delay [ms]':>12}{'noise [mV]':>12}"
    f"{'t [s]':>9}{'run [mV]':>12}{'model [mV]':>12}{'before [mV]':>12}{'true before':>12}{'after':>12}"
)


def main() -> int:
    """Commission all, print, write."""
    options = argparse.ArgumentParser(prog="benchmarks.commissioned", description=__doc__)
    options.add_argument(
        "--seed", type=int, action="append", metavar="N", help=f"valve {SEEDS}; again for more"
    )
    options.add_argument("--solenoid", action="store_true", help="valves of benchmarks.solenoid")
    options.add_argument("--pauses", action="store_true", help="stop one of the processes now and then")
    options.add_argument("--controller", default="dcarc", help="law to tune (dcarc)")
    options.add_argument("--sample-period", type=float, default=0.001, metavar="S", help="(0.001)")
    options.add_argument("--max-voltage", type=float, default=4.0, metavar="V", help="(4)")
    options.add_argument("--travel", type=float, default=2.0, metavar="V", help="(2)")
    options.add_argument("--budget", type=int, default=200, help="sets of gains (200)")
    options.add_argument("--out", default="out/commissioned", metavar="FOLDER", help="(out/commissioned)")
    arguments = options.parse_args()
    period, longest = 1e3 * arguments.sample_period, 1 if arguments.solenoid else 100
    if abs(period - round(period)) > 1e-9 or not 1 <= round(period) <= longest:
        options.error("--sample-period must be 0.001 to 0.1 in whole milliseconds, and 0.001 with --solenoid")
    os.environ.setdefault(RANGE, "LOCALHOST")
    use_own_profile(os.environ)
    wanted = ["--controller", arguments.controller, "--budget", str(arguments.budget)]
    wanted += ["--max-voltage", str(arguments.max_voltage)]
    rows: list[dict[str, Any]] = []
    print(HEAD, flush=True)
    for seed in arguments.seed or (SOLENOIDS if arguments.solenoid else SEEDS):
        folder = Path(arguments.out) / str(seed)
        folder.mkdir(parents=True, exist_ok=True)
        os.environ["ROS_DOMAIN_ID"] = str(1 + (os.getpid() + seed) % 100)  # no valve sees another
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        try:
            draw = _with_solenoids if arguments.solenoid else _linear
            rows.append(
                gone_through(
                    folder, seed, arguments.sample_period, wanted, arguments.travel, draw, arguments.pauses
                )
            )
        finally:
            rclpy.shutdown()
        print(told(rows[-1]), flush=True)
        outputs.write(str(folder / "row.json"), outputs.as_json(rows[-1]))
        outputs.write(f"{arguments.out}/commissioned.json", outputs.as_json({"rows": rows}))
    late = [row["seed"] for row in rows if row["status"] == 0 and row["seconds"]["all"] > WANTED_SECONDS]
    wrong = [
        row["seed"]
        for row in rows
        if not row.get("as_told" if row["status"] == 0 else "as_before")
        or row["largest_voltage"] > arguments.max_voltage + 1e-9
    ]
    if late:
        print(f"longer than {WANTED_SECONDS:g} s: {late}", file=sys.stderr)
    if wrong:
        print(f"parameters or voltages are not as they should be: {wrong}", file=sys.stderr)
    return 1 if late or wrong else 0


if __name__ == "__main__":
    sys.exit(main())
