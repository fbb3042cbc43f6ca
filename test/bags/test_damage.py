# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Damaged bags: no command ends in a traceback, and `recover` loses nothing that can be read.

What can be read is told by others. In MCAP: each message whose record stands unharmed in the file (in a
compressed chunk: whose chunk does), as long as the record of its channel does. In SQLite: what SQLite itself
finds in a copy, by a walk through the table in both directions and by each message's number.
"""

import functools
import gc
import random
import shutil
import sqlite3
import sys
import time
import traceback
from collections import Counter
from contextlib import closing, contextmanager, redirect_stderr, redirect_stdout, suppress
from io import BytesIO, StringIO
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
import sizes
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "recordings"))
from made import STORE, Run

from valve_control.cli import main
from valve_control.recordings.bags import metadata
from valve_control.recordings.bags.bag import Bag
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.recover import recover
from valve_control.recordings.bags.salvage import Salvage
from valve_control.recordings.bags.writer import BagWriter

PARTS = 4  # tests that share the damages
SAMPLES = 700


# Damages of one file


def flip(data, choose):
    for _ in range(choose.choice((1, 1, 1, 2, 5, 20))):
        data[choose.randrange(len(data))] ^= 1 << choose.randrange(8)


def insert(data, choose):
    at = choose.randrange(len(data))
    data[at:at] = choose.randbytes(choose.choice((1, 7, 100, 4096, 5000)))


def remove(data, choose):
    at = choose.randrange(len(data))
    del data[at : at + choose.choice((1, 9, 300, 4096, 9000))]


def zero_page(data, choose):
    for _ in range(choose.choice((1, 1, 3))):
        at = 4096 * choose.randrange(max(1, len(data) // 4096))
        data[at : at + 4096] = bytes(min(4096, len(data) - at))


def zero(data, choose):
    at = choose.randrange(len(data))
    size = min(choose.choice((1, 8, 50, 1000, 20_000)), len(data) - at)
    data[at : at + size] = bytes(size)


def garbage(data, choose):
    at = choose.randrange(len(data))
    size = min(choose.choice((2, 30, 500, 4096, 30_000)), len(data) - at)
    data[at : at + size] = choose.randbytes(size)


def truncate(data, choose):
    del data[choose.randrange(len(data)) :]


def truncate_a_little(data, choose):
    del data[-choose.randrange(1, min(600, len(data))) :]


def append(data, choose):
    data += choose.choice((choose.randbytes(3000), bytes(5000), bytes(data[:2000]), b"\x06"))


def swap(data, choose):
    one, two = sorted(4096 * choose.randrange(1 + len(data) // 4096) for _ in range(2))
    if two + 4096 <= len(data) and one + 4096 <= two:
        data[one : one + 4096], data[two : two + 4096] = data[two : two + 4096], data[one : one + 4096]


def head(data, choose):
    at = choose.randrange(min(110, len(data)))
    data[at : at + 4] = choose.randbytes(4)


def empty(data, choose):
    data.clear()


KINDS = (
    flip, flip, flip, insert, remove, zero_page, zero, garbage, garbage, truncate, truncate_a_little, append,
    swap, head, empty,
)  # fmt: skip


def damage(bag, choose):
    """Harm one or two files of the bag, most often a storage file; returns what was done."""
    done = []
    for _ in range(choose.choice((1, 1, 1, 2))):
        files = sorted(bag.iterdir())
        storage = [file for file in files if file.suffix != ".yaml"] or files
        file = choose.choice(storage if choose.random() < 0.93 else files)
        if choose.random() < 0.02:
            file.unlink()
            done.append(f"{file.name} removed")
            continue
        data = bytearray(file.read_bytes())
        if data:
            kind = choose.choice(KINDS)
            kind(data, choose)
            file.write_bytes(data)
            done.append(f"{kind.__name__} {file.name}")
    return ", ".join(done)


# Bags


def cascade():
    run = Run()
    run.move(SAMPLES // 2)
    run.change(arc__k1=100.0)
    run.move(SAMPLES - SAMPLES // 2)
    return run.messages


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Bags of each storage: finished, killed, in several files, compressed."""
    root = tmp_path_factory.mktemp("made")
    messages = cascade()
    bags = {"mcap": [], "sqlite3": []}
    for storage, compression, files, finished in (
        ("mcap", "none", 1, True), ("mcap", "none", 3, True), ("mcap", "zstd", 1, True),
        ("mcap", "lz4", 2, True), ("mcap", "none", 1, False), ("mcap", "zstd", 2, False),
        ("sqlite3", "none", 1, True), ("sqlite3", "none", 3, True), ("sqlite3", "none", 1, False),
        ("sqlite3", "none", 2, False),
    ):  # fmt: skip
        bag = root / f"{storage}_{compression}_{files}_{finished}"
        written = bag if finished else bag.with_name(f"open_{bag.name}")
        record(written, messages, storage, compression, files, bag if not finished else None)
        bags[storage].append(bag)
    return bags


