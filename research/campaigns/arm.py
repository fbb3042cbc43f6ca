# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Measures whether this machine keeps the sample period of the crane with two simulated axes.

It starts the processes of launch/arm.launch.xml with their files, without a goal. An axis that begins is
expected to be degraded or safe for a moment; later each safe stop counts.
"""

import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import psutil
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from research.campaigns.processes import parse_tool, process, run_tool, tool_options, wait_until
from valve_control import outputs
from valve_control.control.parameters import ros_file
from valve_control.nodes.adapter import EVERYTHING, PolledSubscription

VALVES = ("boom", "arm")
FIGURES = ("samples", "period_ms", "latency_ms_p50", "latency_ms_p99", "overruns")
START = 120.0  # s, until both valves are controlled; the axes are compiled first
SETTLING = 2.0  # s after that in which safe stops do not count


def commands() -> dict[str, tuple[str, list[str]]]:
    """Node and arguments of each process by name."""
    config = ros_file.config_folder()
    words = ["--params-file", str(config / "arm.yaml")]
    found = {"manifold": ("manifold", words)}
    for valve in VALVES:
        machine = ["--params-file", str(config / "axis" / f"crane_{valve}.yaml")]
        for node in ("axis_simulator", "axis_controller"):
            found[f"{valve}_{node}"] = (node, ["-r", f"__ns:=/{valve}", *machine, *words])
    return found


class Watch:
    """What the controllers of the valves tell in /diagnostics."""

    def __init__(self, node: Node) -> None:
        self._diagnostics = PolledSubscription(node, DiagnosticArray, "/diagnostics", EVERYTHING)
        self.last: dict[str, dict[str, str]] = {}
        self.stops: list[dict[str, Any]] = []  # time [s], valve and reason of each change to safe

    def fetch(self) -> None:
        """Take in the messages that have arrived."""
        for message, _ in self._diagnostics.take():
            for status in message.status:
                valve, _, name = status.name.rpartition("/")
                if name != "controller":
                    continue
                values = {item.key: item.value for item in status.values}
                before = self.last.get(valve, {}).get("mode")
                if values["mode"] == "safe" != before:
                    self.stops.append({"at": time.monotonic(), "valve": valve, "reason": status.message})
                self.last[valve] = values

    def controlled(self) -> bool:
        """Whether every valve is controlled."""
        self.fetch()
        return all(self.last.get(valve, {}).get("mode") == "ok" for valve in VALVES)


def cpu(pid: int) -> float:
    """CPU time [s] that a process has used."""
    times = psutil.Process(pid).cpu_times()
    return float(times.user + times.system)


def measure(seconds: float, folder: Path) -> dict[str, Any]:
    """Run the arm for ``seconds`` from when both valves are controlled on. Raises RuntimeError."""
    node = rclpy.create_node("arm_watch")
    watch = Watch(node)
    try:
        with ExitStack() as stack:
            children = {
                child: stack.enter_context(process(program, words, folder / f"arm_{child}.log"))
                for child, (program, words) in commands().items()
            }
            alive = list(children.values())
            wait_until(watch.controlled, "control of both valves", alive, START)
            begin, used = time.monotonic(), {child: cpu(run.pid) for child, run in children.items()}

            def over() -> bool:
                watch.fetch()
                return time.monotonic() > begin + seconds

            wait_until(over, "the end", alive, seconds + 10.0)
            spent = time.monotonic() - begin
            shares = {child: (cpu(run.pid) - used[child]) / spent for child, run in children.items()}
    finally:
        node.destroy_node()
    stops = [{**stop, "at": stop["at"] - begin} for stop in watch.stops]
    return {
        "seconds": seconds,
        "safe_stops": sum(stop["at"] > SETTLING for stop in stops),
        "stops": stops,
        "cores": shares,
        "valves": {v: {key: watch.last[v].get(key) for key in FIGURES} for v in VALVES},
    }


def text(result: Mapping[str, Any]) -> str:
    """One run in text."""
    lines = [
        f"{result['safe_stops']} safe stops in {result['seconds']:g} s, "
        f"{sum(result['cores'].values()):.2f} of a core"
    ]
    lines += [f"  {stop['at']:7.2f} s {stop['valve']}: {stop['reason']}" for stop in result["stops"]]
    for valve, figures in result["valves"].items():
        lines.append(f"  {valve}: " + ", ".join(f"{key} {value}" for key, value in figures.items()))
    return "\n".join(lines)


def main() -> int:
    """Entry point of `python -m research.campaigns.arm`."""
    options = tool_options("arm", __doc__, ())
    options.add_argument("--seconds", type=float, default=14.0, help="length of the run (14)")
    arguments = parse_tool(options)
    if not SETTLING < arguments.seconds <= 3600.0:
        options.error(f"--seconds is {arguments.seconds:g}; it must lie between {SETTLING:g} and 3600")
    folder = Path(arguments.out)

    def work() -> int:
        result = measure(arguments.seconds, folder)
        print(text(result), flush=True)
        outputs.write(str(folder / "arm.json"), outputs.as_json(result))
        return 1 if result["safe_stops"] else 0

    return run_tool("arm", folder, work)


if __name__ == "__main__":
    sys.exit(main())
