"""The main job, shown: the cascade of three processes over DDS, for each controller in turn."""

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import rclpy
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64
from tqdm import tqdm

from valve_control.analysis.figures import Trace, draw_traces
from valve_control.analysis.indices import PAPER_TABLE_1, Indices, indices
from valve_control.cli import HEADER, index_row
from valve_control.nodes.adapter import PolledSubscription
from valve_control.parameters import files
from valve_control.parameters.table import NODES, ParameterError, Values, defaults, updated
from valve_control.simulation import offline

Array = npt.NDArray[np.float64]
EVERYTHING = QoSProfile(depth=50000, reliability=ReliabilityPolicy.RELIABLE)
START_LIMIT = 30.0  # s
SHIFT_SAMPLES = 200  # over which readings and voltages are matched
SETTLE = 0.5  # s of the closed loop at rest before the command begins
TOPICS = ("spool_command", "spool_position", "valve_voltage")


class Job(NamedTuple):
    """One run of the cascade."""

    name: str
    group: str
    files: tuple[str, ...]
    settings: dict[str, Any]  # of the command source and of the valve, over the files


TABLE_1 = "point to point (Table 1, Fig. 5)"
SINE = "6 Hz sine, model (3) (Fig. 4)"
# The controller and the demo itself listen; the upper level runs in step with the LVDT.
PACE = {"listeners": 2, "trigger": "spool_position"}
SINE_SETTINGS = {"scenario": "sine", "amplitude": 1.0, "frequency": 6.0, "duration": 6.0}
JOBS = (
    Job("arc", TABLE_1, ("arc.yaml", "d3fxe.yaml", "command_source.yaml"), PACE),
    Job("oarc", TABLE_1, ("oarc.yaml", "d3fxe.yaml", "command_source.yaml"), PACE),
    Job("pid", TABLE_1, ("pid.yaml", "d3fxe.yaml", "command_source.yaml"), PACE),
    Job(
        "compensator",
        SINE,
        ("compensator.yaml",),
        {**PACE, **SINE_SETTINGS, "lvdt.noise": 0.0056, "lvdt.resolution": 0.0037},
    ),
)


class Measured(NamedTuple):
    """What the middleware carried during the command."""

    period: float  # s
    command: Array  # V
    measurement: Array  # V
    voltage: Array  # V
    latency: Array  # s, from publication of the reading to publication of its voltage
    lost: int  # LVDT readings without a voltage
    rate: float  # LVDT readings per second
    lead: int  # voltages that the controller had published before the first command
    joined: int  # readings that the simulator had published before the controller's first voltage


def config_folder() -> Path:
    """Folder of the YAML files: of the installed package, or of the source tree."""
    source = Path(__file__).resolve().parents[2] / "config"
    if source.is_dir():
        return source
    try:
        return Path(get_package_share_directory("valve_control")) / "config"
    except PackageNotFoundError:
        return Path(sys.prefix) / "share" / "valve_control" / "config"


