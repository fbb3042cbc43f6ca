# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Bags of other recorders: serializations, definitions, orders and names of files."""

import shutil
import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as LibraryWriter
from test_writer import EPOCH, MS, fill, opened, volts

from valve_control.recordings.bags import metadata
from valve_control.recordings.bags.bag import Bag
from valve_control.recordings.bags.cdr import Decoder
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.messages import Topic
from valve_control.recordings.bags.metadata import Counted
from valve_control.recordings.bags.recover import recover
from valve_control.recordings.mapping import find_valves

FLOAT = "std_msgs/msg/Float64"
REAL = Path(__file__).resolve().parents[1] / "data" / "bags"
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
    "json without a schema": ("json", None, "", "", b'{"data": 0.5}'),
    "protobuf": ("protobuf", "foxglove.Number", "protobuf", "\n", b"\t\0\0\0\0\0\0\xe0?"),
    "flatbuffer": ("flatbuffer", "Number", "flatbuffer", "x", bytes(40)),
    "ros1": ("ros1", "std_msgs/Float64", "ros1msg", "float64 data", struct.pack("<d", 0.5)),
    "cbor": ("cbor", FLOAT, "", "", b"\xa1ddata\xfb" + struct.pack(">d", 0.5)),
    "msgpack": ("msgpack", FLOAT, "ros2msg", "float64 data", b"\x81\xa4data\xcb" + struct.pack(">d", 0.5)),
    "wrong_format": ("wrong_format", FLOAT, "ros2msg", "float64 data", number(0.5)),
    "CDR by another name": ("xcdr2", FLOAT, "ros2msg", "float64 data", number(0.5)),
    "no encoding": ("", FLOAT, "ros2msg", "float64 data", number(0.5)),
    "no schema": ("cdr", None, "", "", number(0.5)),
}  # fmt: skip


@pytest.mark.parametrize("kind", FOREIGN)
@pytest.mark.parametrize("topics", [[POSITION], [COMMAND], [POSITION, COMMAND, VOLTAGE]], ids=len)
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


def test_another_topic_in_its_place_is_read(tmp_path):
    path = channels(tmp_path / "a.mcap", {POSITION: FOREIGN["json"], "/lvdt": CDR, "/noise": FOREIGN["json"]})
    with closing(Bag(path)) as bag:
        (valve,) = find_valves(bag, ["spool_position=/lvdt"]).values()
    assert valve.sources["spool_position"].topic == "/lvdt"


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_the_serialization_that_metadata_names_counts(tmp_path, storage):
    """As in `wrong_rmw_test` of rosbag2, whose database says cdr and whose metadata.yaml does not."""
    with opened(tmp_path / "bag", storage=storage) as writer:
        fill(writer, 20)
    file = tmp_path / "bag" / metadata.NAME
    file.write_text(
        file.read_text().replace("serialization_format: cdr", "serialization_format: wrong_format")
    )
    with pytest.raises(BagError, match=f"{POSITION}.*wrong_format"), closing(Bag(tmp_path / "bag")) as bag:
        find_valves(bag)


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
        ("mine/Headed again\nfloat64 data", "mine/msg/Headed"),
        ("mine/Unknown[] u\nfloat64 data", "mine/msg/Unknown"),
        ("", "no definition"),
    ],
)
def test_standard_types_complete_a_definition_and_others_are_said(definition, words):
    topic = Topic("/t", "mine/msg/Headed", definition_format="ros2msg", definition=definition)
    if words:
        with pytest.raises(BagError, match=words):
            Decoder(topic, ["data"])
        return
    raw = b"\0\1\0\0" + struct.pack("<iII3sxd", 1, 2, 3, b"ab\0", 0.25)
    values, done = Decoder(topic, ["data", "header.stamp.sec"]).decode(
        np.frombuffer(raw, np.uint8), np.array([0]), np.array([len(raw)])
    )
    assert done.all() and values.tolist() == [[0.25, 1.0]]


# Files and their order


def split(folder, count=5, storage="mcap"):
    """A bag of ``count`` files, each of 0.1 s, and the times of its messages."""
    with opened(folder, storage=storage, max_seconds=0.1) as writer:
        fill(writer, 100 * count)
    return times(folder)


def times(folder):
    with closing(Bag(folder)) as bag:
        return bag.read({}, raw=[POSITION])[POSITION].log_time


