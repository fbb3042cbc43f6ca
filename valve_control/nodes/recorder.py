# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs the node `recorder`: writes topics and parameters of the cascade into a bag that survives kills."""

import os
import re
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from heapq import merge
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

from valve_control import outputs, parameter
from valve_control.control.parameters.table import RECORDER
from valve_control.nodes.adapter import (
    EVERYTHING,
    Diagnostics,
    ParameterSet,
    PolledSubscription,
    number_of,
)
from valve_control.nodes.definitions import Definition, Definitions, message_class
from valve_control.nodes.loop import Failure, Worker, run
from valve_control.nodes.parameter_capture import EVENTS, ParameterCapture, full_name
from valve_control.parameter import ParameterError, Values, items, word
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.writer import BagWriter, check, usual

DIAGNOSTICS = "/diagnostics"
EVENT_TYPE = "rcl_interfaces/msg/ParameterEvent"
# What is recorded unless ``topics`` says otherwise, with the types that the nodes of this package use.
CASCADE: Mapping[str, str] = {
    r"(.*/)?(spool_command|spool_position|valve_voltage)": "std_msgs/msg/Float64",
    r"(.*/)?spool_trajectory": "trajectory_msgs/msg/JointTrajectoryPoint",
    r"(.*/)?joint_states": "sensor_msgs/msg/JointState",
    r"(.*/)?pressure_[ab]": "sensor_msgs/msg/FluidPressure",
    r"(.*/)?axis_goal": "trajectory_msgs/msg/JointTrajectoryPoint",
    r"(.*/)?joint_trajectory": "trajectory_msgs/msg/JointTrajectory",
    r"(.*/)?goal_position": "std_msgs/msg/Float64",
    r".*/controller/(state|journal)": "std_msgs/msg/Float64MultiArray",
    r".*/controller/memory": "std_msgs/msg/String",
    DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
    "/clock": "rosgraph_msgs/msg/Clock",
}
POLL = 0.01  # s between two looks at what has come
LOOK = 0.2  # s between two looks at the graph
LINGER = 0.2  # s to take the last words of nodes that are stopped together with the recorder
STATUS_PERIOD = 1.0  # s between two diagnostics, unless something changes
LAST_WORD = 0.2  # s for the last diagnostics to arrive
MB = 1e6  # bytes


class Settings(NamedTuple):
    """The recorder's parameters in use."""

    folder: Path
    storage: str
    patterns: Sequence[re.Pattern[str]]
    chosen: bool  # whether the patterns are the user's


def settings(values: Values) -> Settings:
    """Settings from the recorder's values. Raises ParameterError."""
    storage, compression = word(values, "storage"), word(values, "compression")
    storage = usual() if storage == "auto" else storage
    try:
        check(storage, compression)
    except BagError as error:
        raise ParameterError(str(error)) from error
    patterns = []
    chosen = [str(item) for item in items(values, "topics") if item]
    for text in chosen or CASCADE:
        try:
            patterns.append(re.compile(text))
        except re.error as error:
            raise ParameterError(f"topics has '{text}', which is no regular expression: {error}") from error
    folder = Path(os.path.expanduser(word(values, "bag")) or time.strftime("valve_bag_%Y%m%d_%H%M%S"))
    return Settings(folder, storage, patterns, bool(chosen))


def offered(profile: QoSProfile) -> Qos:
    """A publisher's QoS profile in the form of rosbag2's metadata."""
    deadline, lifespan, lease = (
        QosTime(*divmod(duration.nanoseconds, 10**9))
        for duration in (profile.deadline, profile.lifespan, profile.liveliness_lease_duration)
    )
    return Qos(
        history=QosHistory[profile.history.name],
        depth=profile.depth,
        reliability=QosReliability[profile.reliability.name],
        durability=QosDurability[profile.durability.name],
        deadline=deadline,
        lifespan=lifespan,
        liveliness=QosLiveliness[profile.liveliness.name],
        liveliness_lease_duration=lease,
        avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions,
    )