@contextmanager
def process(node: str, arguments: list[str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A node of this package as a process; it has ended, whatever happens, when the block ends."""
    with log.open("wb") as output:
        child = subprocess.Popen(
            [sys.executable, "-m", f"valve_control.nodes.{node}", "--ros-args", *arguments],
            stdout=output,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            yield child
        finally:
            child.send_signal(signal.SIGTERM)
            try:
                child.wait(5.0)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()


def values_of(job: Job) -> dict[str, Values]:
    """All parameters of the three nodes in ``job``. Raises ParameterError."""
    changes: dict[str, dict[str, Any]] = {node: {} for node in NODES}
    for name in job.files:
        for node, values in files.load(str(config_folder() / name)).items():
            changes[node].update(values)
    for name, value in job.settings.items():
        for node, table in NODES.items():
            if any(parameter.name == name for parameter in table):
                changes[node][name] = value
    return {node: updated(table, defaults(table), changes[node]) for node, table in NODES.items()}


def node_arguments(job: Job, node: str) -> list[str]:
    """``--params-file`` and ``-p`` arguments of one node."""
    arguments = []
    for name in job.files:
        arguments += ["--params-file", str(config_folder() / name)]
    names = {parameter.name for parameter in NODES[node]}
    for name, value in job.settings.items():
        if name in names:
            arguments += ["-p", f"{name}:={value}"]
    return arguments


class Listener(Node):
    """Keeps every message of the three topics, fetched now and then instead of one by one."""

    def __init__(self) -> None:
        super().__init__("demo")
        self._topics = {topic: PolledSubscription(self, Float64, topic, EVERYTHING) for topic in TOPICS}
        self.values: dict[str, list[float]] = {topic: [] for topic in TOPICS}
        self.stamps: dict[str, list[int]] = {topic: [] for topic in TOPICS}
        self.sequence: dict[str, list[int]] = {topic: [] for topic in TOPICS}

    def fetch(self) -> None:
        """Take what has arrived since the last call."""
        for topic, subscription in self._topics.items():
            for message, info in subscription.take():
                self.values[topic].append(message.data)
                self.stamps[topic].append(info["source_timestamp"])
                self.sequence[topic].append(info["publication_sequence_number"])

    def arrays(self, topic: str) -> tuple[Array, Array]:
        """Values [V] and source times [s] of ``topic``."""
        return np.array(self.values[topic]), np.array(self.stamps[topic]) * 1e-9


def wait_until(condition: Callable[[], bool], what: str, children: list[Any]) -> None:
    """Poll ``condition``. Raises RuntimeError after START_LIMIT or when a child has ended."""
    limit = time.monotonic() + START_LIMIT
    while not condition():
        if any(child.poll() is not None for child in children):
            raise RuntimeError(f"a node ended while the demo waited for {what}")
        if time.monotonic() > limit:
            raise RuntimeError(f"{what} did not appear within {START_LIMIT:g} s")
        time.sleep(0.02)


def answer_shift(reading_times: Array, voltage_times: Array) -> int:
    """By how many entries the first of ``reading_times`` [s] lies before its answer in ``voltage_times``.

    One voltage answers one reading, so the shift is constant as long as none is lost; it is the one with
    which voltages follow readings after the shortest positive median time.
    """
    near = int(np.searchsorted(voltage_times, reading_times[0]))
    n = min(SHIFT_SAMPLES, len(reading_times))
    lags = {
        shift: float(np.median(voltage_times[shift : shift + n] - reading_times[:n]))
        for shift in range(max(0, near - 5), near + 6)
        if len(voltage_times) >= shift + n
    }
    return min((shift for shift, lag in lags.items() if lag > 0.0), key=lags.__getitem__)


def measure(listener: Listener, period: float, duration: float) -> Measured:
    """Align the three topics over ``duration`` [s] from the first command on."""
    commands, command_times = listener.arrays("spool_command")
    readings, reading_times = listener.arrays("spool_position")
    voltages, voltage_times = listener.arrays("valve_voltage")
    inside = np.flatnonzero(
        (reading_times >= command_times[0]) & (reading_times < command_times[0] + duration)
    )
    first = answer_shift(reading_times[inside], voltage_times)
    last = answer_shift(reading_times[inside[-SHIFT_SAMPLES:]], voltage_times)
    lost = len(inside) - min(SHIFT_SAMPLES, len(inside)) - (last - first)
    answers = np.minimum(first + np.arange(len(inside)), len(voltages) - 1)
    newest = np.searchsorted(command_times, reading_times[inside], side="right") - 1
    reading_number = listener.sequence["spool_position"][int(inside[0])]
    voltage_number = listener.sequence["valve_voltage"][first]
    span = float(reading_times[inside[-1]] - reading_times[inside[0]])
    return Measured(
        period,
        commands[newest],
        readings[inside],
        voltages[answers],
        voltage_times[answers] - reading_times[inside],
        lost,
        (len(inside) - 1) / span,
        voltage_number - 1,
        reading_number - voltage_number,
    )


def run_cascade(job: Job, folder: Path, progress: tqdm) -> Measured:
    """Start the three nodes, let the command run once through, stop them."""
    values = values_of(job)
    duration = float(str(values["command_source"]["duration"]))
    period = float(str(values["controller"]["sample_period"]))
    log = {node: folder / f"{job.name}_{node}.log" for node in NODES}
    listener = Listener()
    try:
        with process("controller", node_arguments(job, "controller"), log["controller"]) as controller:
            with process(
                "valve_simulator", node_arguments(job, "valve_simulator"), log["valve_simulator"]
            ) as simulator:
                children = [controller, simulator]
                need = round(SETTLE / period)

                def closed() -> bool:
                    listener.fetch()
                    return all(len(listener.values[topic]) >= need for topic in TOPICS[1:])

                wait_until(closed, "the closed loop", children)
                with process(
                    "command_source",
                    node_arguments(job, "command_source"),
                    log["command_source"],
                ) as source:
                    children.append(source)

                    def begun() -> bool:
                        listener.fetch()
                        return len(listener.values["spool_command"]) > 0

                    wait_until(begun, "the command", children)
                    _watch(listener, duration, progress, children)
            _drain(listener)
        return measure(listener, period, duration)
    finally:
        listener.destroy_node()


def _watch(listener: Listener, duration: float, progress: tqdm, children: list[Any]) -> None:
    began = time.monotonic()
    shown = 0.0
    while shown < duration:
        time.sleep(0.1)
        listener.fetch()
        if any(child.poll() is not None for child in children):
            raise RuntimeError("a node ended in the middle of the run; see its log in the output folder")
        now = min(time.monotonic() - began, duration)
        progress.update(now - shown)
        shown = now
    time.sleep(0.2)
    listener.fetch()


def _drain(listener: Listener) -> None:
    """Fetch until every reading has its voltage or nothing more comes."""
    for _ in range(20):
        listener.fetch()
        if len(listener.values["valve_voltage"]) >= len(listener.values["spool_position"]):
            return
        time.sleep(0.02)


def offline_twin(job: Job, lead: int, joined: int) -> Indices:
    """Indices of the same run without middleware: same LVDT noise, same ``lead`` samples of standstill."""
    values = values_of(job)
    command = np.concatenate([np.zeros(lead), offline.commands(values["command_source"])])
    run = offline.simulate(values["controller"], values["valve_simulator"], command, noise_start=joined)
    return indices((run.measurement - run.command)[lead:], run.voltage[lead:], run.period)


def report(jobs: list[tuple[Job, Measured]], folder: Path) -> None:
    """Print the tables, write JSON and figure."""
    result: list[dict[str, Any]] = []
    print(f"\n{HEADER}")
    for job, run in jobs:
        over_dds = indices(run.measurement - run.command, run.voltage, run.period)
        twin = offline_twin(job, run.lead, run.joined)
        worst = max(abs(a / b - 1.0) for a, b in zip(over_dds, twin, strict=True) if b != 0.0)
        print(index_row(job.name, over_dds))
        print(index_row("  offline", twin))
        paper = PAPER_TABLE_1.get(job.name)
        if paper is not None:
            print(index_row("  paper", paper))
        p50, p99 = np.percentile(run.latency, [50, 99])
        result.append(
            {
                "controller": job.name,
                "scenario": job.group,
                "indices": over_dds._asdict(),
                "offline": twin._asdict(),
                "paper": paper._asdict() if paper is not None else None,
                "worst_deviation_from_offline": worst,
                "samples": len(run.measurement),
                "lost": run.lost,
                "rate_hz": run.rate,
                "latency_s": {"p50": p50, "p99": p99, "max": float(np.max(run.latency))},
            }
        )
    print(
        f"\n{'':14}{'rate [Hz]':>10}{'samples':>9}{'lost':>6}"
        f"{'LVDT to voltage [ms]: p50':>28}{'p99':>8}{'max':>8}"
    )
    for entry in result:
        ms = {k: 1e3 * v for k, v in entry["latency_s"].items()}
        print(
            f"{entry['controller']:14}{entry['rate_hz']:10.1f}{entry['samples']:9d}{entry['lost']:6d}"
            f"{ms['p50']:28.3f}{ms['p99']:8.3f}{ms['max']:8.3f}"
        )
    print()
    for entry in result:
        print(
            f"{entry['controller']}: largest deviation of an index from the offline run "
            f"{100.0 * entry['worst_deviation_from_offline']:.1f} %"
        )
    (folder / "demo.json").write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    groups: dict[str, dict[str, Trace]] = {}
    for job, run in jobs:
        time_axis = np.arange(len(run.command), dtype=np.float64) * run.period
        groups.setdefault(job.group, {})[job.name] = Trace(
            time_axis, run.command, run.measurement, run.voltage
        )
    draw_traces(folder / "demo.png", groups, "valve_control: the cascade over DDS at 1 kHz")
    print(f"\nwrote {folder / 'demo.png'}, {folder / 'demo.json'} and the nodes' logs")


def main() -> int:
    """Entry point of `make demo` and of `ros2 run valve_control demo`."""
    options = argparse.ArgumentParser(prog="demo", description=__doc__)
    options.add_argument("--out", default="out", metavar="FOLDER", help="output folder (out)")
    options.add_argument(
        "--only", choices=[job.name for job in JOBS], action="append", help="one controller; again for more"
    )
    arguments, _ = options.parse_known_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    # A domain of its own: no running system is disturbed, none disturbs the demo.
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    folder = Path(arguments.out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        print(f"demo: output folder {folder} cannot be made: {error.strerror}", file=sys.stderr)
        return 1
    jobs = [job for job in JOBS if arguments.only is None or job.name in arguments.only]
    # SIGTERM unwinds like Ctrl-C, so that the children are stopped.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    done = []
    try:
        for job in jobs:
            duration = float(str(values_of(job)["command_source"]["duration"]))
            with tqdm(
                total=duration,
                desc=f"{job.name:12}",
                unit="s",
                bar_format="{desc} {bar} {n:.1f}/{total:.1f} s",
                ascii=not sys.stderr.isatty(),
                mininterval=0.1 if sys.stderr.isatty() else 2.0,
            ) as progress:
                done.append((job, run_cascade(job, folder, progress)))
        report(done, folder)
    except KeyboardInterrupt:
        print("\nstopped; no node is left running", file=sys.stderr)
        return 130
    except (RuntimeError, ParameterError, OSError) as error:
        print(f"demo: {error}; the nodes' logs are in {folder}", file=sys.stderr)
        return 1
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
