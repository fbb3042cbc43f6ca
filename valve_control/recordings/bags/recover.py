# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Recovers a bag whose recorder was killed or whose files are damaged: `valve-control bag recover`."""

import contextlib
import itertools
import os
import re
import shutil
import sqlite3
import struct
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Schema, Statistics
from rosbags.interfaces import Qos

from valve_control.arrays import Integers
from valve_control.recordings.bags import metadata, repair
from valve_control.recordings.bags.bag import KINDS, ZSTD, Bag, in_order, times
from valve_control.recordings.bags.errors import BagError, NothingError
from valve_control.recordings.bags.mcap import MAGIC, McapFile
from valve_control.recordings.bags.messages import CDR, absolute, full_type
from valve_control.recordings.bags.metadata import Counted, File, Metadata, TopicMetadata
from valve_control.recordings.bags.pages import read_log
from valve_control.recordings.bags.placeholders import refuse
from valve_control.recordings.bags.rebuilding import rebuild
from valve_control.recordings.bags.rewriting import rewrite
from valve_control.recordings.bags.salvage import Salvage
from valve_control.recordings.bags.sqlite import HEAD, opened
from valve_control.recordings.bags.storage import BUSY, SQLITE_SCHEMA
from valve_control.recordings.bags.writer import SUFFIXES, Lock, reason

SIDE_FILES = ("-wal", "-shm", "-journal")  # what SQLite leaves beside a database that was not closed
KEPT = re.compile(r"(?P<name>.+\.(?:mcap|db3))\.damaged(?:\.(?P<number>\d+))?")
CLOSE = 1_000_000  # ns by which times in metadata.yaml may differ from those of the messages
UNFINISHED = (
    ".part",
    ".partial",
    ".crdownload",
    ".filepart",
    ".download",
    ".tmp",
)  # of browsers, rsync and curl
NEW = ".repair"  # ends the name of a file that is being written anew


class UnfinishedError(BagError):
    """Says that a file of the bag is still on its way."""


class RecoveredFile(NamedTuple):
    """What was done to one storage file."""

    name: str
    messages: int
    repaired: bool  # False: it was whole
    cut: int = 0  # bytes that could not be read
    lost: int | None = 0  # messages that it held and that could not be read; None: nobody can tell
    doubtful: int = 0  # messages that stood in damaged chunks: their values may be wrong
    nameless: int = 0  # messages whose topics' names are lost
    kept: str = ""  # name of the damaged file, which was kept
    empty: bool = False  # there was not one byte in it
    gone: bool = False  # nothing of a bag was in it, and the bag goes on without it
    missing: bool = False  # metadata.yaml names it, and it is not there
    unlisted: bool = False  # it is there, and metadata.yaml did not name it
    foreign: bool = False  # likewise, and its stamps are those of a file that it names: it is left out


class Recovered(NamedTuple):
    """What was done to a bag."""

    bag: Path
    files: tuple[RecoveredFile, ...]
    done: bool  # False: the bag was whole and was not touched
    metadata_kept: str = ""  # name under which the metadata.yaml from before was kept

    @property
    def messages(self) -> int:
        """Number of messages in the whole bag."""
        return sum(file.messages for file in self.files)

    @property
    def cut(self) -> int:
        """Number of bytes of the whole bag that could not be read."""
        return sum(file.cut for file in self.files)

    @property
    def lost(self) -> int | None:
        """Number of messages of the whole bag that could not be read, None if unknown."""
        known = [file.lost for file in self.files if file.lost is not None]
        return sum(known) if len(known) == len(self.files) else None


class _Inventory(NamedTuple):
    """Content of one file: topics, messages, times."""

    file: File
    topics: tuple[Counted, ...]
    head: Integers  # log times of its first messages [ns]


class _State(NamedTuple):
    """What a file needs: nothing, its end, or to be written anew."""

    repair: Callable[[], RecoveredFile] | None  # None: it is whole
    fold: bool = False  # whether a log stands beside it that belongs into it


