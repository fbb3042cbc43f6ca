"""Node `recorder`: topics and parameters of the cascade into a rosbag2 bag that outlives its recorder."""

import os
import re
import shutil
import sys
import time
from collections.abc import MutableMapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from valve_control.bags.errors import BagError
from valve_control.bags.metadata import Qos, Span
from valve_control.bags.writer import BagWriter, check
from valve_control.nodes.adapter import ParameterSet, PolledSubscription
from valve_control.nodes.cascade import EVERYTHING
from valve_control.nodes.definitions import Definition, Definitions, message_class
from valve_control.nodes.loop import Failure, Worker, run
from valve_control.nodes.snapshots import EVENTS, Snapshots
from valve_control.parameters import build
from valve_control.parameters.table import RECORDER, ParameterError, Values

CASCADE = (
    r"(.*/)?(spool_command|spool_position|valve_voltage)",
    r".*/controller/(state|memory|journal)",
    "/diagnostics",
    "/clock",
)
EVENT_TYPE = "rcl_interfaces/msg/ParameterEvent"
POLL = 0.01  # s between two looks at what has come
LOOK = 0.2  # s between two looks at the graph
LINGER = 0.2  # s to take the last words of nodes that are stopped together with the recorder
MB = 1e6  # bytes


class Settings(NamedTuple):
    """The parameters in use."""

    folder: Path
    storage: str
    compression: str
    patterns: Sequence[re.Pattern[str]]
    max_bytes: int
    max_seconds: float  # s
    flush_period: float  # s
    min_free: float  # bytes
    report_period: float  # s


def settings(values: Values) -> Settings:
    """Settings from the recorder's values. Raises ParameterError."""
    storage, compression = build.word(values, "storage"), build.word(values, "compression")
    try:
        check(storage, compression)
    except BagError as error:
        raise ParameterError(str(error)) from error
    patterns = []
    for text in [str(item) for item in build.items(values, "topics") if item] or CASCADE:
        try:
            patterns.append(re.compile(text))
        except re.error as error:
            raise ParameterError(f"topics has '{text}', which is no regular expression: {error}") from error
    bag = build.word(values, "bag") or time.strftime("valve_bag_%Y%m%d_%H%M%S")
    return Settings(
        folder=Path(bag).expanduser(),
        storage=storage,
        compression=compression,
        patterns=patterns,
        max_bytes=round(build.number(values, "max_size") * MB),
        max_seconds=build.number(values, "max_duration"),
        flush_period=build.number(values, "flush_period"),
        min_free=build.number(values, "min_free") * MB,
        report_period=build.number(values, "report_period"),
    )


def span(duration: Duration) -> Span:
    """Duration as rosbag2 writes it."""
    return Span(*divmod(duration.nanoseconds, 10**9))


def offered(profile: QoSProfile) -> Qos:
    """Profile of a publisher as rosbag2 writes it."""
    return Qos(
        history=profile.history.name.lower(),
        depth=profile.depth,
        reliability=profile.reliability.name.lower(),
        durability=profile.durability.name.lower(),
        deadline=span(profile.deadline),
        lifespan=span(profile.lifespan),
        liveliness=profile.liveliness.name.lower(),
        liveliness_lease_duration=span(profile.liveliness_lease_duration),
        avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions,
    )


