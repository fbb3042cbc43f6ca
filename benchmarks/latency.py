"""The loop: LVDT-to-voltage latency of the controller's process against an echo; 2 kHz; many valves in one process.

A probe stands in for LVDT and upper level: it sends readings and commands of an offline run at their times, and
takes the voltages. The latency is from its clock before it publishes a reading to the source time of the voltage.
All candidates live at once and are asked in turns of a second, so that all see the same machine.
"""

import os
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import rclpy
from rclpy._rclpy_pybind11 import WaitSet
from rclpy.node import Node
from std_msgs.msg import Float64
from tqdm import tqdm

from valve_control.nodes.adapter import SAMPLES, NumberSubscription, encoded
from valve_control.nodes.cascade import process, wait_until
from valve_control.parameters.table import NODES, defaults, updated
from valve_control.simulation import offline

Floats = npt.NDArray[np.float64]
AHEAD = 0.3  # of a period by which a command comes before the reading
CANDIDATES = tuple(os.environ.get("CANDS", "plain,executor,arc,oarc").split(","))
WANTED = {"latency_vs_echo_p50": 1.15, "latency_vs_echo_p99": 1.3}  # at most
LAST = 0.5  # s to wait for the last voltages
COUNTS = (1, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 24, 28, 32)


class Probe(Node):
    """LVDT and upper level of one or more valves, each a namespace."""

    def __init__(self, name: str, valves: Sequence[str], commands: bool) -> None:
        super().__init__(name)
        topics = ("spool_command", "spool_position") if commands else ("spool_position",)
        self.sent = {
            t: [self.create_publisher(Float64, f"/{v}/{t}", SAMPLES) for v in valves] for t in topics
        }
        self.voltages = [NumberSubscription(self, f"/{v}/valve_voltage", SAMPLES) for v in valves]

    def connected(self) -> bool:
        """Whether every valve's controller is there."""
        heard = all(p.get_subscription_count() for publishers in self.sent.values() for p in publishers)
        return heard and all(v.handle.get_publisher_count() for v in self.voltages)

    def publish(self, topic: str, data: bytes) -> None:
        """To all valves."""
        for publisher in self.sent.get(topic, ()):
            publisher.publish(data)


class Answers(NamedTuple):
    """What came of readings, each valve's voltages in the order of its readings."""

    latency: Floats  # s, of each voltage
    sent: int  # readings, of all valves
    late: int  # voltages after the next reading

    @property
    def lost(self) -> int:
        """Readings that were never answered."""
        return self.sent - len(self.latency)


def ask(probe: Probe, run: offline.Run, period: float, count: int, begin: int = 0) -> Answers:
    """``count`` readings of ``run`` from its sample ``begin`` on, one each ``period`` [s], to each valve."""
    wait_set = WaitSet(len(probe.voltages), 0, 0, 0, 0, 0, rclpy.get_default_context().handle)
    asked: list[deque[int]] = [deque() for _ in probe.voltages]
    latency: list[int] = []
    late = 0
    for voltages in probe.voltages:  # of a silence between two turns
        for _ in voltages.take():
            pass
    next_at = time.monotonic() + 2.0 * period
    for k in range(begin, begin + count):
        command, reading = (
            encoded(float(values[k % len(values)])) for values in (run.command, run.measurement)
        )
        pause(next_at - AHEAD * period)
        probe.publish("spool_command", command)
        pause(next_at)
        for times in asked:
            late += len(times)
            times.append(time.time_ns())
        probe.publish("spool_position", reading)
        next_at = max(next_at + period, time.monotonic())
        limit = time.monotonic() + LAST if k == begin + count - 1 else next_at - AHEAD * period
        while any(asked) and (left := limit - time.monotonic()) > 0.0:
            waiting = [i for i, times in enumerate(asked) if times]
            wait_set.clear_entities()
            for i in waiting:
                wait_set.add_subscription(probe.voltages[i].handle)
            wait_set.wait(int(1e9 * left))
            for i in waiting:
                for _, info in probe.voltages[i].take():
                    if asked[i]:
                        latency.append(info["source_timestamp"] - asked[i].popleft())
    return Answers(np.array(latency) * 1e-9, count * len(probe.voltages), late)


def pause(until: float) -> None:
    """Sleep until ``until`` (`time.monotonic`)."""
    left = until - time.monotonic()
    if left > 0.0:
        time.sleep(left)


def recorded(controller: str, period: float) -> offline.Run:
    """An offline run whose readings and commands the controller gets."""
    changes = {
        "controller": controller,
        "sample_period": period,
        "lvdt.noise": 0.005,
        "friction.coulomb": 1.0,
    }
    values = {
        node: updated(
            NODES[node],
            defaults(NODES[node]),
            {name: value for name, value in changes.items() if name in {p.name for p in NODES[node]}},
        )
        for node in ("controller", "valve_simulator", "command_source")
    }
    commands = offline.commands(values["command_source"])
    return offline.simulate(values["controller"], values["valve_simulator"], commands)


