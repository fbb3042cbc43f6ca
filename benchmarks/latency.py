# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The loop: LVDT-to-voltage latency of the controller's process against an echo; 2 kHz; many valves.

A probe stands in for LVDT and upper level: it sends readings and commands of an offline run at their times,
and takes the voltages. The latency is from its clock before it publishes a reading to the source time of the
voltage. All candidates live at once and are asked in turns, so that all see the same machine; the beginning
of a turn, when a controller recovers from the silence before it and says so, does not count. Probe and echoes
have the transports of everybody else, shared memory among them; the controllers those of the package.
"""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy._rclpy_pybind11 import WaitSet
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64
from tqdm import tqdm

from benchmarks.echo import ECHOES
from research.campaigns.processes import leave_own_profile, process, wait_until
from valve_control.control.parameters import build
from valve_control.control.parameters.table import NODES
from valve_control.control.simulation import offline
from valve_control.nodes import realtime
from valve_control.nodes.adapter import SAMPLES, NumberSubscription, encoded
from valve_control.nodes.transport import RANGE, use_own_profile
from valve_control.parameter import defaults, updated

Floats = npt.NDArray[np.float64]
LAWS = ("arc", "oarc")
SHARED = "arc_shared"  # ARC with the transports of everybody else
# The echoes that the laws are compared with: one with the QoS of the controller, one reliable on both sides.
COMPARED = {"echo": "plain", "reliable_echo": "reliable"}
RATE = 0.98  # of the nominal one that the probe must reach
WANTED = {
    "latency_vs_echo_p50": ("at most", 1.15),
    "latency_vs_echo_p99": ("at most", 1.3),
    "latency_vs_reliable_echo_p50": ("at most", 1.15),
    "latency_vs_reliable_echo_p99": ("at most", 1.3),
    "lost_at_1khz": ("at most", 0),
    "lost_at_2khz": ("at most", 0),
    "rate_at_2khz": ("at least", RATE),
    "node_cost_dcarc_vs_oarc": ("at most", 1.3),
}
PERIOD = 0.001  # s
AHEAD = 0.3  # of a period by which a command comes before the reading
SILENCE = 20_000_000  # ns without a reading after which a controller switches off
LATE = 5.0  # s after which a service counts as not answered
LAST = 0.5  # s to wait for the last voltages
TURNS = 8  # for each candidate
TURN = 3.0  # s
LEAD = 2.0  # s before it
SECONDS = 4.0  # of everything else
MOST = 16  # valves that are tried
ROUNDS = 5  # of the cost of a law, in turns with another
TRIES = 3  # for a number of valves, since a busy machine may disturb one
IN_TIME = 0.95  # share of voltages that must come before the next reading


class Probe(Node):  # type: ignore[misc]  # mypy does not see rclpy
    """LVDT and upper level of one or more valves, each a namespace."""

    def __init__(self, name: str, valves: Sequence[str], commands: bool = True) -> None:
        super().__init__(name)
        self._heard = ("spool_command", "spool_position") if commands else ("spool_position",)
        self.sent = {
            topic: [self.create_publisher(Float64, f"/{valve}/{topic}", SAMPLES) for valve in valves]
            for topic in ("spool_command", "spool_position")
        }
        self.voltages = [NumberSubscription(self, f"/{v}/valve_voltage", SAMPLES) for v in valves]

    def connected(self) -> bool:
        """Whether every valve's controller is there."""
        heard = all(p.get_subscription_count() for topic in self._heard for p in self.sent[topic])
        return heard and all(v.handle.get_publisher_count() for v in self.voltages)

    def publish(self, topic: str, data: bytes) -> None:
        """To all valves."""
        for publisher in self.sent[topic]:
            publisher.publish(data)


class Answers(NamedTuple):
    """What came of readings."""

    latency: Floats  # s
    sent: int  # readings, of all valves
    lost: int  # readings without an answer
    elapsed: float  # s
    rate: float  # of the nominal one


