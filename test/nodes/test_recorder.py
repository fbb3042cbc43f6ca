# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The recorder beside real nodes: nothing lost, parameters in the bag, killed at any moment."""

import itertools
import random
import resource
import shutil
import signal
import sqlite3
import time
from contextlib import ExitStack, closing

import pytest
import rclpy
import sizes
from bench import set_parameters, spin_until
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from mcap.reader import make_reader
from rcl_interfaces.msg import ParameterEvent
from rclpy.context import Context
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rosbags.highlevel import AnyReader
from std_msgs.msg import Float64, String

from research.campaigns.processes import process
from valve_control.nodes.definitions import Definitions
from valve_control.recordings.bags import metadata
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.recover import recover

EVENTS = "/parameter_events"
TOPICS = ("/spool_command", "/spool_position", "/valve_voltage", "/controller/state")
NODES = {
    "controller": ["-p", "state_decimation:=1"],
    "valve_simulator": ["-p", "lvdt.noise:=0.002"],
    "command_source": [
        "-p", "scenario:=sine", "-p", "frequency:=1.0", "-p", "duration:=200.0", "-p", "delay:=0.0",
    ],
}  # fmt: skip


@pytest.fixture
def cascade(tmp_path):
    with ExitStack() as stack:
        for node, arguments in NODES.items():
            stack.enter_context(process(node, arguments, tmp_path / f"{node}.log"))
        yield


def recorder(folder, log, *settings):
    arguments = [word for setting in (f"bag:={folder}", *settings) for word in ("-p", setting)]
    return process("recorder", arguments, log)


def stop(child):
    child.send_signal(signal.SIGINT)
    assert child.wait(20.0) == 0


def file_messages(path):
    """(topic, log time, sequence, data) of each message of one file.

    A kill in the middle of a transaction of SQLite can leave messages whose sequence numbers were not yet
    written. They are recovered; their sequence is None.
    """
    if path.suffix == ".mcap":
        with path.open("rb") as stream:
            return [
                (c.topic, m.log_time, m.sequence, m.data)
                for _, c, m in make_reader(stream, validate_crcs=True).iter_messages()
            ]
    with sqlite3.connect(f"file:{path}?immutable=1", uri=True) as database:
        return database.execute(
            "SELECT name, timestamp, sequence, data FROM messages JOIN topics ON topic_id = topics.id"
            " LEFT JOIN valve_control_times ON message_id = messages.id ORDER BY messages.id"
        ).fetchall()


def finished(folder, out):
    """A finished copy of a growing or killed bag, None where it has no message yet."""
    try:
        return recover(folder, out).out
    except BagError:
        return None


def by_topic(folder):
    found = {}
    for name in metadata.read(folder).files if folder is not None else ():
        for topic, *rest in file_messages(folder / name):
            found.setdefault(topic, []).append(tuple(rest))
    return found


def topics(folder):
    with AnyReader([folder]) as reader:
        return {connection.topic for connection in reader.connections}


def gaps(messages):
    numbers = list(itertools.takewhile(lambda number: number is not None, (m[1] for m in messages)))
    assert all(number is None for _, number, _ in messages[len(numbers) :])  # only the last transaction
    return sum(b - a - 1 for a, b in zip(numbers, numbers[1:], strict=False))


def snapshots(messages):
    """Node → parameters of the recorder's own events, which have no number."""
    events = [deserialize_message(data, ParameterEvent) for _, number, data in messages if number == 0]
    return {event.node: {p.name: p.value for p in event.new_parameters} for event in events}


def has_recorded(log, *topics):
    return lambda: all(f"records {topic} (" in log.read_text() for topic in topics)


def has_parameters(log):
    return lambda: all(f"parameters of /{node}" in log.read_text() for node in NODES)


