# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Bags that the libraries of others read back."""

import sqlite3
import tempfile
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, make_reader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from valve_control.recordings.bags import metadata
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.writer import BagWriter

STORE = get_typestore(Stores.ROS2_JAZZY)
FLOAT = "std_msgs/msg/Float64"
DEFINITION, _ = STORE.generate_msgdef(FLOAT, ros_version=2)
HASH = STORE.hash_rihs01(FLOAT)
LONG = QosTime(9223372036, 854775807)
USUAL = Qos(
    QosHistory.KEEP_LAST, 10, QosReliability.RELIABLE, QosDurability.VOLATILE, LONG, LONG,
    QosLiveliness.AUTOMATIC, LONG, False,
)  # fmt: skip
QOS = USUAL._replace(depth=7, reliability=QosReliability.BEST_EFFORT, deadline=QosTime(1, 5))
STORAGES = ["mcap", "sqlite3"]
EPOCH = 1_700_000_000_000_000_000  # ns
MS = 1_000_000  # ns


def volts(value):
    return bytes(STORE.serialize_cdr(STORE.types[FLOAT](value), FLOAT))


def fill(writer, count, first=0):
    for k in range(first, first + count):
        writer.write("/spool_position", EPOCH + k * MS, EPOCH + k * MS - 1000, k + 1, volts(0.001 * k))


def opened(folder, **options):
    writer = BagWriter(folder, **options)
    writer.add_topic("/spool_position", FLOAT, DEFINITION, HASH, [QOS])
    writer.add_topic("/valve_voltage", FLOAT, DEFINITION, HASH, [QOS, USUAL])
    return writer


def read_mcap(path):
    """Messages of an MCAP file, with all checksums of the mcap library."""
    with path.open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
        stream.seek(0)
        linear = list(NonSeekingReader(stream, validate_crcs=True).iter_messages())
        stream.seek(0)
        found = list(make_reader(stream, validate_crcs=True).iter_messages())
    assert [m for _, _, m in linear] == [m for _, _, m in found]
    if summary is not None:
        assert summary.statistics.message_count == len(found)
        assert summary.statistics.chunk_count == len(summary.chunk_indexes)
    return [(c.topic, m.log_time, m.publish_time, m.sequence, m.data) for _, c, m in found]


def read_sqlite(path):
    with sqlite3.connect(f"file:{path}?immutable=1", uri=True) as database:
        return database.execute(
            "SELECT name, timestamp, publish_time, sequence, data FROM messages"
            " JOIN topics ON topic_id = topics.id JOIN valve_control_times ON message_id = messages.id"
            " ORDER BY messages.id"
        ).fetchall()


def listed(folder):
    """The file of metadata.yaml: path, begin [ns], end [ns], number of messages."""
    (file,) = yaml.safe_load((folder / metadata.NAME).read_text())[metadata.ROOT]["files"]
    begin = file["starting_time"]["nanoseconds_since_epoch"]
    return folder / file["path"], begin, begin + file["duration"]["nanoseconds"], file["message_count"]


def read(path):
    return read_mcap(path) if path.suffix == ".mcap" else read_sqlite(path)


@pytest.mark.parametrize("storage", STORAGES)
def test_rosbags_reads_what_was_written(tmp_path, storage):
    folder = tmp_path / "bag"
    with opened(folder, storage=storage) as writer:
        fill(writer, 1000)
    with AnyReader([folder]) as reader:
        (connection,) = [c for c in reader.connections if c.topic == "/spool_position"]
        assert connection.digest == HASH and connection.msgcount == 1000
        got = [(t, reader.deserialize(raw, FLOAT).data) for _, t, raw in reader.messages([connection])]
    assert got == [(EPOCH + k * MS, 0.001 * k) for k in range(1000)]
    with Reader(folder) as reader:
        assert reader.message_count == 1000 and reader.duration == 999 * MS + 1
        qos = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
        assert [p.depth for p in qos["/valve_voltage"]] == [7, 10]
        assert qos["/spool_position"][0].deadline == (1, 5)
        assert qos["/spool_position"][0].reliability.name == "BEST_EFFORT"


