"""A bag whose recorder was killed is made whole again."""

import contextlib
import re
import shutil
import sqlite3
import struct
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Schema, Statistics

from valve_control.bags import mending, metadata
from valve_control.bags.bag import Bag
from valve_control.bags.errors import BagError
from valve_control.bags.metadata import Counted, File, Metadata, Topic
from valve_control.bags.writer import BUSY, SQLITE_SCHEMA, SUFFIXES, Lock, reason

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
SIDE_FILES = ("-wal", "-shm", "-journal")  # what SQLite leaves beside a database that was not closed


class RecoveredFile(NamedTuple):
    """One storage file."""

    name: str
    messages: int
    mended: bool  # False: it was whole
    cut: int  # bytes of a torn record that were cut off


class Recovered(NamedTuple):
    """What was done."""

    bag: Path
    files: tuple[RecoveredFile, ...]
    done: bool  # False: the bag was whole and was not touched

    @property
    def messages(self) -> int:
        """In the whole bag."""
        return sum(file.messages for file in self.files)

    @property
    def cut(self) -> int:
        """Bytes cut off in the whole bag."""
        return sum(file.cut for file in self.files)


class _Inventory(NamedTuple):
    """What is in one file."""

    file: File
    topics: tuple[Counted, ...]


def recover(path: Path, out: Path | None = None) -> Recovered:
    """Make the bag ``path`` (a folder, or one .mcap or .db3 file of it) whole, in place or as a copy ``out``.

    Each file gets its end, and the folder a metadata.yaml made from its files. A whole bag is not touched.
    If this is interrupted nothing is lost: call it again. Raises BagError.
    """
    if not path.exists():
        raise BagError(f"{path} does not exist")
    if out is not None:
        _files(path)
        path = _copied(path, out)
    _refuse_compressed(path)
    storage, files = _files(path)
    try:
        lock = Lock(path if path.is_dir() else path.absolute().parent)
    except OSError as error:
        raise BagError(f"{path} cannot be read: {reason(error)}") from error
    try:
        return _recovered(path, storage, files)
    finally:
        lock.release()


def _refuse_compressed(path: Path) -> None:
    """Refuse bags that rosbag2 compressed: what is in them is not seen here. Raises BagError."""
    packed = [f.name for f in path.iterdir() if f.suffix in (".zstd", ".zst")] if path.is_dir() else []
    mode = ""
    if path.is_dir():
        with contextlib.suppress(BagError):
            mode = metadata.read(path).compression_mode
        if not mode and not packed:
            with contextlib.suppress(BagError):
                with contextlib.closing(Bag(path)) as bag:
                    firsts = [bag.first(name) for name in bag.topics]
                mode = "MESSAGE" if any(first and first[:4] == ZSTD_MAGIC for first in firsts) else ""
    if packed or mode not in ("", "NONE", "none"):
        what = f"{packed[0]} is" if packed else "its messages are"
        raise BagError(
            f"{path} cannot be mended: {what} compressed by rosbag2, and only uncompressed bags can be; "
            "valve-control analyze reads it as it is"
        )


def _recovered(path: Path, storage: str, files: Sequence[Path]) -> Recovered:
    done: list[RecoveredFile] = []
    inventories: list[_Inventory] = []
    for file in files:
        try:
            mended, cut = MENDERS[storage](file)
            inventory = READERS[storage](file)
        except (OSError, sqlite3.Error, McapError, struct.error) as error:
            raise BagError(f"{file} cannot be mended: {reason(error)}") from error
        done.append(RecoveredFile(file.name, inventory.file.message_count, mended, cut))
        inventories.append(inventory)
    anything = any(file.mended for file in done)
    if path.is_dir():
        anything = _mend_metadata(path, storage, inventories) or anything
    return Recovered(path, tuple(done), anything)


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
    """Key that sorts bag_10 after bag_9."""
    digits = re.search(r"_(\d+)$", path.stem)
    return (int(digits.group(1)) if digits else -1, path.name)


def _copied(path: Path, out: Path) -> Path:
    if out.exists():
        raise BagError(f"{out} exists already; the copy needs a new name")
    try:
        if path.is_dir():
            shutil.copytree(path, out)
        else:
            shutil.copy2(path, out)
            for ending in SIDE_FILES:
                side = path.with_name(path.name + ending)
                if side.exists():
                    shutil.copy2(side, out.with_name(out.name + ending))
    except (OSError, shutil.Error) as error:
        raise BagError(f"{path} cannot be copied to {out}: {reason(error)}") from error
    return out


