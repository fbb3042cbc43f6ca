# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Measures whether the cascade stands still while other processes join its DDS domain and are killed.

A standstill is a pause in the readings, commands or voltages, as they are sent and as they are received, less
the time that the nodes waited for a core meanwhile: what is left was made by the middleware.
"""

import os
import signal
import subprocess
import sys
import time
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rclpy

from research.campaigns.processes import (
    TOPICS,
    Listener,
    bar,
    leave_own_profile,
    node_arguments,
    parse_tool,
    process,
    run_tool,
    tool_options,
    wait_until,
)
from valve_control import outputs
from valve_control.design.priority import yield_cores
from valve_control.nodes.adapter import SAMPLES, NumberSubscription

NODES = ("controller", "valve_simulator", "command_source")
CONFIG = ("d3fxe.yaml", "command_source.yaml")
# Who must run for a message of a topic; the simulator paces all.
PARTIES = {
    "spool_position": ("valve_simulator",),
    "spool_command": ("valve_simulator", "command_source"),
    "valve_voltage": ("valve_simulator", "controller"),
}
SETTINGS: dict[str, Any] = {
    "scenario": "sine",
    "amplitude": 2.0,
    "frequency": 1.5,
    "start": 0.0,
    "duration": 600.0,
    "trigger": "spool_position",
    "state_decimation": 0,
}
AT_ONCE = 4
LIFE = (0.05, 0.4)  # s from the first message that a joiner hears to its death
JOIN = 20.0  # s after which one that has heard nothing is killed nevertheless
ALLOWED = 0.02  # s, longest standstill
SHOWN = 0.005  # s, shorter pauses are none
LOOK = 0.01  # s between two looks at what has come and who waited for a core
POLL = 0.001  # s
QUIET = 5.0  # s before the first one joins


class Life(NamedTuple):
    """One joining process."""

    pid: int
    told: int  # file descriptor on which it tells that it has heard something
    limit: float  # s, when it is killed if it has heard nothing
    lasts: float  # s, how long it lives from its first message on


def join(told: int, foreign: bool) -> None:
    """Subscribe to the cascade until the process is killed; ``foreign``: over Fast DDS's usual transports."""
    if foreign:
        leave_own_profile(os.environ)
    rclpy.init(args=[])
    node = rclpy.create_node(f"joiner_{os.getpid()}")
    topics = [NumberSubscription(node, topic, SAMPLES) for topic in TOPICS]
    while not any(1 for topic in topics for _ in topic.take()):
        time.sleep(POLL)
    os.write(told, b"1")
    while True:
        for topic in topics:
            for _ in topic.take():
                pass
        time.sleep(POLL)


def only_work(told: int, seconds: float) -> None:
    """Use as much CPU time as a joining process does, without joining."""
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass
    os.write(told, b"1")
    time.sleep(JOIN)


def send_them(kills: int, alone: float, costs: Path) -> None:
    """Start joining processes, AT_ONCE at a time, and kill each soon after it has received something.

    To be called in a process without a ROS context. ``alone`` [s]: they do not join, but work for so long.
    ``costs``: file that gets the CPU time [s] of each; Fast DDS writes messages of its own to the output.
    """
    table = costs.open("w", buffering=1)
    random = np.random.default_rng(1)
    living: list[Life] = []
    deaths: dict[int, float] = {}
    begun = killed = 0
    while killed < kills:
        while len(living) < AT_ONCE and begun < kills:
            hear, told = os.pipe()
            pid = os.fork()
            if pid == 0:
                try:
                    if alone > 0.0:
                        only_work(told, alone)
                    join(told, foreign=begun % 2 == 1)
                finally:
                    os._exit(1)
            os.close(told)
            os.set_blocking(hear, False)
            living.append(Life(pid, hear, time.monotonic() + JOIN, float(random.uniform(*LIFE))))
            begun += 1
        now = time.monotonic()
        for life in list(living):
            if life.pid not in deaths:
                with suppress(BlockingIOError):
                    os.read(life.told, 1)
                    deaths[life.pid] = now + life.lasts
            if now > min(life.limit, deaths.get(life.pid, life.limit)):
                os.kill(life.pid, signal.SIGKILL)
                _, _, used = os.wait4(life.pid, 0)
                os.close(life.told)
                living.remove(life)
                killed += 1
                table.write(f"{used.ru_utime + used.ru_stime}\n")
        time.sleep(POLL)