def wanted(profiles: Sequence[QoSProfile]) -> tuple[ReliabilityPolicy, DurabilityPolicy]:
    """The most that all publishers offer."""
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
    latched = profiles and all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
    return (
        ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


class Recorded:
    """A topic that is recorded."""

    def __init__(self, node: Worker, name: str, message_type: Any) -> None:
        self.name = name
        self._node = node
        self._type = message_type
        self._publishers: set[bytes] = set()
        self._number: int | None = None  # of the last message
        self._missing = 0  # numbers since the last look at the publishers
        self._qos: tuple[ReliabilityPolicy, DurabilityPolicy] | None = None
        self.subscription: PolledSubscription | None = None
        self.lost = 0

    def adapt(self, profiles: Sequence[QoSProfile]) -> list[tuple[Any, dict[str, Any]]]:
        """Subscribe so that all publishers match; what waited on a subscription that this replaces."""
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

    def count(self, number: int) -> None:
        """See whether numbers are missing before ``number``."""
        if self._number is not None and number > self._number:
            self._missing += number - self._number - 1
        self._number = number

    def look(self, publishers: set[bytes]) -> None:
        """Numbers tell something only if the same single publisher gave them all."""
        if len(publishers) == 1 and publishers == self._publishers:
            self.lost += self._missing
        else:
            self._number = None
        self._missing = 0
        self._publishers = publishers


class Recorder(Worker):
    """Subscribes to what matches as it appears, polls it, and writes it down."""

    def __init__(self) -> None:
        super().__init__("recorder")
        self._values: Values = {}
        ParameterSet(self, RECORDER, self._fixed, self._apply)
        use = self._settings
        self._topics: dict[str, Recorded] = {}
        self._left_out: set[str] = set()
        self._definitions = Definitions()
        self._failed = False
        self._check_room(use.folder.absolute().parent)
        try:
            self._writer = BagWriter(
                use.folder, use.storage, use.max_bytes, use.max_seconds, use.compression, self._on_new_file
            )
        except BagError as error:
            raise ParameterError(str(error)) from error
        self._snapshots = Snapshots(self, self._write_snapshot)
        self._record(EVENTS, EVENT_TYPE)
        now = time.monotonic()
        self._next = self._look_at = now
        self._flush_at = now + use.flush_period
        self._report_at = now + use.report_period
        self._reported = (now, time.process_time(), 0)
        self.get_logger().info(f"records into {use.folder.absolute()}")

    def _fixed(self, values: Values) -> Settings:
        if self._values and values != self._values:
            raise ParameterError("the parameters of a running recorder do not change; start it again")
        return settings(values)

    def _apply(self, values: Values, built: Settings) -> None:
        self._values = values
        self._settings = built

    # Work

    def due(self) -> float:
        """The next look at what has come."""
        return self._next

    def work(self) -> bool:
        """Write what has come; now and then flush, look at the graph, report."""
        now = time.monotonic()
        if now < self._next:
            return False
        self._next = now + POLL
        try:
            taken = self._take()
            if now >= self._look_at:
                self._look_at = now + LOOK
                self._look()
            self._snapshots.collect()
            if now >= self._flush_at:
                self._flush_at = now + self._settings.flush_period
                self._writer.flush()
                self._check_room(self._settings.folder)
        except BagError as error:
            self._fail(str(error))
        if now >= self._report_at:
            self._report_at = now + self._settings.report_period
            self._report(now)
        return taken

    def _take(self) -> bool:
        """Write all that waits in the order of its arrival."""
        taken = [
            (info["received_timestamp"] or time.time_ns(), topic, data, info)
            for topic in self._topics.values()
            if topic.subscription is not None
            for data, info in topic.subscription.take()
        ]
        taken.sort(key=itemgetter(0))
        for received, topic, data, info in taken:
            self._write(topic, received, data, info)
        return bool(taken)

    def _write(self, topic: Recorded, received: int, data: bytes, info: dict[str, Any]) -> None:
        number = info["publication_sequence_number"]
        topic.count(number)
        if topic.name == EVENTS:
            self._snapshots.observe(data)
        self._writer.write(topic.name, received, info["source_timestamp"] or received, number, data)

    def _write_snapshot(self, data: bytes) -> None:
        now = time.time_ns()
        self._writer.write(EVENTS, now, now, 0, self._definitions.trimmed(data, EVENT_TYPE))

    def _on_new_file(self) -> None:
        self.get_logger().info(f"goes on in {self._writer.path.name}")
        self._snapshots.write_all()

    def _check_room(self, folder: Path) -> None:
        while not folder.exists():
            folder = folder.parent
        free = shutil.disk_usage(folder).free
        if free < self._settings.min_free:
            self._fail(
                f"the recording ends: the disk of {folder} has {free / MB:.0f} MB free, "
                f"less than min_free, {self._settings.min_free / MB:g} MB"
            )

    def _fail(self, reason: str) -> NoReturn:
        self._failed = True
        raise Failure(reason)

    # The graph

    def _look(self) -> None:
        """Subscribe to what is new, and see who publishes."""
        for name, types in self.get_topic_names_and_types():
            if name not in self._topics and any(p.fullmatch(name) for p in self._settings.patterns):
                self._record(name, types[0])
        for name, topic in self._topics.items():
            infos = self.get_publishers_info_by_topic(name)
            topic.look({bytes(info.endpoint_gid) for info in infos})
            for data, info in topic.adapt([info.qos_profile for info in infos]) if infos else ():
                self._write(topic, info["received_timestamp"] or time.time_ns(), data, info)
        self._snapshots.look()

    def _record(self, name: str, type_name: str) -> None:
        """Subscribe to a topic and announce it to the bag, unless its type is not installed."""
        if name in self._left_out:
            return
        infos = self.get_publishers_info_by_topic(name)
        if not infos and name != EVENTS:
            return
        topic = None
        try:
            topic = Recorded(self, name, message_class(type_name))
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
        hashes = [str(info.topic_type_hash) for info in infos if info.topic_type == type_name]
        told = [text for text in hashes if text.startswith("RIHS")]
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

    def _report(self, now: float) -> None:
        messages, used = self._writer.message_count, time.process_time()
        began, used_before, before = self._reported
        self._reported = (now, used, messages)
        self.get_logger().info(
            f"{messages} messages, {(messages - before) / (now - began):.0f}/s, "
            f"{self._writer.total_bytes / MB:.1f} MB, {self._lost()} lost, "
            f"CPU {100.0 * (used - used_before) / (now - began):.1f} %"
        )

    def _lost(self) -> int:
        return sum(topic.lost for topic in self._topics.values())

    def finish(self) -> None:
        """Take what waits, and end the bag."""
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
        for name, topic in sorted(self._topics.items()):
            self.get_logger().info(f"{name}: {counts[name]} messages, {topic.lost} lost")
        for name in self._snapshots.unanswered():
            self.get_logger().warning(
                f"the bag lacks the parameters of {name}, which did not answer; it has their changes"
            )
        files = f"{self._writer.files} file{'s' if self._writer.files != 1 else ''}"
        self.get_logger().info(
            f"{self._writer.message_count} messages in {files} of {self._settings.folder.absolute()}"
        )
        if error is not None:
            raise error


def use_own_profile(environment: MutableMapping[str, str]) -> None:
    """Have Fast DDS use the recorder's profile, unless the user has a choice of his own."""
    own = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS")
    if not any(environment.get(name) for name in own):
        environment[own[0]] = str(Path(__file__).with_name("recorder_dds.xml"))


def main() -> int:
    """Entry point of `ros2 run valve_control recorder`."""
    use_own_profile(os.environ)
    return run(lambda: [Recorder()])


if __name__ == "__main__":
    sys.exit(main())