def _mend_metadata(folder: Path, storage: str, inventories: Sequence[_Inventory]) -> bool:
    """Write metadata.yaml unless there is one that fits; whether it was written."""
    counts: dict[Topic, int] = {}
    for inventory in inventories:
        for topic, count in inventory.topics:
            counts[topic] = counts.get(topic, 0) + count
    made = metadata.of_files(
        storage,
        [Counted(topic, count) for topic, count in counts.items()],
        [inventory.file for inventory in inventories],
    )
    try:
        present = metadata.read(folder)
    except BagError:
        present = None
    if present is not None:
        if _fits(present, made):
            return False
        made = made._replace(custom_data=present.custom_data)
    try:
        metadata.write(folder, made)
    except OSError as error:
        raise BagError(f"{folder / metadata.NAME} cannot be written: {reason(error)}") from error
    return True


def _fits(present: Metadata, made: Metadata) -> bool:
    return (
        present.storage_identifier == made.storage_identifier
        and present.relative_file_paths == made.relative_file_paths
        and present.message_count == made.message_count
    )


# MCAP


def _mend_mcap(path: Path) -> tuple[bool, int]:
    if mending.is_finished(path):
        return False, 0
    return True, mending.mend(path).cut


def _read_mcap(path: Path) -> _Inventory:
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        if summary is not None and summary.statistics is not None:
            return _mcap_inventory(path, summary.statistics, summary.channels, summary.schemas)
        stream.seek(0)
        contents = mending.scan(stream, path.stat().st_size, path)
    return _mcap_inventory(path, contents.statistics(), contents.channels, contents.schemas)


def _mcap_inventory(
    path: Path, statistics: Statistics, channels: dict[int, Channel], schemas: dict[int, Schema]
) -> _Inventory:
    counts: Counter[Topic] = Counter()
    for channel in channels.values():
        schema = schemas.get(channel.schema_id)
        topic = Topic(
            channel.topic,
            schema.name if schema is not None else "",
            channel.message_encoding,
            metadata.parse_qos(channel.metadata.get("offered_qos_profiles", "")),
            channel.metadata.get("topic_type_hash", ""),
        )
        counts[topic] += statistics.channel_message_counts.get(channel.id, 0)
    start, end = statistics.message_start_time, statistics.message_end_time
    file = File(path.name, start, end - start, statistics.message_count)
    return _Inventory(file, tuple(Counted(topic, count) for topic, count in counts.items()))


# SQLite


def _mend_sqlite(path: Path) -> tuple[bool, int]:
    unfinished = path.stat().st_size == 0 or any(
        path.with_name(path.name + ending).exists() for ending in SIDE_FILES
    )
    if not unfinished:
        return False, 0
    with closing(sqlite3.connect(path, timeout=BUSY, isolation_level=None)) as database:
        ((verdict,), *_) = database.execute("PRAGMA integrity_check(1)")
        if verdict != "ok":
            raise BagError(f"{path} is damaged and is left as it is: {verdict}")
        ((tables,),) = database.execute("SELECT count(*) FROM sqlite_master")
        if tables == 0:
            database.executescript(SQLITE_SCHEMA)
        # Takes in what is committed in the log; refused while somebody else has the database open.
        database.execute("PRAGMA journal_mode=DELETE")
    return True, 0


def _read_sqlite(path: Path) -> _Inventory:
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
        columns = {row[1] for row in database.execute("PRAGMA table_info(topics)")}
        if "name" not in columns:
            raise BagError(f"{path} is an SQLite database, but not of a bag: it has no table of topics")
        qos = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
        type_hash = "type_description_hash" if "type_description_hash" in columns else "''"
        counts = dict(database.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
        topics = [
            Counted(Topic(name, kind, encoding, metadata.parse_qos(profiles), digest), counts.get(number, 0))
            for number, name, kind, encoding, profiles, digest in database.execute(
                f"SELECT id, name, type, serialization_format, {qos}, {type_hash} FROM topics ORDER BY id"
            )
        ]
        ((start, end),) = database.execute(
            "SELECT ifnull(min(timestamp), 0), ifnull(max(timestamp), 0) FROM messages"
        )
    return _Inventory(File(path.name, start, end - start, sum(counts.values())), tuple(topics))


MENDERS: dict[str, Callable[[Path], tuple[bool, int]]] = {"mcap": _mend_mcap, "sqlite3": _mend_sqlite}
READERS: dict[str, Callable[[Path], _Inventory]] = {"mcap": _read_mcap, "sqlite3": _read_sqlite}
