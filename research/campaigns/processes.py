# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Starts, watches and stops nodes of this package as processes, and keeps what they publish."""

import argparse
import os
import signal
import subprocess
import sys
import time
from array import array
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from tqdm import tqdm
from trajectory_msgs.msg import JointTrajectoryPoint

from valve_control import interrupts
from valve_control.arrays import Floats
from valve_control.axis.path import nanoseconds
from valve_control.axis.tables import ROS_NODES
from valve_control.control.parameters import files, ros_file
from valve_control.control.parameters.arguments import matches
from valve_control.nodes.adapter import (
    EVERYTHING,
    NumberSubscription,
    PolledSubscription,
    number_of,
)
from valve_control.nodes.transport import (
    ANYWHERE,
    RANGE,
    THIS_HOST,
    profile_variable,
    use_own_profile,
)
from valve_control.parameter import ParameterError, Values, defaults, updated

TOPICS = ("spool_command", "spool_position", "valve_voltage")


def leave_own_profile(environment: MutableMapping[str, str]) -> None:
    """Undo ``use_own_profile``: Fast DDS uses its usual transports."""
    variable = profile_variable(environment)
    profile = environment.get(variable)
    if profile in (ANYWHERE, THIS_HOST):
        del environment[variable]
    if profile == THIS_HOST:
        environment[RANGE] = "LOCALHOST"


def start(node: str, arguments: list[str], output: IO[bytes]) -> subprocess.Popen[bytes]:
    """Start a node of this package as a process that writes to the file ``output``."""
    return subprocess.Popen(
        [sys.executable, "-m", f"valve_control.nodes.{node}", "--ros-args", *arguments],
        stdout=output,
        stderr=subprocess.STDOUT,
        stdin=subprocess.DEVNULL,
        start_new_session=True,
    )