def recover(path: Path, out: Path | None = None) -> Recovered:
    """Make the bag ``path`` (a folder, or one .mcap or .db3 file of it) whole, in place or as a copy ``out``.

    A file that only lacks its end gets it. One that is damaged is written anew from all that can be read in
    it, and kept beside under a name that ends with .damaged. The folder gets a metadata.yaml made from its
    files, in the order of their times. A whole bag is not touched, nor one of which a file stands for another
    that was not fetched, or whose metadata.yaml is of a version that is not known. If this is interrupted
    nothing is lost: call it again. Raises BagError.
    """
    try:
        if not path.exists() and not path.is_symlink() and not _interrupted(path):
            raise BagError(f"{path} does not exist")
    except OSError as error:
        raise BagError(f"{path} cannot be read: {reason(error)}") from error
    _refuse_foreign(path)
    if out is None:
        return _in_place(path, keep=True)
    if not _interrupted(path):
        _files(path)
    copy = _copied(path, out)
    try:
        return _in_place(copy, keep=False)
    except BagError:
        shutil.rmtree(copy) if copy.is_dir() else _remove(copy)
        raise


def _in_place(path: Path, keep: bool) -> Recovered:
    """Recover the bag ``path``; ``keep``: damaged files."""
    try:
        lock = Lock(path if path.is_dir() else path.absolute().parent)
    except OSError as error:
        raise BagError(f"{path} cannot be read: {reason(error)}") from error
    try:
        _take_up(path)
        _refuse_compressed(path)
        storage, files = _files(path)
        return _recovered(path, storage, files, keep)
    finally:
        lock.release()


def _refuse_foreign(path: Path) -> None:
    """Raise BagError for files that were not fetched, and for a metadata.yaml of an unknown version."""
    try:
        for file in sorted(path.iterdir()) if path.is_dir() else [path]:
            of_bag = file.suffix in (*KINDS, *ZSTD) or file.name == metadata.NAME or file == path
            if of_bag and (file.is_file() or file.is_symlink()):
                refuse(file)
    except OSError as error:
        raise BagError(f"{error.filename or path} cannot be read: {reason(error)}") from error
    if path.is_dir():
        try:
            for name in metadata.read(path).relative_file_paths:
                _refuse_unfinished(path / name)
        except UnfinishedError:
            raise
        except metadata.UnknownVersionError as error:
            raise BagError(
                f"{error}; the bag is left as it is (under another name of that file, one of version "
                f"{metadata.VERSION} is made of the bag's files)"
            ) from error
        except BagError:
            pass


def _refuse_unfinished(path: Path) -> None:
    """Raise BagError if ``path`` is missing because its transfer goes on, or stopped on the way."""
    for name in (path.name + ending for ending in UNFINISHED):
        if path.with_name(name).exists() and not path.exists():
            raise UnfinishedError(
                f"{path} is missing and {name} lies beside it: finish its transfer, or remove it, first"
            )


def _refuse_compressed(path: Path) -> None:
    """Raise BagError for bags that rosbag2 compressed: their content cannot be checked here."""
    if not path.is_dir():
        return
    packed = [f.name for f in path.iterdir() if f.suffix in ZSTD]
    mode = ""
    with contextlib.suppress(BagError):
        mode = metadata.read(path).compression_mode
    if not packed and mode in ("", "NONE", "none"):
        with contextlib.suppress(BagError), contextlib.closing(Bag(path)) as bag:
            mode = bag.compression
    if packed or mode not in ("", "NONE", "none"):
        what = f"{packed[0]} is" if packed else "its messages are"
        raise BagError(
            f"{path} cannot be repaired: {what} compressed by rosbag2, and only uncompressed bags can be; "
            "valve-control analyze reads it as it is"
        )