def flows(folder, storage):
    """Whether messages of all topics are in the growing bag, as somebody else sees it.

    That may be seconds after the recorder has subscribed: a writer may learn of its new reader late.
    """
    if storage == "sqlite3":
        try:
            with closing(sqlite3.connect(f"file:{folder / folder.name}_0.db3?mode=ro", uri=True)) as database:
                query = "SELECT name FROM topics JOIN messages ON topic_id = topics.id GROUP BY name"
                return set(TOPICS) <= {name for (name,) in database.execute(query)}
        except sqlite3.OperationalError:
            return False
    if not sum(path.stat().st_size for path in folder.glob("*.mcap")) > 50_000:
        return False
    copy = folder.with_name(f"copy_{time.monotonic_ns()}")
    return set(TOPICS) <= set(by_topic(finished(folder, copy)))


@pytest.mark.alone
@pytest.mark.parametrize("storage", ["mcap", pytest.param("sqlite3", marks=pytest.mark.campaign)])
def test_cascade_at_1_khz_without_loss(ros, tmp_path, cascade, storage):
    folder, log = tmp_path / "bag", tmp_path / "log"
    with recorder(folder, log, f"storage:={storage}") as child:
        spin_until(ros, lambda: flows(folder, storage), "messages of all topics")
        spin_until(ros, has_parameters(log), "parameters")
        begun = time.monotonic()
        assert set_parameters(ros, arc__k1=100.0).successful
        spin_until(ros, lambda: time.monotonic() > begun + 3.0, "three seconds")
        stop(child)
    text = log.read_text()
    assert "Traceback" not in text
    found = by_topic(folder)
    for topic in TOPICS:
        assert gaps(found[topic]) == 0, topic
        assert len(found[topic]) > 2700 and f"{topic}: {len(found[topic])} messages" in text
        times = [t for t, _, _ in found[topic]]
        assert times == sorted(times)
    parameters = snapshots(found[EVENTS])
    assert parameters["/controller"]["arc.k1"].double_value == 120.0
    assert parameters["/controller"]["state_decimation"].integer_value == 1
    assert parameters["/valve_simulator"]["lvdt.noise"].double_value == 0.002
    assert parameters["/command_source"]["scenario"].string_value == "sine"
    assert "/recorder" not in parameters
    changes = [deserialize_message(data, ParameterEvent) for _, number, data in found[EVENTS] if number > 0]
    assert [p.value.double_value for e in changes for p in e.changed_parameters if p.name == "arc.k1"] == [
        100.0
    ]
    with AnyReader([folder]) as reader:
        for connection in reader.connections:
            assert connection.digest.startswith("RIHS01_") and connection.ext.offered_qos_profiles
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)


@pytest.mark.alone
@pytest.mark.campaign
def test_killed_at_any_moment(ros, tmp_path, cascade):
    """SIGKILL again and again: less than a second is lost, nothing is missing before.

    What counts begins when the recording is seen to run. On a busy machine DDS sometimes holds back and drops
    messages while it connects a recorder that follows a killed one (the cause is not established; 28 starts
    on a quiet machine had none).
    """
    choose = random.Random(3)
    for k in range(sizes.KILLED_RECORDERS):
        storage = "mcap" if k < 0.7 * sizes.KILLED_RECORDERS else "sqlite3"
        folder, log = tmp_path / f"bag_{k}", tmp_path / f"log_{k}"
        with recorder(folder, log, f"storage:={storage}") as child:
            spin_until(ros, has_recorded(log, *TOPICS), "subscriptions")
            spin_until(ros, lambda f=folder, s=storage: flows(f, s), "messages")
            running = time.time_ns()
            time.sleep(choose.uniform(0.6, 2.0))  # the moment of the kill
            killed = time.time_ns()
            child.send_signal(signal.SIGKILL)
            child.wait()
        result = recover(folder)
        found = by_topic(result.out)
        for topic in TOPICS:
            lost = (killed - found[topic][-1][0]) / 1e9
            since = [message for message in found[topic] if message[0] >= running]
            # What the middleware held back for a third of a second may come just before the kill.
            assert lost < 1.0 and len(found[topic]) > 100 and gaps(since) == 0, (k, topic)
        with AnyReader([result.out]) as reader:
            assert reader.message_count == result.messages == sum(map(len, found.values()))