def record(folder, messages, storage, compression, files, copy):
    """Write a bag; ``copy`` is what a kill at the end would have left of it."""
    span = (messages[-1].log_time - messages[0].log_time) / 1e9
    writer = BagWriter(folder, storage, 0, span / files if files > 1 else 0.0, compression)
    known = set()
    for i, message in enumerate(messages):
        if message.topic not in known:
            known.add(message.topic)
            text, _ = STORE.generate_msgdef(message.type, ros_version=2)
            writer.add_topic(message.topic, message.type, text, STORE.hash_rihs01(message.type))
        writer.write(message.topic, message.log_time, message.time, message.sequence, message.data)
        if i % 150 == 149:
            writer.flush()
    if copy is not None:
        writer.flush()
        shutil.copytree(folder, copy)
    writer.close()


# What others can read


class Originals:
    """Messages of a sound file: (topic, log time, data), and in MCAP what must stand for each to be read."""

    def __init__(self, path):
        self.messages = []
        self._needs = []  # of each message: any of these bytes
        self._channel_needs = {}  # of each topic: any of these bytes
        if path.suffix == ".mcap":
            self._read_mcap(path)
        else:
            with closing(sqlite3.connect(path)) as database:
                self.messages = database.execute(
                    "SELECT name, timestamp, data FROM messages JOIN topics ON topics.id = topic_id"
                ).fetchall()

    def _read_mcap(self, path):
        data = path.read_bytes()
        channels = {}
        chunk_of = []
        with suppress(Exception):  # the file of a killed recorder ends without a footer
            for record in StreamReader(BytesIO(data), emit_chunks=True).records:
                if isinstance(record, Channel):
                    self._know(channels, record, serialized(record))
                if isinstance(record, Chunk):
                    whole = serialized(record)
                    assert whole in data
                    for inner in breakup_chunk(record, validate_crc=True):
                        if isinstance(inner, Channel):
                            self._know(channels, inner, whole if record.compression else serialized(inner))
                        if isinstance(inner, Message):
                            chunk_of.append((inner, whole if record.compression else serialized(inner)))
        for message, needs in chunk_of:
            self.messages.append((channels[message.channel_id], message.log_time, bytes(message.data)))
            self._needs.append(needs)

    def _know(self, channels, channel, needs):
        channels[channel.id] = channel.topic
        self._channel_needs.setdefault(channel.topic, []).append(needs)

    def readable(self, path):
        """Those that can still be read in the damaged file ``path``."""
        return self._in_mcap(path) if path.suffix == ".mcap" else self._in_sqlite(path)

    def _in_mcap(self, path):
        data = path.read_bytes()
        known = {topic for topic, needs in self._channel_needs.items() if any(n in data for n in needs)}
        there = {}
        found = set()
        for message, needs in zip(self.messages, self._needs, strict=True):
            if message[0] in known and there.setdefault(needs, None) is None:
                there[needs] = needs in data
            if message[0] in known and there[needs]:
                found.add(message)
        return found

    def _in_sqlite(self, path):
        with TemporaryDirectory() as folder:
            copy = Path(folder) / path.name
            for file in path.parent.glob(f"{path.name}*"):
                shutil.copy(file, folder)
            with closing(sqlite3.connect(copy)) as database:
                names, rows = {}, []
                with suppress(sqlite3.Error, UnicodeDecodeError):
                    names = dict(database.execute("SELECT id, name FROM topics"))
                for order in ("ASC", "DESC"):
                    with suppress(sqlite3.Error, UnicodeDecodeError):
                        for row in database.execute(
                            f"SELECT topic_id, timestamp, data FROM messages ORDER BY id {order}"
                        ):
                            rows.append(row)
                for number in range(1, len(self.messages) + 1):
                    with suppress(sqlite3.Error, UnicodeDecodeError):
                        rows += database.execute(
                            "SELECT topic_id, timestamp, data FROM messages WHERE id = ?", (number,)
                        )
        return {(names.get(topic), *rest) for topic, *rest in rows} & set(self.messages)