def _recovered(path: Path, storage: str, files: Sequence[Path], keep: bool) -> Recovered:
    told: Metadata | None = None
    if path.is_dir():
        with contextlib.suppress(BagError):
            told = metadata.read(path)
    listed = told.relative_file_paths if told is not None else ()
    files = sorted(files, key=lambda f: listed.index(f.name) if f.name in listed else len(listed))
    done: list[RecoveredFile] = []
    inventories: list[_Inventory] = []
    folds: list[Path] = []
    nothing: dict[Path, NothingError] = {}
    for file in files:
        try:
            state = EXAMINERS[storage](file, told, keep)
            result = state.repair() if state.repair is not None else None
            inventory = READERS[storage](file)
        except NothingError as error:
            nothing[file] = error
            continue
        except (OSError, sqlite3.Error, McapError, struct.error) as error:
            raise BagError(f"{file} cannot be repaired: {reason(error)}") from error
        count = inventory.file.message_count
        entry = result._replace(messages=count) if result else RecoveredFile(file.name, count, False)
        done.append(entry._replace(unlisted=told is not None and file.name not in listed))
        inventories.append(inventory)
        if state.fold:
            folds.append(file)
    if nothing.keys() >= set(files):
        raise nothing[files[0]]
    for file in nothing:
        try:
            aside = _put_aside(file, keep, "unreadable")
        except OSError as error:
            raise BagError(f"{file} cannot be renamed: {reason(error)}") from error
        done.append(RecoveredFile(file.name, 0, True, lost=_told_count(told, file), kept=aside, gone=True))
    for name in listed:
        if name not in {entry.name for entry in done} and path.is_dir():
            done.append(RecoveredFile(name, 0, False, lost=_told_count(told, path / name), missing=True))
    foreign = {
        one.file.path
        for one in inventories
        if listed
        and one.file.path not in listed
        and any(_is_copy(one, other, files[0].parent) for other in inventories if other.file.path in listed)
    }
    inventories = [one for one in inventories if one.file.path not in foreign]
    done = [entry._replace(messages=0, foreign=True) if entry.name in foreign else entry for entry in done]
    made = _made(storage, in_order(inventories, [inventory.head for inventory in inventories]))
    order = {name: at for at, name in enumerate(made.relative_file_paths)}
    done.sort(key=lambda entry: order.get(entry.name, len(order)))
    if not path.is_dir() or _fits(told, made):
        return Recovered(path, tuple(done), any(file.repaired for file in done), "")
    for file in folds:
        try:
            _fold(file)
        except sqlite3.Error as error:
            raise BagError(f"{file} cannot be repaired: {reason(error)}") from error
        done = [entry._replace(repaired=True) if entry.name == file.name else entry for entry in done]
    return Recovered(path, tuple(done), True, _write_metadata(path, told, made, keep))


def _is_copy(one: _Inventory, other: _Inventory, folder: Path) -> bool:
    """Whether more than half of the messages of the shorter file have stamps of the longer one."""
    few, many = sorted((one.file, other.file), key=lambda file: file.message_count)
    together = min(_end(few), _end(many)) - max(few.starting_time, many.starting_time)
    if few.message_count == 0 or 2 * together < min(few.duration, many.duration):
        return False
    common = np.isin(_stamps(folder / few.path), _stamps(folder / many.path))
    return 2 * int(np.count_nonzero(common)) > few.message_count


def _end(file: File) -> int:
    return file.starting_time + file.duration


def _stamps(path: Path) -> Integers:
    """Log times of all messages of a file [ns]."""
    if path.suffix == SUFFIXES["sqlite3"]:
        with closing(opened(path, immutable=not _is_logged(path))) as database:
            return np.array(database.execute("SELECT timestamp FROM messages").fetchall(), np.int64).ravel()
    with closing(McapFile(path)) as file:
        return np.concatenate([np.empty(0, np.int64), *(block.log_time for block in file.blocks())])