@contextmanager
def process(node: str, arguments: list[str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a node of this package as a process, which has ended when the block ends, whatever happens."""
    child: subprocess.Popen[bytes] | None = None
    with log.open("wb") as output:
        try:
            with interrupts.held_back():
                child = start(node, arguments, output)
            yield child
        finally:
            if child is not None:
                child.send_signal(signal.SIGTERM)
                try:
                    child.wait(5.0)
                except subprocess.TimeoutExpired:
                    child.kill()
                    child.wait()


def node_arguments(node: str, config: Sequence[str], settings: Mapping[str, Any]) -> list[str]:
    """``--params-file`` and ``-p`` arguments: what ``node`` has of ``settings`` and files of config/."""
    arguments = []
    for name in config:
        path = str(ros_file.config_folder() / name)
        if any(matches(section.pattern, f"/{node}") for section in ros_file.sections(path)):
            arguments += ["--params-file", path]
    table = {parameter.name: parameter for parameter in ROS_NODES[node]}
    for name, value in settings.items():
        if name in table:
            arguments += ["-p", f"{name}:={ros_file.as_text(table[name].check(value))}"]
    return arguments


def node_values(node: str, config: Sequence[str], settings: Mapping[str, Any]) -> Values:
    """All parameters of ``node`` under the same files and settings. Raises ParameterError."""
    table = ROS_NODES[node]
    changes: dict[str, Any] = {}
    for name in config:
        changes.update(files.load(str(ros_file.config_folder() / name), nodes=ROS_NODES)[node])
    names = {parameter.name for parameter in table}
    changes.update({name: value for name, value in settings.items() if name in names})
    return updated(table, defaults(table), changes)


class Listener(Node):
    """Keeps every message of some topics, fetched many at a time instead of one by one."""

    def __init__(self, name: str, topics: Sequence[str] = TOPICS) -> None:
        super().__init__(name)
        self._topics: dict[str, PolledSubscription] = {}
        self._points: dict[str, list[int]] = {}  # topic of a trajectory → times [ns] of its points
        self.values: dict[str, array[float]] = {}
        self.stamps: dict[str, array[int]] = {}
        self.sequence: dict[str, array[int]] = {}
        for topic in topics:
            self.listen(topic)

    def listen(self, topic: str) -> None:
        """Keep the messages of ``topic`` from now on."""
        self.values[topic] = array("d")
        self.stamps[topic] = array("q")
        self.sequence[topic] = array("q")
        if topic.endswith("spool_trajectory"):
            self._points[topic] = []
            self._topics[topic] = PolledSubscription(self, JointTrajectoryPoint, topic, EVERYTHING)
        else:
            self._topics[topic] = NumberSubscription(self, topic, EVERYTHING)

    def fetch(self) -> None:
        """Take what has arrived since the last call."""
        for topic, subscription in self._topics.items():
            for value, info in subscription.take():
                if topic in self._points:
                    self._points[topic].append(nanoseconds(value.time_from_start))
                self.values[topic].append(value.positions[0] if topic in self._points else value)
                self.stamps[topic].append(info["source_timestamp"])
                self.sequence[topic].append(number_of(info))

    def arrays(self, topic: str) -> tuple[Floats, Floats]:
        """Values [V] and source times [s] of ``topic``; of points their own times, by the same clock."""
        stamps = np.array(self.stamps[topic])
        if topic in self._points:
            points = np.array(self._points[topic])
            stamps = points + np.min(stamps - points)  # the soonest one was sent in time
        return np.array(self.values[topic]), stamps * 1e-9


def wait_until(
    condition: Callable[[], bool], what: str, children: Sequence[Any], limit: float = 30.0
) -> None:
    """Poll ``condition``. Raises RuntimeError after ``limit`` [s] or when a child has ended."""
    end = time.monotonic() + limit
    while not condition():
        if any(child.poll() is not None for child in children):
            raise RuntimeError(f"a node ended during the wait for {what}")
        if time.monotonic() > end:
            raise RuntimeError(f"{what} did not appear within {limit:g} s")
        time.sleep(0.02)


def bar(what: str, total: float, unit: str = "s") -> Any:
    """Progress bar that also suits a log file."""
    terminal = sys.stderr.isatty()
    return tqdm(
        total=total,
        desc=f"{what:12}",
        unit=unit,
        bar_format=f"{{desc}} {{bar}} {{n:.1f}}/{{total:.1f}} {unit}",
        ascii=not terminal,
        mininterval=0.1 if terminal else 2.0,
    )


def tool_options(name: str, text: str | None, controllers: Sequence[str]) -> argparse.ArgumentParser:
    """Command line that all tools have."""
    options = argparse.ArgumentParser(prog=name, description=text)
    options.add_argument("--out", default="out", metavar="FOLDER", help="output folder (out)")
    options.add_argument(
        "--only", choices=controllers, action="append", help="one controller; again for more"
    )
    return options


def parse_tool(options: argparse.ArgumentParser) -> argparse.Namespace:
    """Arguments of a tool, without ROS arguments."""
    return options.parse_args(remove_ros_args(sys.argv)[1:])


def run_tool(name: str, folder: Path, work: Callable[[], int]) -> int:
    """Run ``work`` in a ROS context and a domain of its own, on this host; returns the exit status."""
    os.environ.setdefault(RANGE, "LOCALHOST")
    use_own_profile(os.environ)
    # A domain of its own: no running system is disturbed, none disturbs the tool.
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        print(f"{name}: output folder {folder} cannot be made: {error.strerror}", file=sys.stderr)
        return 1

    def tool() -> int:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        try:
            return work()
        except (RuntimeError, ParameterError, OSError) as error:
            if not interrupts.come():
                print(f"{name}: {error}; the nodes' logs are in {folder}", file=sys.stderr)
            return 1

    try:
        status = interrupts.run(tool, signal.SIGINT, signal.SIGTERM)
    finally:
        rclpy.try_shutdown()
    if interrupts.come():
        print("\nstopped; no node is left running", file=sys.stderr)
    return status
