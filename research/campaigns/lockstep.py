# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs three processes in lockstep over DDS, and compares them bit for bit with the same run offline."""

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from research.campaigns.processes import (
    Listener,
    bar,
    node_arguments,
    node_values,
    parse_tool,
    process,
    run_tool,
    tool_options,
    wait_until,
)
from valve_control import outputs
from valve_control.arrays import Floats
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters import build
from valve_control.control.simulation import offline
from valve_control.control.simulation.offline import Run
from valve_control.nodes.adapter import needs_numbers

CONFIG = ("d3fxe.yaml", "command_source.yaml")
# Controller, source and this tool listen to the reading; the source waits for the controller alone.
FIXED: dict[str, dict[str, Any]] = {
    "controller": {"lockstep": True, "lvdt.frozen_samples": 0, "state_decimation": 0},
    "command_source": {"trigger": "lockstep", "listeners": 1},
    "valve_simulator": {"clock": "lockstep", "listeners": 3},
}
Told = Callable[[Mapping[str, Any], int], None]  # processes by node, and the samples done
MEET = 1.0  # s in which everyone discovers everyone
LISTENED = ("spool_position", "valve_voltage")
STALL = 20.0  # s without a sample after which the run is given up
MEMORY_EVERY = 10.0  # s
HEARD = 0.99  # share that this tool must have heard; a writer keeps 10 messages for a slow listener