def _files(path: Path) -> tuple[str, list[Path]]:
    """Storage and files of a bag, oldest first."""
    found = sorted(path.iterdir(), key=_number) if path.is_dir() else [path]
    by_storage = {
        storage: [file for file in found if file.suffix == suffix and file.is_file()]
        for storage, suffix in SUFFIXES.items()
    }
    filled = [storage for storage, files in by_storage.items() if files]
    if len(filled) != 1:
        have = "both .mcap and .db3 files" if filled else "no .mcap or .db3 file"
        raise BagError(
            f"{path} has {have}; a bag has files of one storage"
            if path.is_dir()
            else f"{path} is not of a bag; its name must end with .mcap or .db3"
        )
    return filled[0], by_storage[filled[0]]


def _number(path: Path) -> tuple[int, str]:
    """Sort key by which bag_10 comes after bag_9."""
    digits = re.search(r"_(\d+)$", path.stem)
    return (int(digits.group(1)) if digits else -1, path.name)


def _copied(path: Path, out: Path) -> Path:
    if any(os.path.lexists(out.with_name(out.name + ending)) for ending in ("", *SIDE_FILES)):
        raise BagError(f"{out} or a file beside it exists already; the copy needs a new name")
    if out.resolve().is_relative_to(path.resolve()):
        raise BagError(f"{out} lies in {path}; the copy needs a place of its own")
    try:
        if path.is_dir():
            needed = {kept.name + end for _, kept in _interrupted(path) for end in ("", *SIDE_FILES)}
            left_out = shutil.ignore_patterns("*.damaged*", "*.unreadable*", f"*{NEW}")
            shutil.copytree(path, out, ignore=lambda folder, names: left_out(folder, names) - needed)
        else:
            source = next((kept for _, kept in _interrupted(path)), path)
            shutil.copy2(source, out)
            for file, ending in itertools.product({path, source}, SIDE_FILES):
                side = file.with_name(file.name + ending)
                if side.exists():
                    shutil.copy2(side, out.with_name(out.name + ending))
    except BaseException as error:  # Ctrl-C too
        shutil.rmtree(out, ignore_errors=True)
        for ending in ("", *SIDE_FILES):
            with contextlib.suppress(OSError):
                out.with_name(out.name + ending).unlink()
        if isinstance(error, (OSError, shutil.Error)):
            raise BagError(f"{path} cannot be copied to {out}: {reason(error)}") from error
        raise
    return out


# A file written anew takes the place of the damaged one


def _replaced(path: Path, keep: bool, write: Callable[[Path], RecoveredFile]) -> RecoveredFile:
    """Let ``write`` make the file anew, and put it in the place of ``path``.

    At any moment either ``path`` is there with its side files, or `_take_up` finds how to bring it back.
    ``outputs.write`` would not do: it takes a whole content, keeps no damaged file and knows no side files.
    """
    new = path.with_name(path.name + NEW)
    new.unlink(missing_ok=True)
    try:
        result = write(new)
        with new.open("rb") as stream:
            os.fsync(stream.fileno())
    except BaseException:
        new.unlink(missing_ok=True)
        raise
    kept = _put_aside(path, keep=True)
    new.rename(path)
    if keep:
        return result._replace(kept=kept)
    _remove(path.with_name(kept))
    return result


def _put_aside(path: Path, keep: bool, suffix: str = "damaged") -> str:
    """Rename a file and its side files for keeping; returns the new name."""
    kept = _free_name(path, suffix)
    path.rename(kept)
    for ending in SIDE_FILES:
        side = path.with_name(path.name + ending)
        if side.exists():
            side.rename(kept.with_name(kept.name + ending))
    if keep:
        return kept.name
    _remove(kept)
    return ""


def _remove(path: Path) -> None:
    for name in (path.name, *(path.name + ending for ending in SIDE_FILES)):
        path.with_name(name).unlink(missing_ok=True)


def _free_name(path: Path, suffix: str) -> Path:
    name = path.with_name(f"{path.name}.{suffix}")
    number = 1
    while name.exists():
        number += 1
        name = path.with_name(f"{path.name}.{suffix}.{number}")
    return name