def test_a_node_that_comes_back_is_asked_again(ros, tmp_path):
    folder, log = tmp_path / "bag", tmp_path / "log"
    copies = itertools.count()

    def so_far():
        return gains(finished(folder, tmp_path / f"copy_{next(copies)}"))

    with recorder(folder, log) as child:
        spin_until(ros, lambda: "records into" in log.read_text(), "recorder")
        for gain in (111.0, 112.0):
            with process("controller", ["-p", f"arc.k1:={gain}"], tmp_path / "c.log") as controller:
                spin_until(ros, lambda g=gain: g in so_far(), "parameters in a copy of the growing bag")
                controller.send_signal(signal.SIGKILL if gain == 111.0 else signal.SIGTERM)
                controller.wait()
        stop(child)
    assert gains(folder) == [111.0, 112.0]


def gains(folder):
    """arc.k1 of each answer of a controller."""
    events = [
        deserialize_message(m[2], ParameterEvent) for m in by_topic(folder).get(EVENTS, []) if m[1] == 0
    ]
    return [p.value.double_value for e in events for p in e.new_parameters if p.name == "arc.k1"]


def test_what_publishers_offer_is_taken(ros, tmp_path):
    """Best effort, latched, and a second publisher that offers less than the first."""
    folder, log = tmp_path / "bag", tmp_path / "log"
    latched = ros.create_publisher(
        String, "/latched", QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    )
    latched.publish(String(data="before"))
    lax = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    fast = ros.create_publisher(Float64, "/fast", lax)
    mixed = [ros.create_publisher(Float64, "/mixed", 10)]
    ros.create_publisher(Float64, "/other", 10)
    with recorder(folder, log, "topics:=['/latched', '/fa.*', '/mix..']") as child:
        spin_until(ros, has_recorded(log, "/latched", "/fast", "/mixed"), "subscriptions")
        spin_until(ros, lambda: fast.get_subscription_count() == 1, "match")
        fast.publish(Float64(data=1.0))
        mixed.append(ros.create_publisher(Float64, "/mixed", lax))
        spin_until(ros, lambda: "/mixed: a publisher offers less" in log.read_text(), "warning")
        spin_until(ros, lambda: all(p.get_subscription_count() == 1 for p in mixed), "match")
        for value, publisher in enumerate(mixed):
            publisher.publish(Float64(data=float(value)))
        stop(child)
    found = by_topic(folder)
    assert deserialize_message(found["/latched"][0][2], String).data == "before"
    assert len(found["/fast"]) == 1
    assert sorted(deserialize_message(m[2], Float64).data for m in found["/mixed"]) == [0.0, 1.0]
    assert "/other" not in found
    with AnyReader([folder]) as reader:
        qos = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
    assert qos["/fast"][0].reliability.name == "BEST_EFFORT"
    assert qos["/latched"][0].durability.name == "TRANSIENT_LOCAL"


@pytest.mark.alone
def test_a_bag_that_may_not_grow_ends_in_order(ros, tmp_path, cascade):
    folder, log = tmp_path / "bag", tmp_path / "log"
    with recorder(folder, log) as child:
        spin_until(ros, lambda: flows(folder, "mcap"), "messages of all topics")
        limit = next(folder.glob("*.mcap")).stat().st_size + 3_000_000
        resource.prlimit(child.pid, resource.RLIMIT_FSIZE, (limit, limit))
        spin_until(ros, lambda: child.poll() is not None, "the end")
        assert child.returncode == 1
    text = log.read_text()
    assert "cannot be written any further: File too large; the bag has no end (valve-control" in text
    assert "Traceback" not in text
    found = by_topic(recover(folder).out)
    assert all(gaps(found[topic]) == 0 and len(found[topic]) > 500 for topic in TOPICS)


class Ear:
    """What the recorder says in /diagnostics."""

    def __init__(self, node):
        self.said = []
        self._subscription = node.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 50)

    def _hear(self, message):
        self.said += [(s.level, s.message) for s in message.status if s.name == "recorder"]

    def heard(self, level, words):
        return lambda: any(at == level and words in text for at, text in self.said)


@pytest.fixture
def stranger():
    """Node of a participant of its own: one participant has one type on each topic."""
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node("stranger", context=context)
    yield node
    node.destroy_node()
    rclpy.shutdown(context=context)