def ask(probe: Probe, run: offline.Run, count: int, begin: int = 0, period: float = PERIOD) -> Answers:
    """``count`` readings of ``run`` from its sample ``begin`` on, one each ``period`` [s], to each valve."""
    valves = range(len(probe.voltages))
    wait_set = WaitSet(len(valves), 0, 0, 0, 0, 0, rclpy.get_default_context().handle)
    asked = np.zeros((count, len(valves)), np.int64)
    answered: list[list[int]] = [[] for _ in valves]
    for voltages in probe.voltages:  # of a silence between two turns
        for _ in voltages.take():
            pass
    began = time.monotonic()
    next_at = began + 2.0 * period
    for k in range(count):
        sample = (begin + k) % len(run.command)
        command, reading = encoded(run.command[sample]), encoded(run.measurement[sample])
        pause(next_at - AHEAD * period)
        probe.publish("spool_command", command)
        pause(next_at)
        for i, publisher in enumerate(probe.sent["spool_position"]):
            asked[k, i] = time.time_ns()
            publisher.publish(reading)
        next_at = max(next_at + period, time.monotonic())
        limit = time.monotonic() + LAST if k == count - 1 else next_at - AHEAD * period
        while (missing := [i for i in valves if len(answered[i]) <= k]) and (
            left := limit - time.monotonic()
        ) > 0.0:
            wait_set.clear_entities()
            for i in missing:
                wait_set.add_subscription(probe.voltages[i].handle)
            wait_set.wait(int(1e9 * left))
            for i in missing:
                answered[i].extend(info["source_timestamp"] for _, info in probe.voltages[i].take())
    latency = np.concatenate([paired(asked[:, i], answered[i]) for i in valves])
    elapsed = next_at - began
    return Answers(1e-9 * latency, asked.size, asked.size - len(latency), elapsed, count * period / elapsed)


def paired(asked: npt.NDArray[np.int64], answered: Sequence[int]) -> npt.NDArray[np.int64]:
    """Latencies [ns]: answers come in the order of the readings; one that comes while none waits is none.

    If an answer is missing, or came so late that the controller has given voltages of its own meanwhile, that
    order is lost: then a reading's answer is the first before the next.
    """
    found: list[int] = []
    for time_ns in answered:
        if len(found) < len(asked) and time_ns >= asked[len(found)]:
            found.append(time_ns - int(asked[len(found)]))
    if len(found) == len(asked) and max(found) < SILENCE:
        return np.array(found, np.int64)
    index = np.searchsorted(asked, answered, "right") - 1
    readings, first = np.unique(index, return_index=True)
    latency: npt.NDArray[np.int64] = np.array(answered, np.int64)[first] - asked[readings]
    return latency[readings >= 0]


def pause(until: float) -> None:
    """Sleep until ``until`` (`time.monotonic`)."""
    left = until - time.monotonic()
    if left > 0.0:
        time.sleep(left)


def recorded(controller: str, period: float = PERIOD) -> offline.Run:
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
    commands = build.commands(values["command_source"])
    return offline.simulate(values["controller"], values["valve_simulator"], commands)


def check_alive(children: Sequence[Any]) -> None:
    """Raise RuntimeError if a node has ended."""
    if any(child.poll() is not None for child in children):
        raise RuntimeError("a node ended during the measurement")


def figures(parts: Sequence[Answers]) -> dict[str, Any]:
    """Latency [ms] of all parts, and what was lost."""
    latency = 1e3 * np.concatenate([part.latency for part in parts])
    if not len(latency):
        raise RuntimeError("no reading was answered")
    p50, p99, most = np.percentile(latency, [50.0, 99.0, 100.0])
    return {
        "p50_ms": float(p50),
        "p99_ms": float(p99),
        "max_ms": float(most),
        "sent": sum(part.sent for part in parts),
        "lost": sum(part.lost for part in parts),
        "rate": min(part.rate for part in parts),
    }


@contextmanager
def transports_of_everybody() -> Iterator[None]:
    """Processes that are started, and a first context that is made, do not have the package's transports."""
    before = dict(os.environ)
    leave_own_profile(os.environ)
    os.environ["FASTDDS_BUILTIN_TRANSPORTS"] = "DEFAULT"
    try:
        yield
    finally:
        for name in os.environ.keys() - before.keys():
            del os.environ[name]
        os.environ.update(before)


@contextmanager
def candidate(kind: str, folder: Path, period: float = PERIOD) -> Iterator[Any]:
    """A process that answers readings in the namespace ``kind``."""
    space = ["-r", f"__ns:=/{kind}"]
    law = "arc" if kind == SHARED else kind
    if law in LAWS:
        given = [*space, "-p", f"controller:={law}", "-p", f"sample_period:={period!r}"]
        with ExitStack() as stack:
            with transports_of_everybody() if kind == SHARED else nullcontext():
                child = stack.enter_context(process("controller", given, folder / f"{kind}.log"))
            yield child
        return
    with (folder / f"{kind}.log").open("wb") as log:
        with transports_of_everybody():
            child = subprocess.Popen(
                [sys.executable, "-m", "benchmarks.echo", kind, "--ros-args", *space], stdout=log, stderr=log
            )
        try:
            yield child
        finally:
            child.terminate()
            child.wait()