def _interrupted(path: Path) -> list[tuple[Path, Path]]:
    """Files of the bag that are missing, and the names under which an interrupted recovery kept them."""
    folder = path if path.is_dir() else path.absolute().parent
    if not folder.is_dir():
        return []
    newest: dict[Path, tuple[int, Path]] = {}
    for file in folder.iterdir():
        match = KEPT.fullmatch(file.name)
        if match is None or (not path.is_dir() and match["name"] != path.name):
            continue
        number = int(match["number"] or 1)
        name = file.with_name(match["name"])
        newest[name] = max(newest.get(name, (0, file)), (number, file))
    return [(name, kept) for name, (_, kept) in newest.items() if not name.exists()]


def _take_up(path: Path) -> None:
    """Bring back files that an interrupted recovery had put away. Raises BagError."""
    try:
        for name, kept in _interrupted(path):
            for ending in SIDE_FILES:
                side = kept.with_name(kept.name + ending)
                if side.exists():
                    side.rename(name.with_name(name.name + ending))
            kept.rename(name)
    except OSError as error:
        raise BagError(f"{path} cannot be repaired: {reason(error)}") from error


def _lost(expected: int | None, messages: int) -> int | None:
    return max(0, expected - messages) if expected is not None else None


def _told_count(told: Metadata | None, path: Path) -> int | None:
    """Number of messages of the file according to metadata.yaml."""
    if told is None:
        return None
    for file in told.files:
        if Path(file.path).name == path.name:
            return file.message_count
    return (
        told.message_count if [Path(name).name for name in told.relative_file_paths] == [path.name] else None
    )


# metadata.yaml


def _made(storage: str, inventories: Sequence[_Inventory]) -> Metadata:
    counts: dict[TopicMetadata, int] = {}
    for inventory in inventories:
        for topic, count in inventory.topics:
            counts[topic] = counts.get(topic, 0) + count
    return metadata.of_files(
        storage,
        [Counted(topic, count) for topic, count in counts.items()],
        [inventory.file for inventory in inventories],
    )


def _fits(present: Metadata | None, made: Metadata) -> bool:
    return (
        present is not None
        and (present.storage_identifier, present.relative_file_paths, present.message_count)
        == (made.storage_identifier, made.relative_file_paths, made.message_count)
        and (
            made.message_count == 0
            or abs(present.starting_time - made.starting_time) <= CLOSE
            and abs(present.duration - made.duration) <= CLOSE
        )
        and _counts(present) == _counts(made)
    )


def _counts(told: Metadata) -> Counter[tuple[str, str]]:
    """Number of messages of each topic that has any, by name and type."""
    counts: Counter[tuple[str, str]] = Counter()
    for topic, count in told.topics:
        counts[_key(topic)] += count
    return +counts


def _key(topic: TopicMetadata) -> tuple[str, str]:
    return absolute(topic.name), full_type(topic.type)


def _write_metadata(folder: Path, present: Metadata | None, made: Metadata, keep: bool) -> str:
    """Write metadata.yaml, with what only ``present`` knows; returns the name under which that is kept."""
    path = folder / metadata.NAME
    if present is not None:
        told = {_key(topic): topic for topic, _ in present.topics}
        topics = [Counted(_completed(topic, told.pop(_key(topic), topic)), n) for topic, n in made.topics]
        silent = [Counted(topic, 0) for topic in told.values()]
        made = made._replace(
            topics=(*topics, *silent),
            custom_data=present.custom_data,
            ros_distro=present.ros_distro or made.ros_distro,
        )
    try:
        kept = _free_name(path, "damaged").name if keep and path.exists() else ""
        if kept:
            shutil.copy2(path, folder / kept)
        metadata.write(folder, made)
    except OSError as error:
        raise BagError(f"{path} cannot be written: {reason(error)}") from error
    return kept


def _completed(topic: TopicMetadata, told: TopicMetadata) -> TopicMetadata:
    """``topic`` as its file has it, with what that lacks, and the serialization, as metadata.yaml has it."""
    return topic._replace(
        serialization_format=told.serialization_format,
        offered_qos_profiles=topic.offered_qos_profiles or told.offered_qos_profiles,
        type_description_hash=topic.type_description_hash or told.type_description_hash,
    )