@functools.cache
def originals_of(bag):
    with TemporaryDirectory() as folder:  # SQLite folds the log of a database that it opens
        copy = shutil.copytree(bag, Path(folder) / "bag")
        return {file.name: Originals(file) for file in copy.iterdir() if file.suffix in (".mcap", ".db3")}


def serialized(record):
    record.write(builder := RecordBuilder())
    return builder.end()


def recovered(bag):
    """Messages of a repaired bag, as others read them."""
    found = []
    for file in metadata.read(bag).relative_file_paths:
        path = bag / file
        if path.suffix == ".mcap":
            with path.open("rb") as stream:
                reader = make_reader(stream, validate_crcs=True)
                found += [(c.topic, m.log_time, bytes(m.data)) for _, c, m in reader.iter_messages()]
        else:
            with closing(sqlite3.connect(f"file:{path}?immutable=1", uri=True)) as database:
                assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
                found += database.execute(
                    "SELECT name, timestamp, data FROM messages JOIN topics ON topics.id = topic_id"
                ).fetchall()
    return found


# The trial


def commands(bag, work):
    """Every command that reads a bag; which of them ended otherwise than with a sentence."""
    wrong = []
    for arguments in (
        ["analyze", bag, "--json", work / "a.json"],
        ["replay", bag],
        ["compare", bag, bag],
        ["identify", bag],
    ):
        out, err = StringIO(), StringIO()
        try:
            with redirect_stdout(out), redirect_stderr(err):
                status = main([str(argument) for argument in arguments])
        except SystemExit as left:
            status = left.code
        except BaseException:
            wrong.append(f"{arguments[0]}: {traceback.format_exc()}")
            continue
        text = err.getvalue().strip()
        if status not in (0, 1, 2) or "Traceback" in text or (status == 2 and not text):
            wrong.append(f"{arguments[0]}: status {status}, {text!r}")
    gc.collect()  # a command gives its files back when its process ends
    return wrong


def trial(bag, work, choose):
    """Damage a copy of ``bag``, try all commands on it, repair it, try again; returns what went wrong."""
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir()
    harmed = work / bag.name
    shutil.copytree(bag, harmed)
    originals = originals_of(bag)
    done = damage(harmed, choose)
    shutil.copytree(harmed, work / "before")
    readable = set()
    for name, original in originals.items():
        if (harmed / name).exists():
            readable |= original.readable(work / "before" / name)
    before = {file.name: file.read_bytes() for file in harmed.iterdir()}
    wrong = commands(harmed, work)
    for name, data in before.items():
        if not name.endswith("-shm") and (harmed / name).read_bytes() != data:
            wrong.append(f"{name} was changed by a command that reads")
    wrong += repair(harmed, before, readable, {m for o in originals.values() for m in o.messages})
    return done, [text for text in wrong if text]