def memory(pid: int) -> int:
    """Resident memory of a process [kB]."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    return int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmRSS")))


class Heard(NamedTuple):
    """Signals of a lockstep run of the nodes, and the same run offline."""

    twin: Run
    samples: dict[str, Floats]  # V, by topic, NaN where no message was heard
    result: dict[str, Any]  # for JSON


def run_lockstep(
    name: str,
    config: Sequence[str],
    settings: Mapping[str, Mapping[str, Any]],
    folder: Path,
    watch: Told = lambda children, done: None,
) -> Heard:
    """Run the nodes in lockstep for the command's duration; ``settings`` by node win over ``config``.

    ``watch`` gets the processes by node and the samples done, again and again. Raises RuntimeError if the run
    stalls.
    """
    own = {node: {**settings.get(node, {}), **fixed} for node, fixed in FIXED.items()}
    values = {node: node_values(node, config, own[node]) for node in own}
    command = build.commands(values["command_source"])
    twin = offline.simulate(values["controller"], values["valve_simulator"], command)
    listener = Listener("lockstep", ("valve_voltage",))
    try:
        with ExitStack() as stack:
            processes = {}
            for node in own:
                log = folder / f"lockstep_{name}_{node}.log"
                processes[node] = stack.enter_context(
                    process(node, node_arguments(node, config, own[node]), log)
                )
            resident = _heard_out(name, listener, processes, twin, watch)
    finally:
        listener.destroy_node()
    samples = {}
    for topic in LISTENED:
        numbers = np.array(listener.sequence[topic]) - 1
        inside = numbers < len(command)
        samples[topic] = np.full(len(command), np.nan)
        samples[topic][numbers[inside]] = listener.arrays(topic)[0][inside]
    differing: list[int] = []
    for topic, expected in zip(LISTENED, (twin.measurement, twin.voltage), strict=True):
        got = samples[topic]
        differing += np.flatnonzero(np.isfinite(got) & (got != expected)).tolist()
    voltage, stamps = samples["valve_voltage"], listener.arrays("valve_voltage")[1]
    took = stamps[-1] - stamps[0]
    made = listener.sequence["valve_voltage"][-1] - listener.sequence["valve_voltage"][0]
    result = {
        "name": name,
        "controller": twin.controller,
        "samples": len(command),
        "heard": {topic: int(np.count_nonzero(np.isfinite(got))) for topic, got in samples.items()},
        "equal": not differing,
        "first_difference": min(differing) if differing else None,
        "voltage_at_end_V": float(voltage[np.isfinite(voltage)][-1]),
        "offline_voltage_at_end_V": float(twin.voltage[-1]),
        "wall_s": float(took),
        "samples_per_s": float(made / took),
        "times_real_time": float(made * twin.period / took),
        "resident_kB": {node: [row[i] for row in resident] for i, node in enumerate(own)},
    }
    return Heard(twin, samples, result)


def _heard_out(
    name: str, listener: Listener, processes: Mapping[str, Any], twin: Run, watch: Told
) -> list[list[int]]:
    """Listen until all samples of ``twin`` are done; the memory [kB] of the ``processes`` now and then."""
    children, period, wanted = list(processes.values()), twin.period, len(twin.command)
    resident: list[list[int]] = []
    with bar(name, wanted * period) as progress:
        wait_until(lambda: listener.count_publishers("valve_voltage") == 1, "the controller", children)
        wait_until(lambda: listener.count_publishers("spool_position") == 1, "the simulator", children)
        time.sleep(MEET)
        # The simulator begins when the last of its listeners is there, which is this one.
        listener.listen("spool_position")
        voltages = listener.sequence["valve_voltage"]
        done = 0
        moved = time.monotonic()
        look = moved + MEMORY_EVERY / 2.0
        while done < wanted:
            listener.fetch()
            if voltages and voltages[-1] == 0:
                raise RuntimeError(needs_numbers("lockstep"))
            now = time.monotonic()
            before, done = done, min(voltages[-1] if voltages else 0, wanted)
            if done > before:
                moved = now
                progress.update(min((done - before) * period, wanted * period - progress.n))
            elif now - moved > STALL:
                raise RuntimeError(f"{name}: lockstep stands still at sample {done}")
            if any(child.poll() is not None for child in children):
                raise RuntimeError(f"{name}: a node ended at sample {done}")
            if now >= look:
                look = now + MEMORY_EVERY
                resident.append([memory(child.pid) for child in children])
            watch(processes, done)
            time.sleep(0.05)
    return resident


def heard_enough(result: Mapping[str, Any]) -> bool:
    """Whether the tool received nearly all messages of a run."""
    return bool(min(result["heard"].values()) >= HEARD * result["samples"])


def check(results: Sequence[Mapping[str, Any]]) -> bool:
    """Whether all runs equal those offline; prints which do not. Raises RuntimeError if too little came."""
    for result in results:
        if not heard_enough(result):
            raise RuntimeError(f"{result['name']}: too few messages heard: {result['heard']}")
        if not result["equal"]:
            print(
                f"{result['name']}: differs from the offline run from sample {result['first_difference']} on",
                file=sys.stderr,
            )
    return all(result["equal"] for result in results)


def main() -> int:
    """Entry point of `make lockstep`."""
    options = tool_options("lockstep", __doc__, tuple(LAWS))
    options.add_argument("--duration", type=float, default=60.0, metavar="S", help="valve time [s] (60)")
    options.add_argument(
        "--starts", type=int, default=1, metavar="N", help="runs of each controller, in new processes (1)"
    )
    arguments = parse_tool(options)
    if not 1 <= arguments.starts <= 100000:
        options.error(f"--starts is {arguments.starts}; it must lie between 1 and 100000")
    if not 0.01 <= arguments.duration <= 1e5:
        options.error(f"--duration is {arguments.duration:g} s; it must lie between 0.01 and 100000 s")
    folder = Path(arguments.out)

    def work() -> int:
        results = []
        for controller in arguments.only or LAWS:
            settings = {
                "controller": {"controller": controller},
                "command_source": {"duration": arguments.duration},
            }
            for start in range(1, arguments.starts + 1):
                name = controller if arguments.starts == 1 else f"{controller}_{start}"
                results.append(run_lockstep(name, CONFIG, settings, folder).result)
        print(f"\n{'controller':14}{'samples':>10}{'equal':>7}{'samples/s':>11}{'x real time':>13}", end="")
        print(f"{'memory [MB]':>16}")
        for result in results:
            rows = result["resident_kB"]["controller"]
            grown = f"{rows[0] / 1e3:.1f} → {rows[-1] / 1e3:.1f}" if rows else "-"
            print(
                f"{result['name']:14}{result['samples']:10d}{'yes' if result['equal'] else 'NO':>7}"
                f"{result['samples_per_s']:11.0f}{result['times_real_time']:13.2f}{grown:>16}"
            )
        path = folder / "lockstep.json"
        outputs.write(str(path), outputs.as_json(results))
        print(f"\nwrote {path} and the nodes' logs")
        return 0 if check(results) else 1

    return run_tool("lockstep", folder, work)


if __name__ == "__main__":
    sys.exit(main())
