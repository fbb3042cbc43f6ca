# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Bags of every kind, read beside the rosbags library's own reading of the same files."""

import random
import shutil
import sqlite3
import struct
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as LibraryWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from valve_control.recordings.bags.bag import Bag
from valve_control.recordings.bags.cdr import places
from valve_control.recordings.bags.errors import BagError

REAL = Path(__file__).resolve().parents[1] / "data" / "bags"
TYPES = get_typestore(Stores.ROS2_JAZZY)
FLOAT = "std_msgs/msg/Float64"
HEAD = b"\0\1\0\0"


def number(value):
    return HEAD + struct.pack("<d", value)


def by_library(path):
    """(topic, time) → messages as the rosbags library reads the storage files, topics with their slash."""
    found = []
    with Reader(path) as reader:
        for storage in getattr(reader.storage, "storages", [reader.storage]):
            for connection, time, data in storage.messages(storage.connections):
                found.append((f"/{connection.topic.lstrip('/')}", time, bytes(data)))
    return sorted(found)


@pytest.mark.parametrize("path", sorted(p for p in REAL.iterdir() if p.is_dir()), ids=lambda p: p.name)
def test_bags_of_real_origin_read_as_the_library_reads_them(path):
    bag = Bag(path)
    got = []
    for name, block in bag.blocks(list(bag.topics)):
        for at, size, time in zip(block.offset, block.length, block.log_time, strict=True):
            got.append((name, int(time), block.buffer[at : at + size].tobytes()))
    expected = by_library(path)
    if bag.compression == "message":
        from backports import zstd

        expected = [(topic, time, zstd.decompress(data)) for topic, time, data in expected]
    assert sorted(got) == expected and len(got) > 0
    assert bag.problems == []


@pytest.mark.parametrize(
    "name", ["jazzy_mcap_drone_yaw", "humble_mcap_jointstate_imu", "humble_sqlite3_twist"]
)
def test_numbers_of_real_messages_are_the_library_s(name):
    bag = Bag(REAL / name)
    compared = 0
    for topic in bag.topics.values():
        first = next(bag.messages(topic.name), None)
        if first is None:
            continue
        fields = [
            path if leaf.entries is None else f"{path}[{i}]"
            for path, leaf in places(topic, first).leaves.items()
            for i in range(1 if leaf.entries is None else leaf.entries)
        ]
        series = bag.read({topic.name: fields}, raw=[topic.name])[topic.name]
        assert series.undecodable == 0 and len(series.raw) == len(series.log_time)
        for i, raw in enumerate(series.raw):
            message = TYPES.deserialize_cdr(raw, topic.type)
            for field in fields:
                value = eval(f"m.{field}", {"m": message})
                assert np.array_equal(series.values[field][i], value, equal_nan=True), (topic.name, field)
                compared += 1
    assert compared > 10


# Every combination that can be written here