NAMES = {
    "rosbag2 since 2026": lambda k: f"{k}_run_2026_11_26-20_{59 if k < 3 else 0:02}_{58 - k:02}",
    "no numbers": lambda k: ("delta", "alpha", "echo", "bravo", "charlie")[k],
    "backwards": lambda k: f"run_{9 - k}",
    "dates": lambda k: f"run_{(26, 27, 1, 2, 3)[k]:02}",
    "one word before the number": lambda k: f"{('z', 'y', 'x', 'w', 'v')[k]}_{k % 2}",
}


def renamed(folder, name):
    """Files get other names, in metadata.yaml too."""
    told = metadata.read(folder)
    new = [f"{NAMES[name](k)}{Path(path).suffix}" for k, path in enumerate(told.relative_file_paths)]
    for old, path in zip(told.relative_file_paths, new, strict=True):
        (folder / old).rename(folder / path)
    files = [file._replace(path=path) for file, path in zip(told.files, new, strict=True)]
    metadata.write(folder, told._replace(relative_file_paths=tuple(new), files=tuple(files)))
    return told, new


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("name", NAMES)
def test_files_are_read_in_the_order_of_their_times(tmp_path, name, storage):
    expected = split(tmp_path / "bag", storage=storage)
    renamed(tmp_path / "bag", name)
    assert np.array_equal(times(tmp_path / "bag"), expected)
    (tmp_path / "bag" / metadata.NAME).unlink()
    assert np.array_equal(times(tmp_path / "bag"), expected)


@pytest.mark.parametrize("order", [[4, 3, 2, 1, 0], [1, 0, 2, 3, 4], [0, 2, 4, 1, 3], [0, 1, 1, 3, 2, 4]])
def test_a_list_in_another_order_is_said_and_not_followed(tmp_path, order):
    expected = split(tmp_path / "bag")
    told = metadata.read(tmp_path / "bag")
    metadata.write(
        tmp_path / "bag",
        told._replace(
            relative_file_paths=tuple(told.relative_file_paths[k] for k in order),
            files=tuple(told.files[k] for k in order),
        ),
    )
    assert np.array_equal(times(tmp_path / "bag"), expected)
    with closing(Bag(tmp_path / "bag")) as bag:
        assert any("order" in problem for problem in bag.problems)


def test_a_file_that_metadata_does_not_list_is_said(tmp_path):
    split(tmp_path / "bag")
    shutil.copy(tmp_path / "bag" / "bag_1.mcap", tmp_path / "bag" / "other.mcap")
    with closing(Bag(tmp_path / "bag")) as bag:
        assert any("other.mcap" in p and "does not list" in p for p in bag.problems)
        assert len(bag.read({}, raw=[POSITION])[POSITION].log_time) == 500


# Compressed messages


@pytest.mark.parametrize("left", ["no metadata", "silent metadata", "single file"])
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
        assert any("zstd" in p for p in bag.problems) and not any("recover" in p for p in bag.problems)


# Old and unusual tables


def old_tables(path, count):
    with closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT)")
        database.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
        )
        database.execute("INSERT INTO topics VALUES (1, 'spool_position', 'std_msgs/Float64')")
        database.executemany(
            "INSERT INTO messages VALUES (?, 1, ?, ?)",
            [(k + 1, SECOND + k * 10**6, number(k)) for k in range(count)],
        )
        database.commit()
    return path


def test_three_columns_of_topics_are_enough(tmp_path):
    """Databases of the first releases of rosbag2 name no serialization."""
    with closing(Bag(old_tables(tmp_path / "old.db3", 100))) as bag:
        assert bag.read({POSITION: ["data"]})[POSITION].values["data"].tolist() == list(range(100))


# Recovery


