# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Bags whose recorder was killed, and files that end anywhere."""

import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from mcap.reader import make_reader
from rosbags.interfaces import QosReliability
from rosbags.rosbag2 import Reader
from test_writer import EPOCH, HASH, MS, STORAGES, fill, opened, read, read_mcap, read_sqlite, volts

from valve_control.recordings.bags import metadata
from valve_control.recordings.bags.bag import Bag
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.recover import recover

CHUNK = 50  # messages in each flush
CHUNKS = 8


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Finished MCAP files by compression, and where their chunks end."""
    made = {}
    for compression in ("none", "zstd", "lz4"):
        folder = tmp_path_factory.mktemp("whole") / "bag"
        with opened(folder, compression=compression) as writer:
            for k in range(CHUNKS):
                fill(writer, CHUNK, CHUNK * k)
                writer.flush()
        path = folder / "bag_0.mcap"
        with path.open("rb") as stream:
            chunks = make_reader(stream).get_summary().chunk_indexes
        made[compression] = path.read_bytes(), [c.chunk_start_offset + c.chunk_length for c in chunks]
    return made


def torn(folder, data):
    folder.mkdir()
    path = folder / "bag_0.mcap"
    path.write_bytes(data)
    return path


def check_repaired(path, data, ends):
    """All messages of whole chunks are there, no gap, summary and checksums in order."""
    got = read_mcap(path)
    least = CHUNK * sum(end <= len(data) for end in ends)
    assert [m[3] for m in got] == list(range(1, len(got) + 1)), "gap"
    assert least <= len(got) <= least + CHUNK
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary.statistics.message_count == len(got)
    if got:
        assert summary.statistics.message_start_time == EPOCH
        assert summary.statistics.message_end_time == EPOCH + (len(got) - 1) * MS
    for index in summary.chunk_indexes:
        assert len(index.message_index_offsets) == 1
    return got


@pytest.mark.parametrize(
    "compression", ["none", *(pytest.param(name, marks=pytest.mark.campaign) for name in ("zstd", "lz4"))]
)
def test_a_file_may_end_anywhere(tmp_path, whole, compression):
    """Cut at 150 random places, and at each byte around the ends of records."""
    data, ends = whole[compression]
    choose = random.Random(1)
    cuts = {choose.randrange(len(data)) for _ in range(150)}
    for end in (ends[0], ends[-1]):
        cuts |= set(range(end - 12, end + 12))
    cuts |= set(range(0, 60, 3)) | set(range(len(data) - 60, len(data), 3))
    salvaged = 0
    for cut in sorted(cuts):
        folder = tmp_path / str(cut)
        path = torn(folder, data[:cut])
        result = recover(folder)
        got = check_repaired(path, data[:cut], ends)
        assert result.done and result.messages == len(got) and result.files[0].repaired
        assert result.cut <= cut
        (file,) = metadata.read(folder).files
        assert file.message_count == len(got)
        salvaged += len(got) % CHUNK > 0
        again = recover(folder)
        assert not again.done and again.cut == 0 and again.messages == len(got)
    assert (salvaged > 20) == (compression == "none")


def test_salvaged_messages_of_a_torn_chunk_are_the_first_ones(tmp_path, whole):
    data, ends = whole["none"]
    message = 9 + 22 + len(volts(0.0))
    path = torn(tmp_path / "bag", data[: ends[3] - 10 * message - 5])
    result = recover(tmp_path / "bag")
    assert [m[4] for m in read(path)] == [volts(0.001 * k) for k in range(4 * CHUNK - 11)]
    assert result.cut == message - 5


def test_topics_come_back_with_their_qos(tmp_path, whole):
    data, _ = whole["zstd"]
    torn(tmp_path / "bag", data[: len(data) // 2])
    recover(tmp_path / "bag")
    topics = {t.topic.name: t.topic for t in metadata.read(tmp_path / "bag").topics}
    assert set(topics) == {"/spool_position", "/valve_voltage"}
    assert topics["/spool_position"].type_description_hash == HASH
    assert topics["/spool_position"].offered_qos_profiles[0].reliability == QosReliability.BEST_EFFORT


@pytest.mark.parametrize("zeros", [1, 100, 5000])
def test_zeros_that_a_file_system_leaves_are_cut_off(tmp_path, whole, zeros):
    data, ends = whole["none"]
    torn(tmp_path / "bag", data[: ends[2]] + bytes(zeros))
    assert recover(tmp_path / "bag").cut == zeros
    check_repaired(tmp_path / "bag" / "bag_0.mcap", data[: ends[2]], ends)


INTERRUPTED = """
import os, signal, sys
from io import FileIO
from pathlib import Path
from valve_control.recordings.bags import repair
from valve_control.recordings.bags.salvage import Salvage

