# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Bags of other recorders: serializations, definitions, orders and names of files."""

import shutil
import struct
from contextlib import closing

import numpy as np
import pytest
import zstandard
from mcap.writer import Writer as LibraryWriter
from test_writer import fill, opened

from valve_control.recordings.bags import metadata
from valve_control.recordings.bags.bag import Bag
from valve_control.recordings.bags.cdr import Decoder
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.messages import Topic
from valve_control.recordings.mapping import find_valves

FLOAT = "std_msgs/msg/Float64"
SECOND = 10**9
POSITION, COMMAND, VOLTAGE = "/spool_position", "/spool_command", "/valve_voltage"


def number(value):
    return b"\0\1\0\0" + struct.pack("<d", value)


def channels(path, topics, count=20):
    """An MCAP file of ``topics``: name → encoding, type, format and text of its definition, message."""
    with path.open("wb") as stream:
        writer = LibraryWriter(stream)
        writer.start("ros2")
        for name, (encoding, kind, form, text, message) in topics.items():
            schema = 0 if kind is None else writer.register_schema(kind, form, text.encode())
            channel = writer.register_channel(name, encoding, schema)
            for k in range(count):
                writer.add_message(channel, SECOND + k * 10**6, message, SECOND + k * 10**6, k + 1)
        writer.finish()
    return path


CDR = ("cdr", FLOAT, "ros2msg", "float64 data", number(0.5))
FOREIGN = {
    "json": ("json", FLOAT, "jsonschema", '{"type": "object"}', b'{"data": 0.5}'),
    "protobuf": ("protobuf", "foxglove.Number", "protobuf", "\n", b"\t\0\0\0\0\0\0\xe0?"),
    "ros1": ("ros1", "std_msgs/Float64", "ros1msg", "float64 data", struct.pack("<d", 0.5)),
    "CDR by another name": ("xcdr2", FLOAT, "ros2msg", "float64 data", number(0.5)),
    "no encoding": ("", FLOAT, "ros2msg", "float64 data", number(0.5)),
    "no schema": ("cdr", None, "", "", number(0.5)),
}  # fmt: skip


@pytest.mark.parametrize("kind", FOREIGN)
@pytest.mark.parametrize("topics", [[POSITION], [POSITION, COMMAND, VOLTAGE]], ids=len)
def test_what_is_not_cdr_is_refused_with_topic_and_encoding(tmp_path, kind, topics):
    """It was analysed as CDR; where nothing else was there, "has no spool_command; it has /spool_command"."""
    path = channels(
        tmp_path / "a.mcap",
        {name: FOREIGN[kind] if name in topics else CDR for name in (POSITION, COMMAND, VOLTAGE)},
    )
    with pytest.raises(BagError) as caught, closing(Bag(path)) as bag:
        find_valves(bag)
    encoding = FOREIGN[kind][0]
    for name in topics:
        assert name in str(caught.value)
    assert encoding in str(caught.value) and "has no spool" not in str(caught.value)


# Definitions

HEADED = "std_msgs/Header header\nfloat64 data"
OWN_IDL = "module mine { module msg { struct Number { double data; }; }; };"
IDL = "module std_msgs { module msg { struct Float64 { double data; }; }; };"
DEFINITIONS = {
    "omgidl": (FLOAT, "omgidl", IDL),
    "omgidl with its own names": ("std_msgs::msg::Float64", "omgidl", IDL),
    "names of DDS": ("std_msgs::msg::dds_::Float64_", "omgidl", ""),
    "omgidl that nobody reads": (FLOAT, "omgidl", "#pragma once\n@appendable struct X { wchar c; };"),
    "omgidl of a type of its own": ("mine::msg::Number", "omgidl", OWN_IDL),
    "ros2idl": (FLOAT, "ros2idl", IDL),
    "text of another kind": (FLOAT, "ros2msg", IDL),
    "json schema": (FLOAT, "jsonschema", '{"title": "Float64"}'),
    "nothing": (FLOAT, "", ""),
    "a short name": ("std_msgs/Float64", "ros2msg", "float64 data"),
    "comments and constants": (FLOAT, "ros2msg", "# V\nfloat64 LIMIT=10.0\nfloat64 data # at the spool"),
}  # fmt: skip