def content(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def untouched(folder, words):
    """Recovery refuses the bag, or the file, in one sentence and leaves all as it is."""
    whole = folder if folder.is_dir() else folder.parent
    before = content(whole)
    for out in (None, whole.parent / "copy"):
        with pytest.raises(BagError) as caught:
            recover(folder, out)
        for word in words:
            assert word in str(caught.value)
    assert content(whole) == before and not (whole.parent / "copy").exists()


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("name", NAMES)
def test_recovery_lists_files_in_the_order_of_their_times(tmp_path, name, storage):
    """The digits at the end of rosbag2's new names are seconds; 5686 of 12227 readings were read then."""
    bag = tmp_path / "bag"
    expected = split(bag, storage=storage)
    _, names = renamed(bag, name)
    assert not recover(bag).done
    (bag / metadata.NAME).unlink()
    assert recover(bag).done
    assert list(metadata.read(bag).relative_file_paths) == names
    assert np.array_equal(times(bag), expected)
    assert not recover(bag).done


POINTERS = {
    "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2146\nsize 12345\n": "git lfs pull",
    "version https://hawser.github.com/spec/v1\noid sha256:4d7a2146\nsize 12345\n": "git lfs pull",
    "/annex/objects/SHA256E-s12345--4d7a2146.mcap\n": "git annex get",
}  # fmt: skip


@pytest.mark.parametrize("pointer", POINTERS, ids=["lfs", "old lfs", "annex"])
@pytest.mark.parametrize(
    "victims", [["bag_1"], ["bag_0"], ["metadata"], ["bag_0", "bag_1", "bag_2", "metadata"]], ids=str
)
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_what_was_not_fetched_is_said_and_not_touched(tmp_path, pointer, victims, storage):
    """It was renamed .unreadable and dropped from metadata.yaml, which was overwritten itself."""
    bag = tmp_path / "bag"
    split(bag, count=3, storage=storage)
    for path in bag.iterdir():
        if path.stem in victims:
            path.write_text(pointer)
    untouched(bag, [POINTERS[pointer]])
    if len(victims) < 4:
        with closing(Bag(bag)) as opened_bag:
            assert any(POINTERS[pointer] in p and "recover" not in p for p in opened_bag.problems)
        return
    with pytest.raises(BagError, match=POINTERS[pointer]):
        Bag(bag)


@pytest.mark.parametrize("name", ["a.mcap", "a.db3", "a.mcap.zstd", "a.db3.zstd"])
def test_a_single_file_that_was_not_fetched_is_said(tmp_path, name):
    (tmp_path / "bag").mkdir()
    path = tmp_path / "bag" / name
    path.write_text(next(iter(POINTERS)))
    untouched(path, ["Git LFS pointer"])
    with pytest.raises(BagError, match="git lfs pull"):
        Bag(path)


def test_a_link_to_nothing_is_not_dropped_from_the_bag(tmp_path):
    bag = tmp_path / "bag"
    split(bag, count=3)
    (bag / "bag_1.mcap").unlink()
    (bag / "bag_1.mcap").symlink_to("../.git/annex/objects/gone")
    with pytest.raises(BagError, match="bag_1.mcap is a link to"):
        recover(bag)
    assert len(metadata.read(bag).files) == 3


def test_metadata_of_a_version_to_come_is_left_alone(tmp_path):
    bag = tmp_path / "bag"
    split(bag, count=2)
    file = bag / metadata.NAME
    file.write_text(file.read_text().replace("version: 9", "version: 10") + "  new_field: 1\n")
    (bag / "bag_1.mcap").write_bytes((bag / "bag_1.mcap").read_bytes()[:-100])
    untouched(bag, ["version 10", "9"])


WRONG = {
    "duration of 0": lambda text, told: text.replace(f"nanoseconds: {told.duration}", "nanoseconds: 0", 1),
    "another beginning": lambda text, told: text.replace(
        f"nanoseconds_since_epoch: {told.starting_time}", "nanoseconds_since_epoch: 0", 1
    ),
    "a topic of another name": lambda text, told: text.replace("name: /spool_position", "name: /spool_lvdt"),
    "a topic of another type": lambda text, told: text.replace("msg/Float64", "msg/Float32"),
    "wrong count": lambda text, told: text.replace("message_count: 300", "message_count: 299"),
    "count at no topic": lambda text, told: text.replace(
        "message_count: 300", "message_count: 1", 2
    ).replace("message_count: 1", "message_count: 300", 1),
    "a file less": lambda text, told: text.replace("  - bag_1.mcap\n", ""),
    "another order": lambda text, told: text.replace("- bag_1.mcap", "- x").replace(
        "- bag_2.mcap", "- bag_1.mcap"
    ).replace("- x", "- bag_2.mcap"),
    "not YAML": lambda text, told: "rosbag2_bagfile_information: [",
    "empty": lambda text, told: "",
}  # fmt: skip


@pytest.mark.parametrize("wrong", WRONG)
def test_metadata_that_does_not_fit_is_made_anew_and_the_old_one_kept(tmp_path, wrong):
    """Of most of them was said: "is whole, nothing was done"."""
    bag = tmp_path / "bag"
    split(bag, count=3)
    told = metadata.read(bag)
    told = told._replace(ros_distro="humble", custom_data={"machine": "press"})
    metadata.write(bag, told)
    assert not recover(bag).done
    text = WRONG[wrong]((bag / metadata.NAME).read_text(), told)
    (bag / metadata.NAME).write_text(text)
    result = recover(bag)
    assert result.done and result.messages == 300 and result.lost == 0
    assert (bag / result.metadata_kept).read_text() == text
    made = metadata.read(bag)
    if wrong not in ("not YAML", "empty"):
        assert (made.ros_distro, made.custom_data) == ("humble", {"machine": "press"})
    assert (made.duration, made.starting_time, made.files) == (told.duration, told.starting_time, told.files)
    assert {(t.topic.name, t.topic.type): t.message_count for t in made.topics if t.message_count} == {
        (POSITION, FLOAT): 300
    }
    assert [file.name for file in result.files if file.unlisted] == (
        ["bag_1.mcap"] if wrong == "a file less" else []
    )
    assert not recover(bag).done


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("metadata_fits", [True, False])
def test_a_copy_of_a_file_does_not_double_the_messages(tmp_path, metadata_fits, storage):
    bag = tmp_path / "bag"
    expected = split(bag, count=3, storage=storage)
    (original,) = bag.glob("bag_1.*")
    shutil.copy(original, original.with_stem("a copy"))
    if not metadata_fits:
        file = bag / metadata.NAME
        file.write_text(file.read_text().replace("message_count: 300", "message_count: 299"))
    result = recover(bag)
    assert result.done != metadata_fits and result.messages == 300
    assert [file.name for file in result.files if file.foreign] == [f"a copy{original.suffix}"]
    assert np.array_equal(times(bag), expected) and not recover(bag).done


def piece(folder, number, storage, stamps):
    """One more file in the folder of a bag, which its metadata.yaml does not list; returns its name."""
    with opened(folder.with_name("made"), storage=storage) as writer:
        for k, stamp in enumerate(stamps):
            writer.write(POSITION, stamp, stamp, k + 1, volts(0.001 * k))
    (made,) = (path for path in folder.with_name("made").iterdir() if path.suffix != ".yaml")
    folder.mkdir(exist_ok=True)
    made.rename(folder / f"bag_{number}{made.suffix}")
    shutil.rmtree(folder.with_name("made"))
    return f"bag_{number}{made.suffix}"


STAMPS = [EPOCH + k * MS for k in range(300)]
BESIDE = {  # what is listed, what is not, and whether that is a copy
    "one stray stamp": ([*STAMPS[:99], 2 * 10**18], STAMPS[200:], False),
    "a clock that was set back": (STAMPS[:100], [stamp + MS // 3 for stamp in STAMPS[10:110]], False),
    "a copy that lost its beginning": (STAMPS[:100], STAMPS[60:100], True),
    "a copy with more at its end": (STAMPS[:100], STAMPS[:150], True),
    "a copy of one message": (STAMPS[:1], STAMPS[:1], True),
}


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("kind", BESIDE)
def test_only_a_file_with_the_stamps_of_a_listed_one_is_a_copy(tmp_path, kind, storage):
    """By begin and end alone one stray stamp made a copy of a piece, and its messages were left out."""
    listed, beside, copy = BESIDE[kind]
    bag = tmp_path / "bag"
    piece(bag, 0, storage, listed)
    piece(bag, 1, storage, STAMPS[100:200])
    recover(bag)
    name = piece(bag, 2, storage, beside)
    result = recover(bag)
    assert [file.name for file in result.files if file.foreign] == ([name] if copy else [])
    assert result.messages == len(listed) + 100 + (0 if copy else len(beside))
    assert len(times(bag)) == result.messages


def test_what_a_killed_recorder_wrote_after_its_last_list_is_taken_in(tmp_path):
    """Recorders that write metadata.yaml with each file leave the last one out of it."""
    bag = tmp_path / "bag"
    expected = split(bag, count=4)
    told = metadata.read(bag)
    metadata.write(bag, metadata.of_files("mcap", [Counted(told.topics[0].topic, 300)], told.files[:3]))
    result = recover(bag)
    assert result.messages == 400 and [file.name for file in result.files if file.unlisted] == ["bag_3.mcap"]
    assert np.array_equal(times(bag), expected)


def test_a_file_that_is_missing_is_counted_as_lost(tmp_path):
    bag = tmp_path / "bag"
    split(bag, count=3)
    (bag / "bag_1.mcap").unlink()
    result = recover(bag)
    assert result.done and (result.messages, result.lost) == (200, 100)
    assert [file.name for file in result.files if file.missing] == ["bag_1.mcap"] and result.metadata_kept


UNINDEXED = {
    "no message index": {"index_types": IndexType.ALL & ~IndexType.MESSAGE},
    "no chunk index": {"index_types": IndexType.ALL & ~IndexType.CHUNK},
    "no index": {"index_types": IndexType.NONE},
    "no statistics": {"use_statistics": False},
    "no channels in the summary": {"repeat_channels": False},
    "nothing in the summary": {
        "index_types": IndexType.MESSAGE, "use_statistics": False, "repeat_channels": False,
        "repeat_schemas": False, "use_summary_offsets": False,
    },
}  # fmt: skip


@pytest.mark.parametrize("compression", list(CompressionType), ids=lambda c: c.name)
@pytest.mark.parametrize("lack", UNINDEXED)
def test_files_without_index_get_one(tmp_path, lack, compression):
    """Readers that go by the index found no message in them, and they were called whole."""
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = LibraryWriter(stream, chunk_size=2000, compression=compression, **UNINDEXED[lack])
        writer.start("ros2")
        schema = writer.register_schema(FLOAT, "ros2msg", b"float64 data")
        topics = [writer.register_channel(name, "cdr", schema) for name in (POSITION, COMMAND)]
        for k in range(300):
            writer.add_message(topics[k % 3 == 0], SECOND + k, number(float(k)), SECOND + k, k + 1)
        writer.finish()
    result = recover(path)
    assert result.done and result.messages == 300 and result.lost == 0
    for name in (POSITION, COMMAND, None):
        with path.open("rb") as stream:
            found = list(make_reader(stream, validate_crcs=True).iter_messages(topics=name and [name]))
        assert len(found) == {POSITION: 200, COMMAND: 100, None: 300}[name]
    assert not recover(path).done


@pytest.mark.parametrize("checked", [True, False], ids=["checksum", "no checksum"])
@pytest.mark.parametrize("where", ["beyond the file", "beyond 63 bits", "behind the channels"])
def test_a_footer_that_tells_the_wrong_place_of_the_summary_is_made_anew(tmp_path, where, checked):
    """It was called whole, or its reader ended in a traceback, or topics were missing in metadata.yaml."""
    folder = tmp_path / "bag"
    folder.mkdir()
    path = folder / "a.mcap"
    with path.open("wb") as stream:
        writer = LibraryWriter(stream, enable_crcs=checked)
        writer.start("ros2")
        schema = writer.register_schema(FLOAT, "ros2msg", b"float64 data")
        topics = [writer.register_channel(name, "cdr", schema) for name in (POSITION, COMMAND)]
        for k in range(30):
            writer.add_message(topics[k % 3 == 0], SECOND + k, number(float(k)), SECOND + k, k + 1)
        writer.finish()
    data = bytearray(path.read_bytes())
    (start,) = struct.unpack_from("<Q", data, len(data) - 28)
    behind = data.index(struct.pack("<BQ", 11, 46 + 2 * 10), start)  # the statistics
    start = {"beyond the file": start + (1 << 40), "beyond 63 bits": start + (1 << 63)}.get(where, behind)
    struct.pack_into("<Q", data, len(data) - 28, start)
    path.write_bytes(data)
    result = recover(folder)
    assert result.done and (result.messages, result.lost) == (30, 0)
    told = metadata.read(folder).topics
    assert {topic.name: count for topic, count in told} == {POSITION: 20, COMMAND: 10}
    with path.open("rb") as stream:
        assert len(make_reader(stream, validate_crcs=True).get_summary().channels) == 2
    assert not recover(folder).done


@pytest.mark.parametrize("damage", ["none", "a page", "the end"])
def test_old_tables_are_recovered(tmp_path, damage):
    (tmp_path / "bag").mkdir()
    path = old_tables(tmp_path / "bag" / "old.db3", 2000)
    data = path.read_bytes()
    if damage == "a page":
        path.write_bytes(data[: 4096 * 9] + bytes(4096) + data[4096 * 10 :])
    if damage == "the end":
        path.write_bytes(data[:-6000])
    result = recover(tmp_path / "bag")
    assert result.messages > 1700 and (damage != "none" or result.lost == 0)
    ((topic, count),) = metadata.read(tmp_path / "bag").topics
    assert (topic.name, topic.serialization_format, count) == ("spool_position", "cdr", result.messages)
    assert len(times(tmp_path / "bag")) == result.messages


def test_advice_does_not_lead_in_a_circle(tmp_path):
    """`analyze` named `bag recover`, which named `analyze`."""
    bag = tmp_path / "bag"
    shutil.copytree(REAL / "rosbag2_sqlite3_message_zstd_split", bag)
    (bag / metadata.NAME).unlink()
    untouched(bag, ["compressed by rosbag2", "valve-control analyze reads it"])
    with closing(Bag(bag)) as opened_bag:
        assert not any("recover" in problem for problem in opened_bag.problems)
        assert sum(len(b.topic) for _, b in opened_bag.blocks(list(opened_bag.topics))) > 0