def against_echo(folder: Path, turns: int = TURNS) -> dict[str, Any]:
    """Latency of the echoes and of the laws."""
    lead, count = round(LEAD / PERIOD), round(TURN / PERIOD)
    kinds = (*ECHOES, *LAWS, SHARED)
    run = recorded("arc")
    found: dict[str, list[Answers]] = {kind: [] for kind in kinds}
    with ExitStack() as stack:
        children = [stack.enter_context(candidate(kind, folder)) for kind in kinds]
        probes = {kind: Probe(f"probe_{kind}", [kind], commands=kind not in ECHOES) for kind in kinds}
        for probe in probes.values():
            stack.callback(probe.destroy_node)
        for kind, probe in probes.items():
            wait_until(probe.connected, kind, children)
        for turn in tqdm(range(turns), desc="latency", unit="turn", ascii=True):
            for kind, probe in probes.items():
                ask(probe, run, lead, turn * count)
                found[kind].append(ask(probe, run, count, turn * count + lead))
            check_alive(children)
    return {kind: figures(parts) for kind, parts in found.items()}


def at_2_khz(folder: Path, seconds: float = SECONDS) -> dict[str, Any]:
    """One valve under OARC, asked every 0.5 ms."""
    period = 0.0005
    run = recorded("oarc", period)
    with candidate("oarc", folder, period) as child:
        probe = Probe("probe_2_khz", ["oarc"])
        try:
            wait_until(probe.connected, "oarc", [child])
            ask(probe, run, round(1.0 / period), 0, period)
            return figures([ask(probe, run, round(seconds / period), round(1.0 / period), period)])
        finally:
            probe.destroy_node()


def services(folder: Path, seconds: float = SECONDS) -> dict[str, Any]:
    """Time [ms] to get a parameter from a controller that answers readings at 1 kHz meanwhile."""
    run = recorded("arc")
    times: list[float] = []
    over = threading.Event()

    def call() -> None:
        asker = Node("asker")
        client = asker.create_client(GetParameters, "/arc/controller/get_parameters")
        while not client.service_is_ready() and not over.is_set():
            over.wait(0.05)
        while not over.is_set():
            began = time.monotonic()
            future = client.call_async(GetParameters.Request(names=["arc.k1"]))
            rclpy.spin_until_future_complete(asker, future, timeout_sec=LATE)
            times.append(1e3 * (time.monotonic() - began) if future.done() else 1e3 * LATE)
            over.wait(0.05)
        asker.destroy_node()

    with candidate("arc", folder) as child:
        probe = Probe("probe_services", ["arc"])
        thread = threading.Thread(target=call)
        try:
            wait_until(probe.connected, "arc", [child])
            thread.start()
            try:
                ask(probe, run, round(seconds / PERIOD))
            finally:
                over.set()
                thread.join()
        finally:
            probe.destroy_node()
    if not times:
        raise RuntimeError("get_parameters was never answered")
    return {"p50_ms": float(np.median(times)), "max_ms": max(times), "calls": len(times)}


