# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks.beside``: reading to voltage by topics and beside the device, many valves, 4 kHz.

Through topics: `valve_simulator` and `controller`, from the simulator's publication of a reading to the
controller's of the voltage. Beside the device: `controller` with ``driver:=simulated``, from the reading that
the driver has given to the voltage that it has taken. Both as the diagnostics tell them, in turns. CPU time
is of all processes but the command source.

Many valves: a `manifold` with simulated devices on the last CPU, commanded at 100 Hz. A reading is lost if
the driver left its tick out, and late if it was taken more than a period after its tick.
"""

import argparse
import math
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64

from benchmarks.batch import machine
from research.campaigns.processes import process
from valve_control import outputs
from valve_control.nodes import realtime
from valve_control.nodes.adapter import SAMPLES, encoded
from valve_control.nodes.transport import RANGE, use_own_profile

WAYS: dict[str, dict[str, list[str]]] = {
    "topics": {"valve_simulator": [], "controller": []},
    "beside": {"controller": ["-p", "driver:=simulated"]},
}
START = 60.0  # s in which all controllers must have readings
LEAD = 3.0  # s after that which do not count
FIGURES = ("latency_ms_p50", "latency_ms_p99", "step_ms_p50", "jitter_ms_p99")
COMMANDS = 0.01  # s between two commands to many valves
SECONDS, ROUNDS = 6.0, 3  # of each turn
LAW, PERIOD = "arc", 0.001  # s
MANY, FAST = 12, 0.00025  # valves at 1 kHz; s, of one valve
WANTED = {
    "beside_vs_topics_p50": ("at most", 0.5),
    "beside_vs_topics_p99": ("at most", 0.5),
    "beside_lost_of_12_valves": ("at most", 0),
    "beside_lost_at_4khz": ("at most", 0),
}


class Diagnostics(Node):  # type: ignore[misc]  # mypy does not see rclpy
    """Keeps what controllers say about themselves once a second, and commands ``valves``."""

    def __init__(self, valves: Sequence[str] = ()) -> None:
        super().__init__("beside")
        self.said: dict[str, list[dict[str, str]]] = {}
        self._commands = [self.create_publisher(Float64, f"/{v}/spool_command", SAMPLES) for v in valves]
        self.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 1000)
        if valves:
            self.create_timer(COMMANDS, self._command)

    def _command(self) -> None:
        command = encoded(math.sin(2.0 * math.pi * time.monotonic()))
        for publisher in self._commands:
            publisher.publish(command)

    def _hear(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.rsplit("/", 1)[-1] == "controller":
                values = {value.key: value.value for value in status.values}
                self.said.setdefault(status.name, []).append(values)


def listen(node: Diagnostics, seconds: float) -> None:
    """Hear for ``seconds``."""
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0.0:
        rclpy.spin_once(node, timeout_sec=left)


def measure(node: Diagnostics, children: Sequence[Any], controllers: int, seconds: float) -> dict[str, float]:
    """Figures of ``seconds`` with all ``controllers`` at work. Raises RuntimeError if they do not begin."""
    started = time.monotonic()
    while len([said for said in node.said.values() if FIGURES[0] in said[-1]]) < controllers:
        if time.monotonic() > started + START or any(child.poll() is not None for child in children):
            raise RuntimeError(f"{len(node.said)} of {controllers} controllers have readings")
        listen(node, 0.1)
    listen(node, LEAD)
    pids = [psutil.Process(child.pid) for child in children]
    begun = {name: len(said) - 1 for name, said in node.said.items()}
    before, at = [pid.cpu_times() for pid in pids], time.monotonic()
    listen(node, seconds)
    after, elapsed = [pid.cpu_times() for pid in pids], time.monotonic() - at
    used = sum(a.user + a.system - b.user - b.system for a, b in zip(after, before, strict=True))
    heard = [said[begun.get(name, 0) :] for name, said in node.said.items()]

    def gained(name: str) -> int:
        return sum(int(said[-1].get(name, 0)) - int(said[0].get(name, 0)) for said in heard)

    return {
        **{name: float(np.median([float(one[name]) for said in heard for one in said])) for name in FIGURES},
        "samples": gained("samples"),
        "lost": gained("lvdt_lost"),
        "late": gained("late"),
        "cpu_share": used / elapsed,
    }


def turn(way: str, law: str, period: float, seconds: float, folder: Path) -> dict[str, float]:
    """Figures of one run of one valve, commanded at its own rate."""
    common = ["-p", f"sample_period:={period!r}"]
    with ExitStack() as stack:
        children = []
        for node, own in WAYS[way].items():
            words = [*common, *own, *(["-p", f"controller:={law}"] if node == "controller" else [])]
            children.append(stack.enter_context(process(node, words, folder / f"{way}_{node}.log")))
        source = ["-p", "scenario:=sine", "-p", "duration:=1000.0", *common]
        stack.enter_context(process("command_source", source, folder / f"{way}_source.log"))
        listener = Diagnostics()
        stack.callback(listener.destroy_node)
        return measure(listener, children, 1, seconds)


def many(
    valves: int, law: str, period: float, seconds: float, folder: Path, priority: int = 0
) -> dict[str, float]:
    """Figures of a manifold of ``valves`` with devices, alone on the last CPU as far as this process goes.

    ``priority`` of the real-time scheduler, 0: none.
    """
    names = [f"v{i}" for i in range(valves)]
    cpus = os.sched_getaffinity(0)
    words = [f"valves:=[{','.join(names)}]", "driver:=simulated", f"controller:={law}"]
    words += [f"sample_period:={period!r}", f"realtime.cpus:='{max(cpus)}'"]
    words += [f"realtime.priority:={priority}"]
    given = [word for text in words for word in ("-p", text)]
    realtime.obtain(realtime.Request(False, 0, tuple(cpus - {max(cpus)}) or tuple(cpus)), print)
    try:
        with ExitStack() as stack:
            child = stack.enter_context(process("manifold", given, folder / f"beside_{valves}.log"))
            listener = Diagnostics(names)
            stack.callback(listener.destroy_node)
            return measure(listener, [child], valves, seconds)
    finally:
        realtime.obtain(realtime.Request(False, 0, tuple(cpus)), print)


def told(name: str, figures: dict[str, float]) -> str:
    """One line."""
    return f"{name:16}" + "  ".join(f"{key} {value:.4g}" for key, value in figures.items())


def compare(
    law: str, period: float, seconds: float, rounds: int, folder: Path
) -> dict[str, dict[str, float]]:
    """Medians of the figures of both ways, in turns; printed."""
    rows: dict[str, list[dict[str, float]]] = {way: [] for way in WAYS}
    for _ in range(rounds):
        for way, found in rows.items():
            found.append(turn(way, law, period, seconds, folder))
    medians = {
        way: {name: float(np.median([row[name] for row in found])) for name in found[0]}
        for way, found in rows.items()
    }
    for way, figures in medians.items():
        print(told(way, figures), flush=True)
    return medians


def run(folder: Path) -> dict[str, Any]:
    """Measure for `make bench`. Raises RuntimeError."""
    os.environ.setdefault(RANGE, "LOCALHOST")
    use_own_profile(os.environ)
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # the benchmarks handle signals
    try:
        ways = compare(LAW, PERIOD, SECONDS, ROUNDS, folder)
        valves = many(MANY, LAW, PERIOD, SECONDS, folder)
        print(told(f"{MANY} valves", valves), flush=True)
        fast = many(1, LAW, FAST, SECONDS, folder)
        print(told(f"{1e-3 / FAST:g} kHz", fast))
    finally:
        rclpy.try_shutdown()
    ratios = {
        f"beside_vs_topics_{name}": ways["beside"][f"latency_ms_{name}"]
        / ways["topics"][f"latency_ms_{name}"]
        for name in ("p50", "p99")
    }
    return {
        **ways,
        "many": valves,
        "fast": fast,
        "figures": {
            **ratios,
            "beside_lost_of_12_valves": valves["lost"],
            "beside_late_of_12_valves": valves["late"] / valves["samples"],
            "beside_lost_at_4khz": fast["lost"],
            "beside_late_at_4khz": fast["late"] / fast["samples"],
        },
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=SECONDS, help=f"of each turn ({SECONDS:g})")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help=f"turns of each way ({ROUNDS})")
    parser.add_argument("--law", default=LAW, help=f"law ({LAW})")
    parser.add_argument("--period", type=float, default=PERIOD, help=f"sample period [s] ({PERIOD})")
    parser.add_argument("--valves", type=int, help="that many valves in a manifold instead")
    parser.add_argument(
        "--priority", type=int, default=0, help="of the real-time scheduler, for --valves; 0: none (0)"
    )
    parser.add_argument("--json", metavar="FILE", help="results as JSON")
    options = parser.parse_args(arguments)
    if options.priority and not options.valves:
        parser.error("--priority is for a manifold; give --valves too")
    rclpy.init()
    try:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            given = options.law, options.period, options.seconds
            if options.valves:
                results: dict[str, Any] = {"many": many(options.valves, *given, folder, options.priority)}
                print(told(f"{options.valves} valves", results["many"]))
            else:
                results = compare(*given, options.rounds, folder)
                for key in ("latency_ms_p50", "latency_ms_p99", "cpu_share"):
                    ratio = results["beside"][key] / results["topics"][key]
                    print(f"{key}: beside / topics = {ratio:.2f}")
    finally:
        rclpy.try_shutdown()
    if options.json:
        outputs.write(options.json, outputs.as_json({"machine": machine(), **results}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
