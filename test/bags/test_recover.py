# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Bags of killed recorders and damaged bags: what is whole is copied, and the bag stays as it is."""

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from test_writer import DEFINITION, EPOCH, FLOAT, HASH, MS, QOS, fill, opened, read, read_mcap, volts

from valve_control.recordings.bags import metadata
from valve_control.recordings.bags.bag import Bag
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.recover import recover

STORAGES = ["mcap", "sqlite3"]


def content(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def numbers(folder):
    """Numbers of the messages in the files of a bag, as other libraries read them."""
    return [m[3] for name in metadata.read(folder).files for m in read(folder / name)]


def chunks(path):
    with path.open("rb") as stream:
        return make_reader(stream).get_summary().chunk_indexes


@pytest.fixture
def bag(tmp_path):
    """500 messages in chunks of 100."""
    with opened(tmp_path / "bag", compression="zstd") as writer:
        for k in range(5):
            fill(writer, 100, 100 * k)
            writer.flush()
    return tmp_path / "bag"


@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
def test_whole_chunks_of_a_file_that_is_cut_anywhere_are_kept(tmp_path, compression):
    with opened(tmp_path / "bag", compression=compression) as writer:
        for k in range(5):
            fill(writer, 100, 100 * k)
            writer.flush()
    path = tmp_path / "bag" / "bag_0.mcap"
    (tmp_path / "bag" / metadata.NAME).unlink()
    data = path.read_bytes()
    ends = [c.chunk_start_offset + c.chunk_length for c in chunks(path)]
    for cut in sorted({*ends, *(end - 1 for end in ends[1:]), ends[0] + 17, len(data) - 9}):
        path.write_bytes(data[:cut])
        shutil.rmtree(tmp_path / "bag_recovered", ignore_errors=True)
        result = recover(tmp_path / "bag")
        count = 100 * sum(end <= cut for end in ends)
        assert result.messages == count and result.out == tmp_path / "bag_recovered"
        assert numbers(result.out) == list(range(1, count + 1))
        assert path.read_bytes() == data[:cut]
        with Reader(result.out) as reader:
            assert reader.message_count == count
            (profile,) = [
                c.ext.offered_qos_profiles for c in reader.connections if c.topic == "/spool_position"
            ]
        assert [p.depth for p in profile] == [QOS.depth] and profile[0].deadline == (1, 5)


@pytest.mark.parametrize("damage", ["a bit in it", "its first bytes"])
def test_a_damaged_chunk_is_left_out_and_counted(bag, tmp_path, monkeypatch, damage):
    path = bag / "bag_0.mcap"
    place = chunks(path)[2]
    data = bytearray(path.read_bytes())
    at = place.chunk_start_offset + (place.chunk_length - 20 if damage == "a bit in it" else 70)
    data[at] ^= 0x55
    path.write_bytes(data)
    before = content(bag)
    result = recover(bag)
    assert (result.damaged_chunks, result.lost, result.messages) == (1, 100, 400)
    assert numbers(result.out) == [*range(1, 201), *range(301, 501)]
    assert len(read_mcap(result.out / "bag_recovered_0.mcap")) == 400
    assert content(bag) == before
    assert not (again := recover(result.out)).problems and again.out is None
    monkeypatch.chdir(bag.rename(tmp_path / "run.1"))
    assert recover(Path()).out == tmp_path / "run.1_recovered"


@pytest.mark.parametrize("storage", STORAGES)
def test_lost_metadata_is_made_anew(tmp_path, storage):
    with opened(tmp_path / "bag", storage=storage) as writer:
        fill(writer, 500)
    assert recover(tmp_path / "bag").out is None
    (tmp_path / "bag" / metadata.NAME).unlink()
    before = content(tmp_path / "bag")
    recover(tmp_path / "bag", tmp_path / "copy")
    assert content(tmp_path / "bag") == before and numbers(tmp_path / "copy") == list(range(1, 501))
    with Reader(tmp_path / "copy") as reader:
        assert (reader.message_count, reader.start_time, reader.duration) == (500, EPOCH, 499 * MS + 1)
        (topic,) = [c for c in reader.connections if c.topic == "/spool_position"]
        assert (topic.msgtype, topic.digest, topic.msgdef.data) == (FLOAT, HASH, DEFINITION)
    with pytest.raises(BagError, match="copy exists already"):
        recover(tmp_path / "bag", tmp_path / "copy")
    with pytest.raises(BagError, match="lies in"):
        recover(tmp_path / "bag", tmp_path / "bag" / "copy")


def test_a_damaged_database_is_left_to_sqlite(tmp_path):
    with opened(tmp_path / "bag", storage="sqlite3") as writer:
        fill(writer, 5000)
    path = tmp_path / "bag" / "bag_0.db3"
    data = bytearray(path.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 40_000] = bytes(40_000)
    path.write_bytes(data)
    before = content(tmp_path / "bag")
    with pytest.raises(BagError, match=r"sqlite3 FILE \.recover"):
        recover(tmp_path / "bag")
    assert content(tmp_path / "bag") == before and not (tmp_path / "bag_recovered").exists()


def test_old_tables_without_times_and_definitions_are_copied(tmp_path):
    """Databases of the first releases of rosbag2 name no serialization."""
    path = tmp_path / "old.db3"
    with closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT)")
        database.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
        )
        database.execute("INSERT INTO topics VALUES (1, 'spool_position', 'std_msgs/Float64')")
        rows = [(k + 1, 1, EPOCH + k * MS, volts(float(k))) for k in range(100)]
        database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
        database.commit()
    (tmp_path / "bag").mkdir()
    path.rename(tmp_path / "bag" / "old.db3")
    result = recover(tmp_path / "bag")
    with closing(Bag(result.out)) as copy:
        series = copy.read({"/spool_position": ["data"]})["/spool_position"]
    assert series.values["data"].tolist() == list(range(100))


def test_a_pointer_of_git_lfs_is_named(tmp_path):
    with opened(tmp_path / "bag") as writer:
        fill(writer, 300)
    writer.path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2146\nsize 12345\n")
    for function in (Bag, recover):
        with pytest.raises(BagError, match="git lfs pull"):
            function(writer.path)