def cpu_seconds(pid: int) -> float:
    """CPU time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def manifold(folder: Path, valves: int, law: str = "arc") -> dict[str, Any]:
    """``valves`` controllers in one process on the last CPU."""
    names = [f"v{i}" for i in range(valves)]
    run = recorded(law)
    cpu = max(os.sched_getaffinity(0))
    given = [
        "-p",
        f"valves:=[{','.join(names)}]",
        "-p",
        f"controller:={law}",
        "-p",
        f"realtime.cpus:='{cpu}'",
    ]
    with process("manifold", given, folder / f"manifold_{valves}.log") as child:
        probe = Probe(f"probe_{valves}", names)
        try:
            wait_until(probe.connected, f"{valves} valves", [child])
            ask(probe, run, round(2.0 / PERIOD))  # accounts are given more often at the beginning
            spent = cpu_seconds(child.pid)
            answers = ask(probe, run, round(SECONDS / PERIOD), round(2.0 / PERIOD))
            spent = cpu_seconds(child.pid) - spent
        finally:
            probe.destroy_node()
    result = {
        "valves": valves,
        **figures([answers]),
        "cpu_share": spent / answers.elapsed,
        "us_per_step": 1e6 * spent / answers.sent,
    }
    in_time = float(np.sum(answers.latency <= PERIOD)) / answers.sent
    kept = result["lost"] == 0 and result["rate"] >= RATE and in_time >= IN_TIME
    return {**result, "in_time": in_time, "kept": kept}


def cost(folder: Path, rounds: int = ROUNDS) -> dict[str, list[float]]:
    """CPU time [µs] of a sample in the node under OARC and dcarc, in turns."""
    found: dict[str, list[float]] = {"oarc": [], "dcarc": []}
    for _ in tqdm(range(rounds), desc="cost of a law", unit="round", ascii=True):
        for law, spent in found.items():
            spent.append(manifold(folder, 1, law)["us_per_step"])
    return found


def manifolds(folder: Path) -> list[dict[str, Any]]:
    """More and more valves, until readings are lost or too many voltages come after the next reading."""
    found: list[dict[str, Any]] = []
    cpus = os.sched_getaffinity(0)
    others = tuple(cpus - {max(cpus)}) or tuple(cpus)
    realtime.obtain(realtime.Request(False, 0, others), print)
    try:
        for valves in range(1, MOST + 1):
            tries: list[dict[str, Any]] = []
            while len(tries) < TRIES and not (tries and tries[-1]["kept"]):
                tries.append(manifold(folder, valves))
            found.append({**tries[-1], "tries": len(tries)})
            print(
                f"{valves:8}{found[-1]['cpu_share']:12.2f}{found[-1]['us_per_step']:14.0f}"
                f"{found[-1]['p50_ms']:10.3f}{found[-1]['p99_ms']:10.3f}{found[-1]['lost']:8}"
                f"{100.0 * found[-1]['in_time']:11.1f} %",
                flush=True,
            )
            if not found[-1]["kept"]:
                break
    finally:
        realtime.obtain(realtime.Request(False, 0, tuple(cpus)), print)
    return found


def latency_table(latencies: Mapping[str, Mapping[str, Any]]) -> str:
    """One line a candidate, with its ratios to both echoes."""
    lines = [
        f"\n{'':12}{'':28}{'over plain (same QoS)':>24}{'over reliable echo':>24}",
        f"{'':12}{'p50 [ms]':>10}{'p99 [ms]':>10}{'lost':>8}" + 2 * f"{'p50':>12}{'p99':>12}",
    ]
    for name, entry in latencies.items():
        ratios = [
            entry[key] / latencies[echo][key] for echo in COMPARED.values() for key in ("p50_ms", "p99_ms")
        ]
        lines.append(
            f"{name:12}{entry['p50_ms']:10.3f}{entry['p99_ms']:10.3f}{entry['lost']:8}"
            + "".join(f"{ratio:12.2f}" for ratio in ratios)
        )
    return "\n".join(lines)


def run(folder: Path) -> dict[str, Any]:
    """Measure; tables, and the figures for JSON. Raises RuntimeError."""
    os.environ.setdefault(RANGE, "LOCALHOST")
    use_own_profile(os.environ)
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    with transports_of_everybody():
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # the benchmarks handle signals
    try:
        latencies = against_echo(folder)
        print(latency_table(latencies))
        fast = at_2_khz(folder)
        print(f"{'2 kHz':12}{fast['p50_ms']:10.3f}{fast['p99_ms']:10.3f}{fast['lost']:8}")
        asked = services(folder)
        print(f"get_parameters at 1 kHz: {asked['p50_ms']:.0f} ms, at most {asked['max_ms']:.0f} ms\n")
        spent = cost(folder)
        print(
            "CPU time of a sample: " + ", ".join(f"{law} {np.median(v):.0f} us" for law, v in spent.items())
        )
        print(
            f"{'valves':>8}{'CPU share':>12}{'us per step':>14}{'p50 [ms]':>10}{'p99 [ms]':>10}{'lost':>8}"
            f"{'in time':>13}"
        )
        grown = manifolds(folder)
    finally:
        rclpy.try_shutdown()
    return {
        "latency": latencies,
        "two_khz": fast,
        "services": asked,
        "manifold": grown,
        "us_per_sample": spent,
        "figures": {
            **{
                f"latency_vs_{named}_{name}": max(latencies[law][f"{name}_ms"] for law in LAWS)
                / latencies[echo][f"{name}_ms"]
                for named, echo in COMPARED.items()
                for name in ("p50", "p99")
            },
            "latency_udp_vs_shared_p50": latencies["arc"]["p50_ms"] / latencies[SHARED]["p50_ms"],
            "latency_udp_vs_shared_p99": latencies["arc"]["p99_ms"] / latencies[SHARED]["p99_ms"],
            "valves_at_1khz_per_core": max([entry["valves"] for entry in grown if entry["kept"]], default=0),
            "node_cost_dcarc_vs_oarc": float(np.median(spent["dcarc"]) / np.median(spent["oarc"])),
            "lost_at_1khz": sum(latencies[law]["lost"] for law in LAWS),
            "lost_at_2khz": fast["lost"],
            "rate_at_2khz": fast["rate"],
        },
    }