def repair(bag, before, readable, all_messages):
    with closing_bag(bag) as problems:
        damaged_chunks = [text for text in problems if "damaged" in text]
    try:
        result = recover(bag)
    except BagError as error:
        return [f"recover refused, {len(readable)} messages are readable: {error}"] if readable else []
    except Exception:
        return [f"recover: {traceback.format_exc()}"]
    wrong = []
    if damaged_chunks and not result.done:
        wrong.append(f"is whole, says recover, but analyze says {damaged_chunks}")
    got = recovered(bag)
    lost = readable - set(got)
    if lost:
        wrong.append(
            f"{len(lost)} of {len(readable)} readable messages lost, such as {sorted(lost)[0][:2]}; {result}"
        )
    if len(got) != result.messages:
        wrong.append(f"says {result.messages} messages, has {len(got)}")
    strange = [message for message in got if message not in all_messages]
    if any(f.name.endswith(".mcap") for f in bag.iterdir()) and len(strange) > sum(
        f.doubtful for f in result.files
    ):
        wrong.append(
            f"{len(strange)} messages that nobody sent, such as {strange[0][:2]}, not said: {result}"
        )
    for file in result.files:
        if file.kept and (bag / file.kept).read_bytes() != before[file.name]:
            wrong.append(f"{file.kept} is not what {file.name} was")
        if file.lost is not None and file.lost < 0:
            wrong.append(f"{file.lost} lost of {file.name}")
    with closing_bag(bag) as problems:
        left = [text for text in problems if "unfinished" in text or "damaged" in text]
        told = any("was repaired" in text for text in problems)
    if left or told != (any(file.doubtful for file in result.files)):
        wrong.append(f"after recover: {problems}, {result}")
    again = recover(bag)
    if again.done or again.messages != result.messages:
        wrong.append(f"not whole after recover: {again}")
    return wrong


@contextmanager
def closing_bag(path):
    """What the reader of bags complains about."""
    try:
        bag = Bag(path)
    except BagError as error:
        yield [str(error)]
        return
    with closing(bag):
        for _ in bag.blocks(list(bag.topics)):
            pass
        yield bag.problems


def calls_of_a_survey(folder, chunks):
    """How many functions a survey of a file of so many chunks calls."""
    with BagWriter(folder) as writer:
        writer.add_topic("/x", "std_msgs/msg/Float64", "float64 data", "", [])
        for k in range(chunks):
            writer.write("/x", k, k, k + 1, bytes(12))
            writer.flush()
    (path,) = folder.glob("*.mcap")
    salvage, calls = Salvage(path), Counter()
    sys.setprofile(lambda frame, event, argument: calls.update([event]))
    try:
        survey = salvage.survey()
    finally:
        sys.setprofile(None)
    assert survey.whole and survey.messages == chunks
    return calls["call"]


def test_the_time_of_a_survey_grows_with_the_length_of_the_file(tmp_path):
    """At each chunk all those before it were looked at again."""
    few, many = (calls_of_a_survey(tmp_path / str(n), n) for n in (150, 300))
    assert many < 2.1 * few


@pytest.mark.campaign
@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_harmed_bags(made, tmp_path, capsys, storage, part):
    """Damages of each storage, half of them before each of the bags was finished."""
    count = sizes.DAMAGES // PARTS
    failed = []
    begun = time.monotonic()
    for k in range(part * count, (part + 1) * count):
        bag = made[storage][k % len(made[storage])]
        done, wrong = trial(bag, tmp_path / "work", random.Random(1000 + k))
        if wrong:
            failed.append(f"{storage} {k} ({bag.name}: {done}):\n" + "\n".join(wrong))
            with capsys.disabled():
                print(f"\n{failed[-1]}")
        if k % 10 == 9:
            with capsys.disabled():
                done, elapsed = k + 1 - part * count, time.monotonic() - begun
                print(f"\n{storage} {done}/{count}: {elapsed:.0f} s, {len(failed)} failed", end="")
    assert not failed, "\n".join(failed)