@pytest.mark.parametrize("first", ["foreign", "ours"])
def test_the_type_of_our_nodes_is_recorded_and_another_one_said(ros, stranger, tmp_path, first):
    """A text on /spool_position, before or after the readings: only these are in the bag, and all of them."""
    folder, log = tmp_path / "bag", tmp_path / "log"
    ear = Ear(ros)
    with recorder(folder, log) as child:
        spin_until(ros, ear.heard(DiagnosticStatus.OK, "recording"), "diagnostics")
        if first == "foreign":
            foreign = stranger.create_publisher(String, "/spool_position", 10)
            spin_until(ros, ear.heard(DiagnosticStatus.WARN, "std_msgs/msg/String by /stranger"), "warning")
        readings = ros.create_publisher(Float64, "/spool_position", 10)
        spin_until(ros, lambda: readings.get_subscription_count() == 1, "match")
        readings.publish(Float64(data=1.0))
        if first == "ours":
            foreign = stranger.create_publisher(String, "/spool_position", 10)
            spin_until(ros, ear.heard(DiagnosticStatus.WARN, "std_msgs/msg/String by /stranger"), "warning")
        foreign.publish(String(data="not a number"))
        readings.publish(Float64(data=2.0))
        stranger.destroy_publisher(foreign)
        ear.said.clear()
        spin_until(ros, ear.heard(DiagnosticStatus.OK, "recording"), "the end of the warning")
        stop(child)
    words = (
        "/spool_position is published as std_msgs/msg/String by /stranger: these messages are not recorded"
    )
    assert log.read_text().count(words) == 1
    found = by_topic(folder)
    values = [deserialize_message(m[2], Float64).data for m in found["/spool_position"]]
    assert values == [1.0, 2.0] and "/spool_position: 2 messages" in log.read_text()
    with AnyReader([folder]) as reader:
        types = {c.topic: c.msgtype for c in reader.connections}
    assert types["/spool_position"] == "std_msgs/msg/Float64"


@pytest.mark.parametrize(
    ("storage", "how"),
    [
        ("mcap", "folder renamed"),
        ("sqlite3", "folder removed"),
        pytest.param("mcap", "file replaced", marks=pytest.mark.campaign),
        pytest.param("sqlite3", "file removed", marks=pytest.mark.campaign),
    ],
)
def test_a_bag_that_is_taken_away_ends_the_recording_at_once(ros, tmp_path, storage, how):
    folder, log = tmp_path / "bag", tmp_path / "log"
    ear = Ear(ros)
    readings = ros.create_publisher(Float64, "/spool_position", 10)
    with recorder(folder, log, f"storage:={storage}") as child:
        spin_until(ros, lambda: readings.get_subscription_count() == 1, "match")
        spin_until(ros, ear.heard(DiagnosticStatus.OK, "recording"), "diagnostics")
        for k in range(50):
            readings.publish(Float64(data=float(k)))
        (file,) = [path for path in folder.iterdir() if path.suffix in (".mcap", ".db3")]
        begun = time.monotonic()
        if how == "folder removed":
            shutil.rmtree(folder)
        elif how == "folder renamed":
            folder.rename(tmp_path / "elsewhere")
        else:
            file.unlink()
            if how == "file replaced":
                file.write_bytes(b"")
        spin_until(ros, ear.heard(DiagnosticStatus.ERROR, "was removed, moved or replaced"), "the error")
        spin_until(ros, lambda: child.poll() is not None, "the end")
        assert child.returncode == 1 and time.monotonic() - begun < 5.0
    text = log.read_text()
    assert f"{file.name} was removed, moved or replaced while it was written" in text
    assert "Traceback" not in text and not (folder / metadata.NAME).exists()
    if how == "folder renamed":
        assert 0 < len(by_topic(recover(tmp_path / "elsewhere").out)["/spool_position"]) <= 50


def test_definitions_come_from_the_installed_packages():
    """nav_msgs/Goals came after the first Jazzy: rosbags does not have it."""
    got = Definitions().get("nav_msgs/msg/Goals")
    assert "geometry_msgs/PoseStamped[] goals" in got.text and "MSG: geometry_msgs/Quaternion" in got.text
    assert got.type_hash.startswith("RIHS01_")