class Crowd:
    """Joining processes that another process starts and kills."""

    def __init__(self, child: subprocess.Popen[bytes], costs: Path) -> None:
        self.child = child
        self._costs = costs

    def costs(self) -> list[float]:
        """CPU time [s] of each that was killed so far."""
        return [float(line) for line in self._costs.read_text().splitlines(True) if line.endswith("\n")]

    def over(self) -> bool:
        """Whether all have been started and killed."""
        return self.child.poll() is not None


@contextmanager
def crowd(kills: int, log: Path, alone: float = 0.0) -> Iterator[Crowd]:
    """``kills`` processes that join the cascade of this domain and are killed; none is left after the block.

    ``alone`` [s]: they do not join, but work for so long.
    """
    costs = log.with_suffix(".cpu_s")
    costs.write_text("")
    text = (
        "from pathlib import Path; from research.campaigns.joiners import send_them; "
        f"send_them({kills}, {alone!r}, Path({str(costs)!r}))"
    )
    with log.open("wb") as output:
        child = subprocess.Popen(
            [sys.executable, "-c", text],
            stdout=output,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
            preexec_fn=yield_cores,
        )
        try:
            yield Crowd(child, costs)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGKILL)
            child.wait()


def machine_standstill() -> float:
    """Time [s] since its start in which the machine ran nothing though something was to be run.

    That is what a hypervisor took of its cores, and what all processes together waited for disk and memory.
    """
    stolen = float(Path("/proc/stat").read_text().split()[8]) / os.sysconf("SC_CLK_TCK")
    for resource in ("io", "memory"):
        with suppress(OSError):  # a kernel without this count
            full = Path(f"/proc/pressure/{resource}").read_text().splitlines()[1]
            stolen += 1e-6 * float(full.rpartition("=")[2])
    return stolen


class Waits:
    """Time that the threads of processes have waited for a core, as the kernel counts it."""

    def __init__(self, pids: Mapping[str, int]) -> None:
        self.names = tuple(pids)
        self._pids = pids
        self._times: list[float] = []
        self._standstill: list[float] = []
        self._waits: dict[str, list[dict[str, float]]] = {name: [] for name in pids}

    def look(self) -> None:
        """Read the kernel's counts."""
        self._times.append(time.time())
        self._standstill.append(machine_standstill())
        for name, pid in self._pids.items():
            threads = {}
            for task in Path(f"/proc/{pid}/task").iterdir():
                with suppress(OSError):
                    threads[task.name] = 1e-9 * int((task / "schedstat").read_text().split()[1])
            self._waits[name].append(threads)

    def between(self, names: Sequence[str], begin: float, end: float) -> float:
        """Time [s] that processes ``names`` waited for a core between the looks around ``begin`` and ``end``.

        Of each the thread that waited longest counts: a message goes from process to process. The machine's
        own standstill counts too.
        """
        first = max(0, int(np.searchsorted(self._times, begin)) - 1)
        last = min(len(self._times) - 1, int(np.searchsorted(self._times, end)))
        return (
            self._standstill[last]
            - self._standstill[first]
            + sum(
                max(waited - before.get(thread, 0.0) for thread, waited in after.items())
                for name in names
                for before, after in ((self._waits[name][first], self._waits[name][last]),)
            )
        )


class Ear(Listener):
    """Listener that also keeps the times at which it received."""

    def __init__(self, name: str) -> None:
        self.received: dict[str, array[int]] = {topic: array("q") for topic in TOPICS}
        super().__init__(name)

    def fetch(self) -> None:
        """Take what has arrived since the last call."""
        for topic, subscription in self._topics.items():
            for number, info in subscription.take():
                self.values[topic].append(number)
                self.stamps[topic].append(info["source_timestamp"])
                self.received[topic].append(info["received_timestamp"])


def pauses(times: Sequence[int], begin: float, end: float) -> list[tuple[float, float]]:
    """Begin and end [s] of the pauses longer than SHOWN between ``times`` [ns]."""
    seconds = 1e-9 * np.asarray(times, dtype=np.float64)
    seconds = seconds[(seconds >= begin) & (seconds <= end)]
    where = np.flatnonzero(np.diff(seconds) > SHOWN)
    return [(float(seconds[i]), float(seconds[i + 1])) for i in where]