left = int(sys.argv[2])

def write(output, data):
    global left
    output.write(data[:left])
    left -= len(data)
    if left <= 0:
        os.kill(os.getpid(), signal.SIGKILL)

repair.put = write
path = Path(sys.argv[1])
repair.repair(path, repair.scan(Salvage(path)))
"""


def test_a_killed_recovery_loses_nothing(tmp_path, whole):
    """Recovery itself is killed after some bytes; the second one finds all that the first would have."""
    data, ends = whole["none"]
    cut = data[: ends[3] - 500]
    undisturbed = torn(tmp_path / "bag", cut)
    recover(tmp_path / "bag")
    expected = read(undisturbed)
    for k, left in enumerate((49, 50, 60, 200, 700, 1500, 2500)):
        path = torn(tmp_path / str(k), cut)
        done = subprocess.run([sys.executable, "-c", INTERRUPTED, path, str(left)], timeout=60, check=False)
        assert done.returncode == -signal.SIGKILL
        recover(tmp_path / str(k))
        assert read(path) == expected


def test_a_whole_bag_is_not_touched(tmp_path):
    for storage in STORAGES:
        folder = tmp_path / storage
        with opened(folder, storage=storage, max_seconds=0.1) as writer:
            fill(writer, 500)
        before = {p.name: (p.read_bytes(), p.stat().st_mtime_ns) for p in folder.iterdir()}
        result = recover(folder)
        assert not result.done and result.messages == 500 and not any(f.repaired for f in result.files)
        assert before == {p.name: (p.read_bytes(), p.stat().st_mtime_ns) for p in folder.iterdir()}


def test_a_copy_that_ends_before_its_time_is_taken_away(tmp_path, whole):
    """It looked like a bag, and the next copy was refused because of it."""
    torn(tmp_path / "bag", whole["none"][0])
    (tmp_path / "bag" / "notes").symlink_to("nowhere")
    with pytest.raises(BagError, match="cannot be copied"):
        recover(tmp_path / "bag", tmp_path / "copy")
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]


def test_a_copy_is_repaired_and_the_bag_left_alone(tmp_path, whole):
    data, ends = whole["none"]
    path = torn(tmp_path / "bag", data[: ends[4]])
    result = recover(tmp_path / "bag", tmp_path / "copy")
    assert result.bag == tmp_path / "copy" and result.messages == 5 * CHUNK
    assert path.read_bytes() == data[: ends[4]] and not (tmp_path / "bag" / metadata.NAME).exists()
    check_repaired(tmp_path / "copy" / "bag_0.mcap", data[: ends[4]], ends)
    with pytest.raises(BagError, match="exists already"):
        recover(tmp_path / "bag", tmp_path / "copy")
    beside = tmp_path / "other.db3-wal"
    beside.write_bytes(b"of another bag")
    with pytest.raises(BagError, match="a file beside it exists already"):
        recover(path, tmp_path / "other.db3")
    assert beside.read_bytes() == b"of another bag"
    with pytest.raises(BagError, match="lies in"):
        recover(tmp_path / "bag", tmp_path / "bag" / "copy")
    single = recover(path, tmp_path / "single.mcap")
    assert single.messages == 5 * CHUNK and len(read(tmp_path / "single.mcap")) == 5 * CHUNK


def test_lost_metadata_is_made_anew(tmp_path):
    with opened(tmp_path / "bag", max_seconds=0.05) as writer:
        fill(writer, 1200)
    path = tmp_path / "bag" / metadata.NAME
    before = metadata.read(tmp_path / "bag")
    assert len(before.files) > 10
    path.unlink()
    assert recover(tmp_path / "bag").done
    assert metadata.read(tmp_path / "bag") == before
    path.write_text(path.read_text().replace("message_count: 1200", "message_count: 1100"))
    assert recover(tmp_path / "bag").done
    assert metadata.read(tmp_path / "bag") == before


def bad(folder, name, data):
    folder.mkdir()
    (folder / name).write_bytes(data)


def test_what_is_no_bag_is_one_sentence_and_not_touched(tmp_path, whole):
    data, _ = whole["zstd"]
    cases = {
        "empty folder": ({}, "no .mcap or .db3 file"),
        "text": ({"a.mcap": b"once upon a time"}, "does not begin with MCAP's magic bytes"),
        "two": ({"a.mcap": data, "a.db3": b""}, "both .mcap and .db3 files"),
        "no header": ({"a.mcap": data[:8] + b"\x01" + b"\x40" * 2000}, "no topic that can be read"),
        "no database": ({"a.db3": b"x" * 5000}, "not a database"),
        "other database": ({"a.db3-wal": b"", "a.db3": b"no" * 3000}, "not a database"),
    }
    for name, (files, words) in cases.items():
        folder = tmp_path / name
        folder.mkdir()
        for file, content in files.items():
            (folder / file).write_bytes(content)
        with pytest.raises(BagError) as error:
            recover(folder)
        assert words in str(error.value) and "\n" not in str(error.value), name
        for file, content in files.items():
            assert not content or (folder / file).read_bytes() == content
    for path in (tmp_path / "none", tmp_path / "text" / "b.txt"):
        with pytest.raises(BagError, match="does not exist"):
            recover(path)
    (tmp_path / "b.txt").write_text("")
    with pytest.raises(BagError, match="must end with .mcap or .db3"):
        recover(tmp_path / "b.txt")


KILLED = """
import sys
from pathlib import Path
sys.path[:0] = [{here!r}]
from test_writer import fill, opened