def wanted(profiles: Sequence[QoSProfile]) -> tuple[ReliabilityPolicy, DurabilityPolicy]:
    """Strongest QoS that all publishers offer."""
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
    latched = profiles and all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
    return (
        ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


class Recorded:
    """A topic that is recorded."""

    def __init__(self, node: Worker, name: str, type_name: str, message_type: Any) -> None:
        self.name = name
        self.type_name = type_name
        self._node = node
        self._type = message_type
        self._qos: tuple[ReliabilityPolicy, DurabilityPolicy] | None = None
        self.subscription: PolledSubscription | None = None

    def adapt(self, profiles: Sequence[QoSProfile]) -> list[tuple[Any, dict[str, Any]]]:
        """Subscribe with a QoS that matches all publishers; returns what waited on the old subscription."""
        qos = wanted(profiles)
        if self._qos is not None:
            # Never back to a stricter one: the lax one matches all.
            qos = (max(self._qos[0], qos[0]), max(self._qos[1], qos[1]))
            if qos == self._qos:
                return []
            self._node.get_logger().warning(
                f"{self.name}: a publisher offers less ({qos[0].name}, {qos[1].name}) than was subscribed; "
                "subscribed anew, messages of this moment may be lost"
            )
        self._qos = qos
        before = self.subscription
        profile = QoSProfile(depth=EVERYTHING.depth, reliability=qos[0], durability=qos[1])
        self.subscription = PolledSubscription(self._node, self._type, self.name, profile, raw=True)
        if before is None:
            return []
        rest = list(before.take())
        before.destroy()
        return rest


class Recorder(Worker):
    """Subscribes to matching topics as they appear, polls them, and writes their messages into the bag."""

    def __init__(self) -> None:
        super().__init__("recorder")
        fixed = {parameter.name for parameter in RECORDER}
        chosen = ParameterSet(self, RECORDER, settings, fixed=fixed)
        use = self._settings = chosen.built
        self._flush_period = parameter.number(chosen.values, "flush_period")
        self._topics: dict[str, Recorded] = {}
        self._left_out: set[str] = set()
        self._warnings: set[str] = set()  # that hold now
        self._diagnostics = Diagnostics(self)
        self._definitions = Definitions()
        self._failed = False
        try:
            self._writer = BagWriter(use.folder, use.storage, compression=word(chosen.values, "compression"))
        except BagError as error:
            raise ParameterError(str(error)) from error
        self._captured = ParameterCapture(self, self._write_parameters)
        self._record(EVENTS, EVENT_TYPE, self.get_publishers_info_by_topic(EVENTS))
        now = time.monotonic()
        self._next = self._look_at = now
        self._flush_at = now + self._flush_period
        self._status_at = now
        self.get_logger().info(f"records into {outputs.shown(use.folder)}")

    # Work

    def due(self) -> float:
        """Time [s] of the next poll."""
        return self._next

    def work(self) -> bool:
        """Write waiting messages; now and then flush, look for new topics, publish the status."""
        now = time.monotonic()
        if now < self._next:
            return False
        self._next = now + POLL
        try:
            taken = self._take()
            if now >= self._look_at:
                self._look_at = now + LOOK
                self._look()
            self._captured.collect()
            if now >= self._flush_at:
                self._flush_at = now + self._flush_period
                self._writer.check_place()
                self._writer.flush()
        except BagError as error:
            self._fail(str(error))
        if now >= self._status_at:
            self._publish_status()
        return taken

    def _take(self) -> bool:
        """Write all waiting messages in the order of their arrival, each topic's in its own."""
        taken = [
            [
                (info["received_timestamp"] or time.time_ns(), topic, data, info)
                for data, info in topic.subscription.take()
            ]
            for topic in self._topics.values()
            if topic.subscription is not None
        ]
        for received, topic, data, info in merge(*taken, key=itemgetter(0)):
            self._write(topic, received, data, info)
        return any(taken)

    def _write(self, topic: Recorded, received: int, data: bytes, info: dict[str, Any]) -> None:
        if topic.name == EVENTS:
            self._captured.observe(data)
        sent = info["source_timestamp"] or received
        self._writer.write(topic.name, received, sent, number_of(info), data)

    def _write_parameters(self, data: bytes) -> None:
        now = time.time_ns()
        self._writer.write(EVENTS, now, now, 0, self._definitions.trimmed(data, EVENT_TYPE))

    def _fail(self, reason: str) -> NoReturn:
        self._failed = True
        reason = outputs.printable(reason)
        self._diagnostics.tell(DiagnosticStatus.ERROR, reason, self._figures())
        raise Failure(reason)

    # The graph

    def _look(self) -> None:
        """Subscribe to new topics, and warn at once of what is not recorded."""
        warnings = set()
        for name, _ in self.get_topic_names_and_types():
            known = name in self._topics or any(p.fullmatch(name) for p in self._settings.patterns)
            if not known or name in self._left_out:
                continue
            infos = self.get_publishers_info_by_topic(name)
            type_name = self._topics[name].type_name if name in self._topics else self._type_of(name, infos)
            ours = [info for info in infos if info.topic_type == type_name]
            if ours and name not in self._topics:
                self._record(name, type_name, ours)
            if topic := self._topics.get(name):
                for data, info in topic.adapt([info.qos_profile for info in ours]) if ours else ():
                    self._write(topic, info["received_timestamp"] or time.time_ns(), data, info)
            warnings |= {
                f"{name} is published as {info.topic_type} by {full_name(info)}: "
                f"these messages are not recorded, the bag takes {type_name}"
                for info in infos
                if info.topic_type != type_name
            }
        for text in sorted(warnings - self._warnings):
            self.get_logger().warning(text)
        if warnings != self._warnings:
            self._warnings = warnings
            self._publish_status()
        self._captured.look()

    def _type_of(self, name: str, infos: Sequence[Any]) -> str:
        """Type with which this package's nodes use a topic, else the most frequent one.

        A topic of theirs that nobody publishes with their type waits, unless the user chose the topics.
        """
        types = Counter(info.topic_type for info in infos)
        usual = next((kind for pattern, kind in CASCADE.items() if re.fullmatch(pattern, name)), None)
        if usual is not None and (usual in types or not self._settings.chosen):
            return usual
        return types.most_common(1)[0][0] if types else ""

    def _record(self, name: str, type_name: str, infos: Sequence[Any]) -> None:
        """Subscribe to a topic and announce it to the bag, unless its type is not installed."""
        topic = None
        try:
            topic = Recorded(self, name, type_name, message_class(type_name))
            topic.adapt([info.qos_profile for info in infos])
        except Exception as error:  # rclpy has several kinds for a type that it cannot use
            self._left_out.add(name)
            self.get_logger().warning(f"{name} is not recorded: {error}")
            return
        try:
            definition = self._definitions.get(type_name)
        except LookupError as error:
            self.get_logger().warning(f"{name} is recorded without definition: {error}")
            definition = Definition("", "")
        told = [text for text in (str(info.topic_type_hash) for info in infos) if text.startswith("RIHS")]
        self._writer.add_topic(
            name,
            type_name,
            definition.text,
            told[0] if told else definition.type_hash,
            [offered(info.qos_profile) for info in infos],
        )
        self._topics[name] = topic
        self.get_logger().info(f"records {name} ({type_name})")

    # What is said

    def _publish_status(self) -> None:
        """Publish diagnostics: what is recorded, and what is not."""
        self._status_at = time.monotonic() + STATUS_PERIOD
        level, text = DiagnosticStatus.OK, "recording"
        if self._warnings:
            level, text = DiagnosticStatus.WARN, "; ".join(sorted(self._warnings))
        self._diagnostics.tell(level, text, self._figures())

    def _figures(self) -> dict[str, Any]:
        return {
            "bag": outputs.shown(self._settings.folder),
            "topics": len(self._topics),
            "messages": self._writer.message_count,
            "MB": f"{self._writer.total_bytes / MB:.1f}",
        }

    def deliver(self) -> None:
        """Wait until the reason of the end has arrived."""
        if self._failed:
            self._diagnostics.publisher.wait_for_all_acked(Duration(seconds=LAST_WORD))

    def finish(self) -> None:
        """Write waiting messages, and finish the bag."""
        error: BagError | None = None
        try:
            end = time.monotonic() + (0.0 if self._failed else LINGER)
            while time.monotonic() < end:
                self._take()
                time.sleep(POLL)
            if not self._failed:
                self._look()
            self._writer.close()
        except BagError as wrong:
            error = wrong
        counts = self._writer.counts
        for name in sorted(self._topics):
            self.get_logger().info(f"{name}: {counts[name]} messages")
        for name in self._captured.unanswered():
            self.get_logger().warning(
                f"the bag lacks the parameters of {name}, which did not answer; it has their changes"
            )
        self.get_logger().info(
            f"{self._writer.message_count} messages in {outputs.shown(self._settings.folder)}"
        )
        if error is not None:
            raise error


def main() -> int:
    """Entry point of `ros2 run valve_control recorder`."""
    return run(lambda: [Recorder()])


if __name__ == "__main__":
    sys.exit(main())