# MCAP


def _examine_mcap(path: Path, told: Metadata | None, keep: bool) -> _State:
    expected = _told_count(told, path)
    if path.stat().st_size == 0:
        lost = _lost(expected, 0)
        return _State(lambda: _ended(path, repair.Contents())._replace(lost=lost, empty=True))
    salvage = Salvage(
        path, {counted.topic.name: counted.topic.type for counted in told.topics} if told else None
    )
    survey = salvage.survey()
    if survey.whole:
        return _State(None)
    survey = salvage.survey()  # now it is known how long the messages of each topic are
    expected = survey.expected if survey.expected is not None else expected
    if survey.unfinished:
        # Its end can be written in place, unless more can be read than what is whole before the tear.
        contents = repair.scan(salvage)
        if contents.counts.total() == survey.messages:
            return _State(lambda: _ended(path, contents)._replace(lost=_lost(expected, survey.messages)))
    if not salvage.channels:
        raise NothingError(
            f"{path} has no topic that can be read, and so no message: it is no MCAP file or damaged all over"
            if salvage.raw(0, len(MAGIC)) == MAGIC
            else f"{path} is not an MCAP file: it does not begin with MCAP's magic bytes, and has no topic"
        )

    def write(new: Path) -> RecoveredFile:
        found = rewrite(salvage, new)
        again = Salvage(new).survey()
        if not again.whole or again.messages != found.messages or found.messages < survey.messages:
            raise BagError(f"{path} is damaged and is left as it is: what was read in it cannot be written")
        lost = _lost(expected, found.messages)
        return RecoveredFile(path.name, found.messages, True, survey.skipped, lost, found.doubtful)

    return _State(lambda: _replaced(path, keep, write))


def _ended(path: Path, contents: repair.Contents) -> RecoveredFile:
    return RecoveredFile(path.name, contents.counts.total(), True, repair.repair(path, contents))


def _read_mcap(path: Path) -> _Inventory:
    with closing(McapFile(path)) as file:
        head = times(file.head())
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        if summary is not None and summary.statistics is not None:
            return _mcap_inventory(path, summary.statistics, summary.channels, summary.schemas, head)
    contents = repair.scan(Salvage(path))
    return _mcap_inventory(path, contents.statistics(), contents.channels, contents.schemas, head)


def _mcap_inventory(
    path: Path,
    statistics: Statistics,
    channels: dict[int, Channel],
    schemas: dict[int, Schema],
    head: Integers,
) -> _Inventory:
    counts: Counter[TopicMetadata] = Counter()
    for channel in channels.values():
        schema = schemas.get(channel.schema_id)
        topic = TopicMetadata(
            channel.topic,
            schema.name if schema is not None else "",
            channel.message_encoding,
            _qos(channel.metadata.get("offered_qos_profiles", "")),
            channel.metadata.get("topic_type_hash", ""),
        )
        counts[topic] += statistics.channel_message_counts.get(channel.id, 0)
    start, end = statistics.message_start_time, statistics.message_end_time
    file = File(path.name, start, end - start, statistics.message_count)
    return _Inventory(file, tuple(Counted(topic, count) for topic, count in counts.items()), head)


def _qos(text: object) -> tuple[Qos, ...]:
    """QoS profiles from their text, none if it is damaged."""
    try:
        return metadata.parse_qos(text)
    except BagError:
        return ()


# SQLite


