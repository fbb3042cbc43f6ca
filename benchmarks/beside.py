# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks.beside``: reading to voltage through topics and beside the device, in turns.

Through topics: `valve_simulator` and `controller`, from the simulator's publication of a reading to the
controller's of the voltage. Beside the device: `controller` with ``driver:=simulated``, from the reading that
the driver has given to the voltage that it has taken. Both as the diagnostics tell them. CPU time
is of all processes but the command source.
"""

import argparse
import json
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

from benchmarks.batch import machine
from valve_control.nodes.harness.processes import process

WAYS: dict[str, dict[str, list[str]]] = {
    "topics": {"valve_simulator": [], "controller": []},
    "beside": {"controller": ["-p", "driver:=simulated"]},
}
START = 60.0  # s in which the controller must have readings
LEAD = 3.0  # s after that which do not count
FIGURES = ("latency_ms_p50", "latency_ms_p99", "step_ms_p50", "jitter_ms_p99")


class Diagnostics(Node):  # type: ignore[misc]  # mypy does not see rclpy
    """Keeps what the controller says about itself once a second."""

    def __init__(self) -> None:
        super().__init__("beside")
        self.said: list[dict[str, str]] = []
        self.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 10)

    def _hear(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "controller":
                self.said.append({value.key: value.value for value in status.values})


def listen(node: Diagnostics, seconds: float) -> None:
    """Hear for ``seconds``."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.1)


def turn(way: str, law: str, period: float, seconds: float, folder: Path) -> dict[str, float]:
    """Medians of the figures of one run, CPU time per sample [µs] and lost readings."""
    common = ["-p", f"sample_period:={period}"]
    with ExitStack() as stack:
        children = []
        for node, own in WAYS[way].items():
            words = [*common, *own, *(["-p", f"controller:={law}"] if node == "controller" else [])]
            children.append(stack.enter_context(process(node, words, folder / f"{way}_{node}.log")))
        source = ["-p", "scenario:=sine", "-p", "duration:=1000.0", "-p", f"sample_period:={period}"]
        stack.enter_context(process("command_source", source, folder / f"{way}_source.log"))
        node = Diagnostics()
        try:
            started = time.monotonic()
            while not (node.said and FIGURES[0] in node.said[-1]):
                if time.monotonic() > started + START:
                    raise RuntimeError(f"{way}: the controller has no readings after {START:g} s")
                listen(node, 0.1)
            listen(node, LEAD)
            before = [psutil.Process(child.pid).cpu_times() for child in children]
            begin = len(node.said) - 1
            listen(node, seconds)
            after = [psutil.Process(child.pid).cpu_times() for child in children]
        finally:
            node.destroy_node()
    heard = node.said[begin:]
    samples = int(heard[-1]["samples"]) - int(heard[0]["samples"])
    used = sum(a.user + a.system - b.user - b.system for a, b in zip(after, before, strict=True))
    figures = {name: float(np.median([float(one[name]) for one in heard])) for name in FIGURES}
    lost = int(heard[-1]["lvdt_lost"]) - int(heard[0]["lvdt_lost"])
    return {**figures, "cpu_us": 1e6 * used / samples, "samples": samples, "lost": lost}


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=8.0, help="of each turn (8)")
    parser.add_argument("--rounds", type=int, default=3, help="turns of each way (3)")
    parser.add_argument("--law", default="arc", help="law (arc)")
    parser.add_argument("--period", type=float, default=0.001, help="sample period [s] (0.001)")
    parser.add_argument("--json", metavar="FILE", help="results as JSON")
    options = parser.parse_args(arguments)
    rclpy.init()
    rows: dict[str, list[dict[str, float]]] = {way: [] for way in WAYS}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(options.rounds):
            for way, found in rows.items():
                found.append(turn(way, options.law, options.period, options.seconds, Path(folder)))
    rclpy.try_shutdown()
    medians: dict[str, Any] = {
        way: {name: float(np.median([row[name] for row in found])) for name in found[0]}
        for way, found in rows.items()
    }
    for way, figures in medians.items():
        print(f"{way:8}" + "  ".join(f"{name} {value:.4g}" for name, value in figures.items()))
    for name in ("latency_ms_p50", "latency_ms_p99", "cpu_us"):
        print(f"{name}: beside / topics = {medians['beside'][name] / medians['topics'][name]:.2f}")
    if options.json:
        Path(options.json).write_text(json.dumps({"machine": machine(), **medians, "rounds": rows}, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