@contextmanager
def candidate(kind: str, folder: Path, period: float) -> Iterator[Any]:
    """A process that answers readings in the namespace ``kind``."""
    kind, _, settings = kind.partition("_x_")
    for pair in filter(None, settings.split("_a_")):
        name, _, value = pair.partition("_")
        os.environ[name] = value.replace("p", ".")
    space = ["-r", f"__ns:=/{kind + ('_x_' + settings if settings else '')}"]
    if kind in ("arc", "oarc", "pid"):
        given = [*space, "-p", f"controller:={kind}", "-p", f"sample_period:={period!r}"]
        with process("controller", given, folder / f"{kind}.log") as child:
            yield child
        return
    with (folder / f"{kind}.log").open("wb") as log:
        child = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.echo", kind, "--ros-args", *space], stdout=log, stderr=log
        )
        try:
            yield child
        finally:
            child.terminate()
            child.wait()


def latencies(folder: Path, turns: int, period: float = 0.001) -> dict[str, Any]:
    """Latency of the echo and of the laws, [ms], from ``turns`` seconds each."""
    count = round(1.0 / period)
    run = recorded("arc", period)
    found: dict[str, list[Answers]] = {kind: [] for kind in CANDIDATES}
    with ExitStack() as stack:
        children = [stack.enter_context(candidate(kind, folder, period)) for kind in CANDIDATES]
        probes = {kind: Probe(f"probe_{kind}", [kind], kind[:3] in ("arc", "oar", "pid")) for kind in CANDIDATES}
        for kind, probe in probes.items():
            wait_until(probe.connected, kind, children)
        for turn in tqdm(range(-1, turns), desc="latency", unit="turn", ascii=True):
            for kind, probe in probes.items():
                answers = ask(probe, run, period, count, max(turn, 0) * count)
                if turn >= 0:
                    found[kind].append(answers)
        for probe in probes.values():
            probe.destroy_node()
    results: dict[str, Any] = {}
    for kind, parts in found.items():
        latency = np.concatenate([part.latency for part in parts])
        p50, p99 = np.percentile(latency, [50.0, 99.0])
        results[kind] = {
            "p50_ms": 1e3 * p50, "p99_ms": 1e3 * p99, "max_ms": 1e3 * latency.max(), "samples": len(latency),
            "lost": sum(part.lost for part in parts),
        }  # fmt: skip
    return results


def cpu_seconds(pid: int) -> float:
    """CPU time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def manifold(
    folder: Path, valves: int, seconds: float, law: str = "arc", period: float = 0.001
) -> dict[str, Any]:
    """``valves`` controllers in one process on one core, the probe on another."""
    names = [f"v{i}" for i in range(valves)]
    run = recorded(law, period)
    given = ["-p", f"valves:=[{','.join(names)}]", "-p", f"controller:={law}", "-p", "realtime.cpus:='1'"]
    with process("manifold", given, folder / f"manifold{valves}.log") as child:
        probe = Probe("probe", names, True)
        wait_until(probe.connected, f"{valves} valves", [child])
        ask(probe, run, period, 500)
        before, began = cpu_seconds(child.pid), time.monotonic()
        answers = ask(probe, run, period, round(seconds / period), 500)
        spent, elapsed = cpu_seconds(child.pid) - before, time.monotonic() - began
        threads = {}
        for t in Path(f"/proc/{child.pid}/task").iterdir():
            f = (t / "stat").read_text().rpartition(")")[2].split()
            threads[(t / "comm").read_text().strip() + t.name] = (int(f[11]), int(f[12]))
        print({k: v for k, v in threads.items() if sum(v) > 3}, file=sys.stderr)
        probe.destroy_node()
    return {
        "valves": valves, "sent": answers.sent, "lost": answers.lost, "late": answers.late, "cpu_share": spent / elapsed,
        "us_per_step": 1e6 * spent / answers.sent, "rate_hz": answers.sent / valves / elapsed,
        **{f"{n}_ms": 1e3 * float(np.percentile(answers.latency, p)) for n, p in (("p50", 50), ("p99", 99))},
    }  # fmt: skip


if __name__ == "__main__":
    import json, tempfile

    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rclpy.init()
    folder = Path(os.environ.get("FOLDER") or tempfile.mkdtemp())
    if sys.argv[1] == "lat":
        print(json.dumps(latencies(folder, int(sys.argv[2])), indent=1))
    else:
        os.sched_setaffinity(0, {0})
        for n in map(int, sys.argv[2:]):
            print(json.dumps(manifold(folder, n, 4.0)), flush=True)