writer = opened(Path(sys.argv[1]), storage=sys.argv[2], max_seconds=3.0)
k = 0
while True:
    fill(writer, 100, k)
    writer.flush()
    k += 100
    print(k, flush=True)
"""


@pytest.mark.parametrize("storage", STORAGES)
def test_all_that_was_flushed_outlives_a_kill(tmp_path, storage):
    """A writer at full speed is killed while it writes; files rotate meanwhile."""
    choose = random.Random(2)
    for k in range(5):
        folder = tmp_path / str(k)
        child = subprocess.Popen(
            [sys.executable, "-c", KILLED.format(here=str(Path(__file__).parent)), folder, storage],
            stdout=subprocess.PIPE,
            text=True,
        )
        wanted = choose.randrange(2_000, 20_000)
        told = 0
        for line in child.stdout:
            told = int(line)
            if told >= wanted:
                break
        with pytest.raises(BagError, match="still being written"):
            recover(folder)
        child.send_signal(signal.SIGKILL)
        told = int(([str(told), *child.stdout.read().split()])[-1])
        child.wait()
        child.stdout.close()
        result = recover(folder)
        assert result.done and told <= result.messages <= told + 100
        numbers = [m[3] for file in metadata.read(folder).files for m in read(folder / file.path)]
        # Of a transaction that was not ended, the messages may be in the log and their numbers not yet.
        assert numbers == list(range(1, len(numbers) + 1)) and told <= len(numbers) <= result.messages
        assert storage == "sqlite3" or len(numbers) == result.messages
        with Reader(folder) as reader:
            assert reader.message_count == result.messages
            assert [t for _, t, _ in reader.messages()] == [EPOCH + k * MS for k in range(result.messages)]
        # A log that ends in the middle of a transaction holds more than SQLite reads: it is kept.
        kept = tuple(file.kept for file in result.files if file.kept)
        beside = [p.name for p in folder.iterdir() if p.suffix not in (".mcap", ".db3", ".yaml")]
        assert all(name.startswith(kept) for name in beside), beside
        shutil.rmtree(folder)


def test_a_database_that_was_just_begun_becomes_an_empty_bag(tmp_path):
    bad(tmp_path / "bag", "bag_0.db3", b"")
    assert recover(tmp_path / "bag").done
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count == 0


def test_a_bag_on_a_read_only_disk_is_one_sentence(tmp_path, whole):
    if os.geteuid() == 0:
        pytest.skip("root may write anywhere")
    data, ends = whole["none"]
    torn(tmp_path / "bag", data[: ends[4]]).chmod(0o444)
    with pytest.raises(BagError, match="cannot be repaired: Permission denied"):
        recover(tmp_path / "bag")


@pytest.mark.parametrize("name", ["kilted_mcap_file_zstd", "rosbag2_sqlite3_message_zstd_split"])
@pytest.mark.parametrize("metadata_left", [True, False])
def test_what_rosbag2_compressed_is_refused_and_not_touched(tmp_path, name, metadata_left):
    """Repaired as if it were not compressed, a part of it would be read no more."""
    bag = tmp_path / "bag"
    shutil.copytree(Path(__file__).resolve().parents[1] / "data" / "bags" / name, bag)
    if not metadata_left:
        (bag / "metadata.yaml").unlink()
    before = {path.name: path.read_bytes() for path in bag.iterdir()}
    with pytest.raises(BagError, match="compressed by rosbag2"):
        recover(bag)
    assert {path.name: path.read_bytes() for path in bag.iterdir()} == before


# Damage


def test_bytes_inserted_in_mid_file_cost_what_they_hit(tmp_path, whole):
    """It cost all that followed: the file was cut off in place."""
    data, ends = whole["none"]
    hurt = data[: ends[2] + 500] + random.Random(1).randbytes(777) + data[ends[2] + 500 :]
    path = torn(tmp_path / "bag", hurt)
    result = recover(tmp_path / "bag")
    (file,) = result.files
    assert file.lost <= 1 and file.messages == CHUNKS * CHUNK - file.lost and file.cut >= 777
    assert (tmp_path / "bag" / file.kept).read_bytes() == hurt
    sent = {volts(0.001 * k) for k in range(CHUNKS * CHUNK)}
    assert len(read_mcap(path)) == file.messages and {m[4] for m in read_mcap(path)} <= sent
    again = recover(tmp_path / "bag")
    assert not again.done and again.messages == file.messages


def test_a_message_that_lost_its_end_does_not_take_those_behind_it_with_it(tmp_path):
    """Bytes are gone so that by chance a record begins where the torn message ends by its length."""
    with opened(tmp_path / "bag") as writer:
        for k in range(20):
            fill(writer, 10, 10 * k)
            writer.write("/valve_voltage", EPOCH + 10 * k * MS, EPOCH, k + 1, bytes([k] * 2000))
    path = tmp_path / "bag" / "bag_0.mcap"
    data, sent = path.read_bytes(), read_mcap(path)
    end = data.index(bytes([7] * 2000)) + 2000
    five_short_ones = 5 * (9 + 22 + len(volts(0.0)))
    path.write_bytes(data[: end - five_short_ones] + data[end:])
    recover(tmp_path / "bag")
    assert [m for m in sent if m not in read_mcap(path)] == [m for m in sent if m[4] == bytes([7] * 2000)]


@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
def test_a_finished_file_with_a_damaged_chunk_is_not_whole(tmp_path, whole, compression):
    """Its end is as it must be, and "is whole" was said of it; what `analyze` leaves out is had or told."""
    data, ends = whole[compression]
    hurt = bytearray(data)
    at = ends[2] - 700  # in the third chunk
    hurt[at : at + 4] = b"\xff\xff\xff\xff"
    path = torn(tmp_path / "bag", bytes(hurt))
    with closing(Bag(path)) as bag:
        seen = sum(len(block.topic) for _, block in bag.blocks(["/spool_position"]))
        assert any("damaged" in problem for problem in bag.problems) and seen == (CHUNKS - 1) * CHUNK
    result = recover(tmp_path / "bag", tmp_path / "copy")
    (file,) = result.files
    assert result.done and file.messages + file.lost == CHUNKS * CHUNK and file.kept == ""
    assert file.messages >= seen and (compression != "none" or file.lost <= 1)
    with closing(Bag(tmp_path / "copy")) as bag:
        assert any("values may be wrong" in problem for problem in bag.problems) == (file.doubtful > 0)
        assert not any("damaged" in problem or "unfinished" in problem for problem in bag.problems)
    assert path.read_bytes() == hurt


def whole_sqlite(folder, count=2000):
    with opened(folder, storage="sqlite3") as writer:
        fill(writer, count)
    return folder / f"{folder.name}_0.db3"


def test_a_zeroed_page_costs_its_own_messages(tmp_path):
    """Page by page, whichever it is: of the tree, of messages, of topics, the first."""
    path = whole_sqlite(tmp_path / "bag", 1500)
    data = path.read_bytes()
    text = (tmp_path / "bag" / metadata.NAME).read_text()
    for page in range(0, len(data) // 4096):
        path.write_bytes(data[: 4096 * page] + bytes(4096) + data[4096 * (page + 1) :])
        result = recover(tmp_path / "bag")
        (file,) = result.files
        assert file.lost <= 160 and file.messages + file.lost == 1500, page
        got = read_sqlite(path)
        sent = {(EPOCH + k * MS, volts(0.001 * k)) for k in range(1500)}
        assert len(got) >= file.messages - 250 and {(m[1], m[4]) for m in got} <= sent
        with closing(sqlite3.connect(path)) as database:
            assert {row[0] for row in database.execute("SELECT name FROM topics")} >= {"/spool_position"}
        (tmp_path / "bag" / file.kept).unlink()
        (tmp_path / "bag" / metadata.NAME).write_text(text)


def test_a_truncated_database_is_salvaged(tmp_path):
    path = whole_sqlite(tmp_path / "bag")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2 + 1234])
    result = recover(tmp_path / "bag")
    (file,) = result.files
    assert file.messages > 800 and file.messages + file.lost == 2000
    with closing(sqlite3.connect(path)) as database:
        got = database.execute("SELECT timestamp, data FROM messages").fetchall()
    assert len(got) == file.messages and set(got) <= {(EPOCH + k * MS, volts(0.001 * k)) for k in range(2000)}
    assert path.with_name(file.kept).stat().st_size == len(data) // 2 + 1234


HARMED_ROWS = {
    "a type and a hash that are no texts": "UPDATE topics SET type = CAST(type AS BLOB), "
    "type_description_hash = CAST(type_description_hash AS BLOB)",
    "a QoS that is no UTF-8": "UPDATE topics SET offered_qos_profiles = CAST(X'5B5DFF' AS TEXT)",
    "large numbers of topics": "UPDATE topics SET id = id + (1 << 40)",
}


@pytest.mark.parametrize("change", HARMED_ROWS)
def test_rows_that_a_few_bits_have_changed_are_read(tmp_path, change):
    """SQLite finds nothing wrong with them; reader or recovery ended in a traceback, or refused them."""
    path = whole_sqlite(tmp_path / "bag")
    kinds = {topic.name: topic.type for topic, _ in metadata.read(tmp_path / "bag").topics}
    (tmp_path / "bag" / metadata.NAME).unlink()
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute(HARMED_ROWS[change])
        if "numbers" in change:
            database.execute("UPDATE messages SET topic_id = topic_id + (1 << 40)")
    for _ in range(2):
        with closing(Bag(tmp_path / "bag")) as bag:
            values = bag.read({"/spool_position": ["data"]})["/spool_position"].values["data"]
        assert len(values) == 2000 and values[-1] == 0.001 * 1999
        assert recover(tmp_path / "bag").messages == 2000
        assert {topic.name: topic.type for topic, _ in metadata.read(tmp_path / "bag").topics} == kinds


def test_a_database_without_its_log_is_read_without_a_trace(tmp_path):
    """rosbag2 leaves it in this mode with its resilient preset; SQLite made two files beside it."""
    path = whole_sqlite(tmp_path / "bag")
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA journal_mode=WAL")
    before = {p.name: p.read_bytes() for p in (tmp_path / "bag").iterdir()}
    assert before[path.name][18:20] == b"\2\2"
    link = tmp_path / "link.db3"
    link.symlink_to(path)
    for place in (tmp_path / "bag", path, link):
        with closing(Bag(place)) as bag:
            assert len(bag.read({}, raw=["/spool_position"])["/spool_position"].raw) == 2000
    assert {p.name: p.read_bytes() for p in (tmp_path / "bag").iterdir()} == before
    assert not list(tmp_path.glob("link.db3-*"))


def killed_sqlite(folder, count=2000):
    """As a kill leaves it: a database, and its log with most of the messages."""
    made = folder.with_name("made")
    writer = opened(made, storage="sqlite3")
    fill(writer, count)
    writer.flush()
    shutil.copytree(made, folder)
    writer.close()
    return folder / "made_0.db3"


def test_a_damaged_log_costs_only_what_it_lost(tmp_path):
    """SQLite itself reads a log up to its first damage, and removes that of an empty database."""
    path = killed_sqlite(tmp_path / "bag")
    log = path.with_name(path.name + "-wal")
    sound = log.read_bytes()
    for k, at in enumerate((10, 40, 5000, len(sound) // 2, len(sound) - 100)):
        folder = shutil.copytree(tmp_path / "bag", tmp_path / str(k))
        hurt = bytearray(sound)
        hurt[at] ^= 0x55
        (folder / log.name).write_bytes(hurt)
        assert recover(folder).messages >= 1990, at
    folder = shutil.copytree(tmp_path / "bag", tmp_path / "empty")
    (folder / path.name).write_bytes(b"")
    assert recover(folder).messages == 2000
    assert [m[3] for m in read_sqlite(folder / path.name)] == list(range(1, 2001))


def test_a_whole_bag_with_a_log_is_not_touched(tmp_path):
    folder = tmp_path / "bag"
    killed_sqlite(folder)
    recover(folder, tmp_path / "copy")
    shutil.copy(tmp_path / "copy" / metadata.NAME, folder)
    before = {p.name: p.read_bytes() for p in folder.iterdir() if not p.name.endswith("-shm")}
    assert any(name.endswith("-wal") and data for name, data in before.items())
    result = recover(folder)
    assert not result.done and result.messages == 2000
    assert before == {p.name: p.read_bytes() for p in folder.iterdir() if not p.name.endswith("-shm")}


@pytest.mark.parametrize("storage", STORAGES)
def test_a_file_without_one_byte_is_not_whole_again(tmp_path, storage):
    with opened(tmp_path / "bag", storage=storage) as writer:
        fill(writer, 100)
    (path,) = [p for p in (tmp_path / "bag").iterdir() if p.suffix != ".yaml"]
    path.write_bytes(b"")
    (file,) = recover(tmp_path / "bag").files
    assert file.empty and file.messages == 0 and file.lost == 100


@pytest.mark.parametrize("out", [False, True], ids=["in place", "copy"])
def test_files_of_nothing_alone_are_refused_under_their_names(tmp_path, out):
    """All but the last one were renamed .unreadable before the refusal."""
    before = {f"b_{k}.mcap": b"nothing of a bag" * (1000 + k) for k in range(3)}
    (tmp_path / "bag").mkdir()
    for name, data in before.items():
        (tmp_path / "bag" / name).write_bytes(data)
    with pytest.raises(BagError, match="b_0.mcap is not an MCAP file"):
        recover(tmp_path / "bag", tmp_path / "copy" if out else None)
    assert {path.name: path.read_bytes() for path in (tmp_path / "bag").iterdir()} == before


def test_one_file_of_nothing_leaves_the_others(tmp_path):
    with opened(tmp_path / "bag", max_seconds=0.1) as writer:
        fill(writer, 300)
    names = metadata.read(tmp_path / "bag").relative_file_paths
    (tmp_path / "bag" / names[1]).write_bytes(b"nothing of a bag" * 1000)
    result = recover(tmp_path / "bag")
    gone = result.files[-1] if result.files[-1].gone else next(f for f in result.files if f.gone)
    assert gone.name == names[1] and gone.lost == 100 and result.messages == 200
    assert (tmp_path / "bag" / gone.kept).read_bytes() == b"nothing of a bag" * 1000
    assert metadata.read(tmp_path / "bag").relative_file_paths == (names[0], names[2])
    assert not recover(tmp_path / "bag").done


@pytest.mark.parametrize("moment", range(4))
def test_a_replacement_that_is_interrupted_is_taken_up_again(tmp_path, moment):
    """The damaged file and its log have other names for a moment; a kill then must lose nothing."""
    path = killed_sqlite(tmp_path / "bag")
    log = path.with_name(path.name + "-wal")
    hurt = bytearray(log.read_bytes())
    hurt[5000] ^= 0x55
    log.write_bytes(hurt)
    moves = [(path, f"{path.name}.damaged"), (log, f"{path.name}.damaged-wal")]
    for file, name in moves[:moment]:
        file.rename(file.with_name(name))
    if moment == 3:
        (tmp_path / "bag" / f"{path.name}.repair").write_bytes(b"half a file")
    for source, out in ((tmp_path / "bag", tmp_path / "copy"), (path, tmp_path / "copy.db3")):
        assert recover(source, out).messages >= 1990
    assert {p.name for p in (tmp_path / "copy").iterdir()} == {path.name, metadata.NAME}
    result = recover(tmp_path / "bag")
    assert result.messages >= 1990
    left = {p.name for p in (tmp_path / "bag").iterdir()}
    assert path.name in left and log.name not in left and not any(name.endswith(".repair") for name in left)
    assert path.with_name(f"{path.name}.damaged-wal").read_bytes() == hurt


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("left", [0, 1, 2])
def test_a_copy_takes_up_what_an_interrupted_recovery_put_away(tmp_path, storage, left):
    """The copy lacked that file, "lost 0"; of a bag of one such file it was refused."""
    with opened(tmp_path / "bag", storage=storage, max_seconds=0.1) as writer:
        fill(writer, 300)
    paths = [tmp_path / "bag" / name for name in metadata.read(tmp_path / "bag").relative_file_paths]
    (tmp_path / "bag" / metadata.NAME).unlink()
    kept = paths[1].with_name(f"{paths[1].name}.damaged")
    paths[1].rename(kept)
    if left:
        paths[0].with_name(f"{paths[0].name}.damaged").write_bytes(b"of an earlier, finished recovery")
    for path in (paths[0], paths[2])[left:]:
        path.unlink()
    before = {path.name: path.read_bytes() for path in (tmp_path / "bag").iterdir()}
    result = recover(tmp_path / "bag", tmp_path / "copy")
    assert (result.messages, result.lost) == (100 * (left + 1), 0)
    names = {path.name for path in paths if path.exists()} | {paths[1].name, metadata.NAME}
    assert {path.name for path in (tmp_path / "copy").iterdir()} == names
    single = recover(paths[1], tmp_path / f"single{paths[1].suffix}")
    assert single.messages == 100 and len(read(single.bag)) == 100
    assert {path.name: path.read_bytes() for path in (tmp_path / "bag").iterdir()} == before