def _examine_sqlite(path: Path, told: Metadata | None, keep: bool) -> _State:
    log = path.with_name(path.name + "-wal")
    expected = _told_count(told, path)
    logged = _is_logged(path)
    if path.stat().st_size == 0 and not logged:
        lost = _lost(expected, 0)

        def begin() -> RecoveredFile:
            with closing(sqlite3.connect(path, isolation_level=None)) as database:
                database.executescript(SQLITE_SCHEMA)
            return RecoveredFile(path.name, 0, True, lost=lost, empty=True)

        return _State(begin)
    # SQLite removes the log of an empty database, and leaves out what follows damage in a log.
    if path.stat().st_size > 0 and not (logged and read_log(log).damaged) and _verdict(path, logged) == "ok":
        return _State(None, fold=logged)

    def write(new: Path) -> RecoveredFile:
        found = rebuild(path, new, told)
        most = max(expected or 0, found.highest)
        return RecoveredFile(
            path.name, found.messages, True, lost=most - found.messages, nameless=found.nameless
        )

    return _State(lambda: _replaced(path, keep, write))


def _is_logged(path: Path) -> bool:
    """Whether a log with content stands beside the database."""
    log = path.with_name(path.name + "-wal")
    return log.exists() and log.stat().st_size > 0


def _verdict(path: Path, logged: bool) -> str:
    """The word ok, or what is wrong, according to SQLite and the tables of a bag."""
    journal = path.with_name(path.name + "-journal")
    if journal.exists() and journal.stat().st_size > 0:
        return "a transaction was not ended"
    try:
        with closing(opened(path, immutable=not logged)) as database:
            for (verdict,) in database.execute("PRAGMA integrity_check(1)"):
                if verdict != "ok":
                    return str(verdict)
            ((tables,),) = database.execute(
                "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name IN ('topics', 'messages')"
            )
            if tables < 2:
                return "it has not the tables of a bag"
            ((strange,),) = database.execute(
                "SELECT count(*) FROM messages WHERE typeof(timestamp) != 'integer' OR typeof(data) != 'blob'"
                " OR topic_id NOT IN (SELECT id FROM topics)"
            )
            ((unnamed,),) = database.execute("SELECT count(*) FROM topics WHERE typeof(name) != 'text'")
            return "messages of no topic" if strange or unnamed else "ok"
    except (sqlite3.Error, UnicodeDecodeError) as error:
        return str(error)


def _fold(path: Path) -> None:
    """Merge the log into the database; SQLite refuses while somebody else has it open."""
    with closing(sqlite3.connect(path, timeout=BUSY, isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode=DELETE")


def _read_sqlite(path: Path) -> _Inventory:
    with closing(opened(path, immutable=not _is_logged(path))) as database:
        columns = {row[1] for row in database.execute("PRAGMA table_info(topics)")}
        if "name" not in columns:
            raise BagError(f"{path} is an SQLite database, but not of a bag: it has no table of topics")
        qos = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
        type_hash = "type_description_hash" if "type_description_hash" in columns else "''"
        encoding_column = "serialization_format" if "serialization_format" in columns else f"'{CDR}'"
        # One bit makes a text a BLOB of the same bytes.
        texts = ", ".join(f"CAST({text} AS TEXT)" for text in ("type", encoding_column, qos, type_hash))
        counts = dict(database.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
        topics = [
            Counted(TopicMetadata(name, kind, encoding, _qos(profiles), digest), counts.get(number, 0))
            for number, name, kind, encoding, profiles, digest in database.execute(
                f"SELECT id, name, {texts} FROM topics ORDER BY id"
            )
        ]
        ((start, end),) = database.execute(
            "SELECT ifnull(min(timestamp), 0), ifnull(max(timestamp), 0) FROM messages"
        )
        firsts = database.execute(f"SELECT timestamp FROM messages ORDER BY id LIMIT {HEAD}").fetchall()
    head = np.array(firsts, dtype=np.int64).ravel()
    return _Inventory(File(path.name, start, end - start, sum(counts.values())), tuple(topics), head)


EXAMINERS: dict[str, Callable[[Path, Metadata | None, bool], _State]] = {
    "mcap": _examine_mcap,
    "sqlite3": _examine_sqlite,
}
READERS: dict[str, Callable[[Path], _Inventory]] = {"mcap": _read_mcap, "sqlite3": _read_sqlite}