def write_rosbags(path, storage, mode=CompressionMode.NONE, count=500):
    writer = Writer(path, version=9, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        topics = [writer.add_connection(f"/t{i}", FLOAT, typestore=TYPES) for i in range(3)]
        for k in range(count):
            for i, topic in enumerate(topics):
                writer.write(topic, 10**9 + k * 10**6 + i, number(k + 0.25 * i))


COMBINATIONS = [
    (storage, mode)
    for storage in StoragePlugin
    for mode in CompressionMode
    if (storage, mode) != (StoragePlugin.SQLITE3, CompressionMode.STORAGE)
]


@pytest.mark.parametrize(("storage", "mode"), COMBINATIONS, ids=lambda x: x.name)
def test_bags_of_the_library_with_every_compression(tmp_path, storage, mode):
    write_rosbags(tmp_path / "bag", storage, mode)
    bag = Bag(tmp_path / "bag")
    got = bag.read({f"/t{i}": ["data"] for i in range(3)})
    for i in range(3):
        assert np.array_equal(got[f"/t{i}"].values["data"], np.arange(500) + 0.25 * i)
        assert np.array_equal(got[f"/t{i}"].log_time, 10**9 + np.arange(500) * 10**6 + i)


@pytest.mark.parametrize("compression", list(CompressionType), ids=lambda c: c.name)
@pytest.mark.parametrize("chunked", [True, False], ids=["chunks", "no chunks"])
@pytest.mark.parametrize("summary", [True, False], ids=["summary", "no summary"])
def test_mcap_files_of_the_mcap_library(tmp_path, compression, chunked, summary):
    path = tmp_path / "one.mcap"
    with path.open("wb") as stream:
        writer = LibraryWriter(
            stream, chunk_size=5000, compression=compression, use_chunking=chunked,
            use_summary_offsets=summary, repeat_channels=summary, repeat_schemas=summary,
            use_statistics=summary,
        )  # fmt: skip
        writer.start("ros2")
        schema = writer.register_schema(FLOAT, "ros2msg", b"float64 data")
        channel = writer.register_channel("/x", "cdr", schema)
        for k in range(2000):
            writer.add_message(channel, 10**9 + k, number(float(k)), 10**9 + k - 7, k + 1)
        writer.finish()
    series = Bag(path).read({"/x": ["data"]})["/x"]
    assert np.array_equal(series.values["data"], np.arange(2000.0))
    assert np.array_equal(series.sequence, np.arange(2000) + 1)
    assert np.array_equal(series.log_time - series.publish_time, np.full(2000, 7))


def test_damaged_files_never_do_more_than_raise_bag_error(tmp_path):
    """Bytes changed at random: what is read may be wrong, but nothing else may happen."""
    write_rosbags(tmp_path / "m", StoragePlugin.MCAP, count=60)
    write_rosbags(tmp_path / "s", StoragePlugin.SQLITE3, count=60)
    draw = random.Random(2)
    for storage in ("m", "s"):
        file = next(p for p in (tmp_path / storage).iterdir() if p.suffix in (".mcap", ".db3"))
        data = file.read_bytes()
        for _ in range(30):
            broken = bytearray(data)
            for _ in range(draw.randrange(1, 6)):
                broken[draw.randrange(len(broken))] = draw.randrange(256)
            path = tmp_path / f"broken{file.suffix}"
            path.write_bytes(broken)
            try:
                bag = Bag(path)
                bag.read({name: ["data"] for name in bag.topics})
            except BagError as error:
                assert "\n" not in str(error)


# Bad input


def other_database(path):
    with sqlite3.connect(path) as db:
        db.execute("CREATE TABLE people (name TEXT)")
    db.close()


def no_topics(path):
    with path.open("wb") as stream:
        writer = LibraryWriter(stream)
        writer.start("ros2")
        writer.finish()


def missing_file(path):
    shutil.copytree(REAL / "jazzy_mcap_drone_yaw", path)
    next(path.glob("*.mcap")).unlink()


@pytest.mark.parametrize(
    ("name", "make", "words"),
    [
        ("nothing", lambda path: None, ["nothing", "there is no"]),
        ("a.py", Path.touch, ["a.py", "not a bag", "metadata.yaml"]),
        ("x.mcap", Path.touch, ["x.mcap", "empty"]),
        ("x.mcap", lambda path: path.write_text("hello, world, text"), ["x.mcap", "not an MCAP file"]),
        ("x.db3", lambda path: path.write_text("hello, world, text"), ["x.db3", "not a sqlite3 file"]),
        ("x.db3", other_database, ["x.db3", "no table 'topics'"]),
        ("empty", Path.mkdir, ["empty", "not a bag"]),
        ("bag", missing_file, ["none of the files"]),
        ("x.mcap", no_topics, ["x.mcap", "no topics that can be read"]),
    ],
)
def test_what_is_no_bag_is_said_in_one_sentence(tmp_path, name, make, words):
    make(tmp_path / name)
    with pytest.raises(BagError) as caught:
        Bag(tmp_path / name)
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_one_bad_file_of_several_is_left_out(tmp_path):
    shutil.copytree(REAL / "rosbag2_sqlite3_message_zstd_split", tmp_path / "bag")
    whole = Bag(tmp_path / "bag")
    count = sum(len(block.topic) for _, block in whole.blocks(list(whole.topics)))
    victim = tmp_path / "bag" / whole.files[1]
    victim.write_bytes(b"gone")
    bag = Bag(tmp_path / "bag")
    left = sum(len(block.topic) for _, block in bag.blocks(list(bag.topics)))
    assert 0 < left < count
    assert any(victim.name in problem and "left out" in problem for problem in bag.problems)