@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
def test_mcap_is_what_rosbag2_writes(tmp_path, compression):
    folder = tmp_path / "bag"
    with opened(folder, compression=compression) as writer:
        for k in range(5):
            fill(writer, 100, 100 * k)
            writer.flush()
    path = folder / "bag_0.mcap"
    assert len(read_mcap(path)) == 500
    with path.open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        (record,) = reader.iter_metadata()
    assert [index.compression for index in summary.chunk_indexes] == [compression.replace("none", "")] * 5
    (schema,) = summary.schemas.values()
    assert (schema.name, schema.encoding, schema.data.decode()) == (FLOAT, "ros2msg", DEFINITION)
    for channel in summary.channels.values():
        assert channel.message_encoding == "cdr" and channel.metadata["topic_type_hash"] == HASH
        assert metadata.profiles(channel.metadata["offered_qos_profiles"])[0] == QOS
    assert record.name == "rosbag2" and "message_count: 500" in record.metadata["serialized_metadata"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("message_count: 10", "message_number: 10"), "message_count"),
        (("history: keep_last", "history: [keep_last"), "does not describe a bag"),
        (("rosbag2_bagfile_information", "information"), "rosbag2_bagfile_information"),
    ],
)
def test_bad_metadata_is_one_sentence(tmp_path, change, words):
    with opened(tmp_path / "bag") as writer:
        fill(writer, 10)
    path = tmp_path / "bag" / metadata.NAME
    path.write_text(path.read_text().replace(*change))
    with pytest.raises(BagError) as error:
        metadata.read(tmp_path / "bag")
    assert words in str(error.value) and str(path) in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("version", "lines"), [(4, ["  compression_mode: FILE", "  compression_format: zstd"]), (1, [])]
)
def test_metadata_of_older_versions(tmp_path, version, lines):
    """What rosbag2 of Foxy (4) and Crystal (1) wrote."""
    text = f"""rosbag2_bagfile_information:
  version: {version}
  relative_file_paths: [bag/bag_0.db3]
  message_count: 2
  topics_with_message_count:
    - topic_metadata: {{name: x, type: std_msgs/msg/Float64, serialization_format: cdr}}
      message_count: 2
"""
    (tmp_path / metadata.NAME).write_text(text + "\n".join(lines))
    compression = "file" if lines else ""
    assert metadata.read(tmp_path) == (version, "", compression, 2, ("bag_0.db3",))


@pytest.mark.parametrize("storage", STORAGES)
def test_a_recording_may_begin_at_zero(tmp_path, storage):
    """Simulated time does; the beginning was that of the second message."""
    with opened(tmp_path / "bag", storage=storage) as writer:
        for k in range(4):
            writer.write("/spool_position", k * 500 * MS, k * 500 * MS, k + 1, volts(0.0))
    assert listed(tmp_path / "bag")[1:] == (0, 1500 * MS, 4)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "exists already; a bag needs a new folder"),
        ({"storage": "sqlite3", "compression": "zstd"}, "storage sqlite3 has none"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, options, words):
    with pytest.raises(BagError, match=words):
        BagWriter(tmp_path, **options)
    assert list(tmp_path.iterdir()) == []


MESSAGES = st.lists(
    st.tuples(
        st.sampled_from(["/spool_position", "/valve_voltage"]),
        st.integers(1, 2**62),
        st.integers(0, 2**62),
        st.integers(0, 2**32 - 1),
        st.binary(max_size=40),
    ),
    max_size=30,
)


@settings(max_examples=30, deadline=None)
@given(messages=MESSAGES, storage=st.sampled_from(STORAGES), flushes=st.integers(1, 7))
def test_any_messages_come_back(messages, storage, flushes):
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "bag"
        with opened(folder, storage=storage) as writer:
            for k, message in enumerate(messages):
                writer.write(*message)
                if k % flushes == 0:
                    writer.flush()
        path, *times, count = listed(folder)
        assert sorted(read(path)) == sorted(messages) and count == len(messages)
        stamps = [m[1] for m in messages] or [0]
        assert times == [min(stamps), max(stamps)]