def judge(ear: Ear, waits: Waits, begin: float, end: float) -> dict[str, Any]:
    """Longest pauses and standstills [s] of each topic from ``begin`` to ``end``."""
    found: dict[str, Any] = {}
    for topic, parties in PARTIES.items():
        for kind, times, names in (
            ("sent", ear.stamps[topic], parties),
            ("received", ear.received[topic], (*parties, "ear")),
        ):
            gaps = pauses(times, begin, end)
            still = [b - a - waits.between(names, a, b) for a, b in gaps]
            found[f"{topic} {kind}"] = {
                "longest_pause_s": max([b - a for a, b in gaps], default=0.0),
                "longest_standstill_s": max([0.0, *still]),
                "pauses": sum(b - a > ALLOWED for a, b in gaps),
                "standstills": sum(s > ALLOWED for s in still),
            }
    return found


def text(result: Mapping[str, Any]) -> str:
    """One part of the measurement as a table in text."""
    lines = [f"{result['name']:28}{'pause [ms]':>12}{'standstill':>12}{'above 20 ms':>14}"]
    for name, entry in result.items():
        if isinstance(entry, dict):
            pause, still = (1e3 * entry[f"longest_{key}_s"] for key in ("pause", "standstill"))
            lines.append(f"{name:28}{pause:12.1f}{still:12.1f}{entry['standstills']:14d}")
    return "\n".join(lines)


def measure(kills: int, folder: Path) -> list[dict[str, Any]]:
    """Measure the cascade left alone, with joining processes, and with as much other work."""
    logs = {node: folder / f"joiners_{node}.log" for node in NODES}
    results: list[dict[str, Any]] = []
    ear = Ear("joiners")
    try:
        with ExitStack() as stack:
            children = {
                node: stack.enter_context(process(node, node_arguments(node, CONFIG, SETTINGS), logs[node]))
                for node in NODES
            }
            waits = Waits({**{node: child.pid for node, child in children.items()}, "ear": os.getpid()})

            def flows() -> bool:
                ear.fetch()
                return all(len(values) > 1000 for values in ear.values.values())

            wait_until(flows, "the closed loop", list(children.values()))

            def watch(name: str, over: Callable[[], bool], progress: Callable[[], int]) -> None:
                begin = time.time()
                with bar(name, float(kills), "kills") as shown:
                    while not over():
                        ear.fetch()
                        waits.look()
                        shown.update(progress() - shown.n)
                        if any(child.poll() is not None for child in children.values()):
                            raise RuntimeError("a node ended")
                        time.sleep(LOOK)
                end = time.time()
                results.append({"name": name, "seconds": end - begin, **judge(ear, waits, begin, end)})

            until = time.monotonic() + QUIET
            watch("alone", lambda: time.monotonic() > until, lambda: 0)
            print(f"\n{text(results[-1])}", flush=True)
            costs: list[float] = []
            for name in ("joiners", "other work"):
                cost = sum(costs) / len(costs) if costs else 0.0
                with crowd(kills, folder / f"{name.replace(' ', '_')}.txt", cost) as crew:
                    watch(name, crew.over, lambda c=crew: len(c.costs()))  # type: ignore[misc]
                    costs = crew.costs()
                    if len(costs) < kills:
                        raise RuntimeError(f"{len(costs)} of {kills} joiners were killed")
                    results[-1] |= {"kills": len(costs), "cpu_s_each": sum(costs) / len(costs)}
                print(text(results[-1]), flush=True)
    finally:
        ear.destroy_node()
    return results


def main() -> int:
    """Entry point of `make joiners`."""
    options = tool_options("joiners", __doc__, ())
    options.add_argument("--kills", type=int, default=200, metavar="N", help="processes that join (200)")
    arguments = parse_tool(options)
    if not 1 <= arguments.kills <= 100000:
        options.error(f"--kills is {arguments.kills}; it must lie between 1 and 100000")
    folder = Path(arguments.out)

    def work() -> int:
        results = measure(arguments.kills, folder)
        path = folder / "joiners.json"
        outputs.write(str(path), outputs.as_json(results))
        print(f"\nwrote {path} and the nodes' logs")
        worst = max(entry["longest_standstill_s"] for entry in results[1].values() if isinstance(entry, dict))
        if worst > ALLOWED:
            print(f"FAILED: a standstill of {1e3 * worst:.1f} ms while others joined", file=sys.stderr)
        return 1 if worst > ALLOWED else 0

    return run_tool("joiners", folder, work)


if __name__ == "__main__":
    sys.exit(main())