@pytest.mark.parametrize("kind", DEFINITIONS)
def test_numbers_are_found_whatever_the_definition(tmp_path, kind):
    """Of definitions without their dependencies, and of IDL, it was a KeyError."""
    path = channels(tmp_path / "a.mcap", {POSITION: ("cdr", *DEFINITIONS[kind], number(0.5))})
    with closing(Bag(path)) as bag:
        (valve,) = find_valves(bag).values()
        source = valve.sources["spool_position"]
        values = bag.read({source.topic: [source.field]})[source.topic].values[source.field]
    assert np.array_equal(values, np.full(20, 0.5))


@pytest.mark.parametrize(
    ("definition", "words"),
    [
        (HEADED, ""),
        ("mine/Unknown u\nfloat64 data", "mine/msg/Unknown"),
        ("mine/Unknown[] u\nfloat64 data", "mine/msg/Unknown"),
        ("", "no definition"),
    ],
)
def test_standard_types_complete_a_definition_and_others_are_said(definition, words):
    topic = Topic("/t", "mine/msg/Headed", definition_format="ros2msg", definition=definition)
    if words:
        with pytest.raises(BagError, match=words):
            Decoder(topic, "data")
        return
    raw = b"\0\1\0\0" + struct.pack("<iII3sxd", 1, 2, 3, b"ab\0", 0.25)
    message = np.frombuffer(raw, np.uint8), np.array([0]), np.array([len(raw)])
    for field, value in (("data", 0.25), ("header.stamp.sec", 1.0)):
        values, done = Decoder(topic, field).decode(*message)
        assert done.all() and values.tolist() == [value]


def test_a_type_that_contains_itself_cannot_be_decoded():
    topic = Topic("/t", "mine/msg/Headed", definition_format="ros2msg", definition="mine/Headed again")
    decoder = Decoder(topic, "data")
    decoder.decode(np.zeros(9, np.uint8), np.array([0]), np.array([9]))
    assert "mine/msg/Headed" in decoder.error


# Files and their order


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_files_are_read_in_the_order_of_their_times(tmp_path, storage):
    """Their names count backwards, as those of rosbag2 do over midnight."""
    whole = tmp_path / "run_0"
    for k in range(5):
        with opened(tmp_path / f"run_{4 - k}", storage=storage) as writer:
            fill(writer, 100, 100 * k)
        if k < 4:
            writer.path.rename(whole.with_name(writer.path.name))
    for path in tmp_path.glob("run_*_0.*"):
        path.rename(whole / path.name)
    file = whole / metadata.NAME
    names = sorted(path.name for path in whole.iterdir() if path != file)
    listing = "".join(f"  - {name}\n" for name in names)
    file.write_text(file.read_text().replace(f"  - {writer.path.name}\n", listing, 1))
    for left in ("metadata", "none"):
        with closing(Bag(whole)) as bag:
            assert bag.problems == [] or left == "none"
            sequence = bag.read({}, raw=[POSITION])[POSITION].sequence
        assert sequence.tolist() == list(range(1, 501))
        file.unlink(missing_ok=True)


def test_a_file_that_metadata_does_not_list_is_said(tmp_path):
    with opened(tmp_path / "bag") as writer:
        fill(writer, 100)
    shutil.copy(writer.path, tmp_path / "bag" / "other.mcap")
    with closing(Bag(tmp_path / "bag")) as bag:
        assert any("other.mcap" in p and "does not list" in p for p in bag.problems)
        assert len(bag.read({}, raw=[POSITION])[POSITION].log_time) == 100


# Compressed messages


@pytest.mark.parametrize("left", ["no metadata", "single file"])
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_compressed_messages_are_recognised(tmp_path, storage, left):
    packed = zstandard.ZstdCompressor()
    with opened(tmp_path / "bag", storage=storage) as writer:
        for k in range(50):
            data = packed.compress(number(0.1 * k))
            writer.write(POSITION, SECOND + k * 10**6, SECOND + k * 10**6, k + 1, data)
    path = tmp_path / "bag"
    if left == "no metadata":
        (path / metadata.NAME).unlink()
    if left == "single file":
        (path,) = (p for p in path.iterdir() if p.suffix != ".yaml")
    with closing(Bag(path)) as bag:
        values = bag.read({POSITION: ["data"]})[POSITION].values["data"]
        assert np.array_equal(values, 0.1 * np.arange(50))
