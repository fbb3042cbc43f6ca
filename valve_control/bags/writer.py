"""Writes rosbag2 bags (Jazzy); what was flushed survives a kill of the process."""

import fcntl
import os
import sqlite3
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn, Protocol, Self

from mcap.writer import CompressionType, Writer

from valve_control.bags import metadata, repair
from valve_control.bags.errors import BagError
from valve_control.bags.metadata import Counted, File, Qos, TopicMetadata

COMPRESSION = {"none": CompressionType.NONE, "zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4}
LIBRARY = "valve_control"
PENDING = 2**20  # bytes of messages that are held in memory at most
OVERHEAD = 31  # bytes of an MCAP message record beside its data
BUSY = 1.0  # s to wait for somebody who reads the database

SQLITE_SCHEMA = """
BEGIN;
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
CREATE TABLE topics(
    id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL,
    offered_qos_profiles TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(
    id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
    encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(
    id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
CREATE TABLE valve_control_times(message_id INTEGER PRIMARY KEY, publish_time INTEGER, sequence INTEGER);
INSERT INTO schema(schema_version, ros_distro) VALUES (4, 'jazzy');
COMMIT;
"""


def reason(error: Exception) -> str:
    """Message of the operating system or of SQLite."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


class Lock:
    """File lock on a bag's folder, held by the process that writes to the bag; it ends with the process."""

    def __init__(self, folder: Path) -> None:
        self._descriptor = os.open(folder, os.O_RDONLY)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.release()
            raise BagError(f"{folder} is still being written; stop its recorder first") from None
        except OSError:
            pass  # some network file systems cannot lock a folder

    def release(self) -> None:
        """Release the lock."""
        os.close(self._descriptor)


class Storage(Protocol):
    """One storage file. ``write`` and ``size`` apart, all methods raise OSError or sqlite3.Error."""

    path: Path
    pending: int  # bytes of messages in memory

    def add_topic(self, topic: TopicMetadata, definition: str) -> None:
        """Add ``topic`` with the ``definition`` of its message type, "" if that is not known."""

    def write(self, topic: str, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        """Buffer a message; times in ns."""

    def size(self) -> int:
        """Size of the file [bytes], with what is buffered."""

    def flush(self) -> None:
        """Write everything that is buffered."""

    def finish(self, text: str) -> None:
        """Finish the file after a flush; ``text``: the bag's metadata, to be stored in it."""

    def abandon(self) -> None:
        """After an error, go back to the last flush, and finish the file if that is possible."""


class Output:
    """File for the MCAP writer: each flush is one write, and a failed one can be taken back."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb", buffering=0)
        self._waiting: list[bytes] = []
        self._position = 0
        self.flushed = 0

    def write(self, data: bytes) -> int:
        """Buffer ``data``."""
        self._waiting.append(data)
        self._position += len(data)
        return len(data)

    def tell(self) -> int:
        """Position after all buffered data."""
        return self._position

    def flush(self) -> None:
        """Write what is buffered. Raises OSError."""
        rest = memoryview(b"".join(self._waiting))
        while rest:
            rest = rest[self._file.write(rest) :]
        self._waiting.clear()
        self.flushed = self._position

    def take_back(self) -> None:
        """Truncate to the last successful flush, and close. Raises OSError."""
        try:
            self._file.truncate(self.flushed)
        finally:
            self._file.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class McapStorage:
    """An MCAP file of profile ros2."""

    SUFFIX = ".mcap"

    def __init__(self, path: Path, compression: str) -> None:
        self.path = path
        self.pending = 0
        self._output = Output(path)
        output: Any = self._output
        self._writer: Any = Writer(output, chunk_size=2 * PENDING, compression=COMPRESSION[compression])
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._writer.start("ros2", LIBRARY)
        self.flush()

    def add_topic(self, topic: TopicMetadata, definition: str) -> None:
        """Add a channel, and the schema of its type."""
        if topic.type not in self._schemas:
            self._schemas[topic.type] = self._writer.register_schema(
                topic.type, "ros2msg" if definition else "", definition.encode()
            )
        self._channels[topic.name] = self._writer.register_channel(
            topic.name,
            topic.serialization_format,
            self._schemas[topic.type],
            {
                "offered_qos_profiles": metadata.qos_text(topic.offered_qos_profiles),
                "topic_type_hash": topic.type_description_hash,
            },
        )

    def write(self, topic: str, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        """Add a message to the open chunk."""
        self._writer.add_message(self._channels[topic], log_time, data, publish_time, sequence & 0xFFFFFFFF)
        self.pending += OVERHEAD + len(data)

    def size(self) -> int:
        """Size of the file [bytes], with what is buffered."""
        return self._output.tell() + self.pending

    def flush(self) -> None:
        """End the open chunk and write it."""
        self._writer.flush()
        self.pending = 0

    def finish(self, text: str) -> None:
        """Write summary and footer."""
        self._writer.add_metadata("rosbag2", {"serialized_metadata": text})
        self._writer.finish()
        self._output.flush()
        self._output.close()

    def abandon(self) -> None:
        """Go back to the last flush; indexes are made anew, since the writer's name unwritten messages."""
        self._output.take_back()
        repair.repair(self.path)


class SqliteStorage:
    """An SQLite database with rosbag2's schema 4, and a table of ours for source times and numbers."""

    SUFFIX = ".db3"

    def __init__(self, path: Path, compression: str) -> None:
        self.path = path
        self.pending = 0
        self._topics: dict[str, int] = {}
        self._types: set[str] = set()
        self._messages: list[tuple[int, int, int, bytes]] = []
        self._times: list[tuple[int, int, int]] = []
        self._count = 0
        self._size = 0
        path.touch(exist_ok=False)
        self._database = sqlite3.connect(path, timeout=BUSY, isolation_level=None)
        self._database.execute("PRAGMA journal_mode=WAL")
        self._database.execute("PRAGMA synchronous=NORMAL")
        self._database.executescript(SQLITE_SCHEMA)

    def add_topic(self, topic: TopicMetadata, definition: str) -> None:
        """Add a row of topics, and one of message_definitions for its type."""
        if definition and topic.type not in self._types:
            self._types.add(topic.type)
            self._database.execute(
                "INSERT INTO message_definitions VALUES (?, ?, ?, ?, ?)",
                (len(self._types), topic.type, "ros2msg", definition, topic.type_description_hash),
            )
        number = self._topics[topic.name] = len(self._topics) + 1
        self._database.execute(
            "INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)",
            (
                number,
                topic.name,
                topic.type,
                topic.serialization_format,
                metadata.qos_text(topic.offered_qos_profiles),
                topic.type_description_hash,
            ),
        )

    def write(self, topic: str, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        """Buffer a row of messages, and one of our source times and numbers."""
        self._count += 1
        self._messages.append((self._count, self._topics[topic], log_time, data))
        self._times.append((self._count, publish_time, sequence))
        self.pending += OVERHEAD + len(data)

    def size(self) -> int:
        """Size of the database [bytes] once its log is merged."""
        return self._size + self.pending

    def flush(self) -> None:
        """Write what is buffered in one transaction."""
        with self._database:
            self._database.execute("BEGIN")
            self._database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", self._messages)
            self._database.executemany("INSERT INTO valve_control_times VALUES (?, ?, ?)", self._times)
        self._messages.clear()
        self._times.clear()
        self.pending = 0
        ((pages, page_size),) = self._database.execute(
            "SELECT page_count, page_size FROM pragma_page_count(), pragma_page_size()"
        )
        self._size = pages * page_size

    def finish(self, text: str) -> None:
        """Store the metadata, and leave a single file without a log."""
        self._database.execute(
            "INSERT INTO metadata(metadata_version, metadata) VALUES (?, ?)", (metadata.VERSION, text)
        )
        self._single_file()

    def abandon(self) -> None:
        """Close the database; what is committed stays."""
        self._single_file()

    def _single_file(self) -> None:
        try:
            self._database.execute("PRAGMA journal_mode=DELETE")
        except sqlite3.OperationalError:
            # Somebody reads the file: all goes into it, and the log stays until that one closes it.
            self._database.execute("PRAGMA wal_checkpoint(PASSIVE)")
        finally:
            self._database.close()


STORAGES: dict[str, Callable[[Path, str], Storage]] = {"mcap": McapStorage, "sqlite3": SqliteStorage}
SUFFIXES = {"mcap": McapStorage.SUFFIX, "sqlite3": SqliteStorage.SUFFIX}


class Tally:
    """What is in the file that is being written."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.start = 0  # ns
        self.end = 0  # ns

    def copy(self) -> "Tally":
        """A copy as of now."""
        other = Tally()
        other.counts, other.start, other.end = self.counts.copy(), self.start, self.end
        return other

    def file(self, path: Path) -> File:
        """Entry of the file in metadata.yaml."""
        return File(path.name, self.start, self.end - self.start, self.counts.total())


class BagWriter:
    """Writes a new bag into ``folder``. Each method raises BagError, after which the bag is closed.

    A file is followed by the next once it has ``max_bytes`` or spans ``max_seconds`` (0: never); then
    ``on_new_file`` is called, before anything is in the new one. Each file is readable by itself.
    """

    _storage: Storage

    def __init__(
        self,
        folder: Path,
        storage: str = "mcap",
        max_bytes: int = 0,
        max_seconds: float = 0.0,
        compression: str = "none",
        on_new_file: Callable[[], None] = lambda: None,
    ) -> None:
        check(storage, compression)
        self.folder = folder
        self._storage_name = storage
        self._compression = compression
        self._max_bytes = max_bytes
        self._max_span = round(max_seconds * 1e9)
        self._on_new_file = on_new_file
        self._topics: dict[str, tuple[TopicMetadata, str]] = {}
        self._totals: Counter[str] = Counter()  # of the finished files
        self._files: list[File] = []
        self._finished_bytes = 0
        self._closed = True
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            raise BagError(f"{folder} exists already; a bag needs a new folder") from None
        except OSError as error:
            raise BagError(f"{folder} cannot be made: {reason(error)}") from error
        self._lock = Lock(folder)
        self._rotating = False
        self._open_file()
        self._closed = False

    @property
    def path(self) -> Path:
        """File that is being written."""
        return self._storage.path

    @property
    def message_count(self) -> int:
        """Number of messages so far, flushed or not."""
        return self._totals.total() + self._tally.counts.total()

    @property
    def counts(self) -> Counter[str]:
        """Number of messages so far by topic."""
        return self._totals + self._tally.counts

    @property
    def total_bytes(self) -> int:
        """Size of all files [bytes], what is not flushed included."""
        return self._finished_bytes + (0 if self._closed else self._storage.size())

    @property
    def files(self) -> int:
        """Number of files so far."""
        return len(self._files) + (0 if self._closed else 1)

    def add_topic(
        self, name: str, type_name: str, definition: str = "", type_hash: str = "", qos: Sequence[Qos] = ()
    ) -> None:
        """Add a topic; ``definition``: of its type in the form ros2msg, with the types that it needs."""
        self._check_open()
        if name in self._topics:
            raise BagError(f"{name} is in the bag {self.folder} already; a topic is added once")
        topic = TopicMetadata(name, type_name, "cdr", tuple(qos), type_hash)
        self._topics[name] = (topic, definition)
        try:
            self._storage.add_topic(topic, definition)
        except (OSError, sqlite3.Error) as error:
            self._fail(error)

    def write(self, topic: str, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        """Write a serialized message of ``topic``; ``log_time``: received, ``publish_time``: sent [ns]."""
        self._check_open()
        tally = self._tally
        if self._is_full(log_time) and not self._rotating:
            self._rotate()
            tally = self._tally
        self._storage.write(topic, log_time, publish_time, sequence, data)
        if not tally.end:
            tally.start = tally.end = log_time
        elif log_time > tally.end:
            tally.end = log_time
        elif log_time < tally.start:
            tally.start = log_time
        tally.counts[topic] += 1
        if self._storage.pending >= PENDING:
            self.flush()

    def flush(self) -> None:
        """Flush, after which everything so far survives a SIGKILL of this process."""
        self._check_open()
        if self._storage.pending == 0:
            return
        try:
            self._storage.flush()
        except (OSError, sqlite3.Error) as error:
            self._fail(error)
        self._kept = self._tally.copy()

    def missing(self) -> list[str]:
        """Names of finished files that are no longer in the folder.

        Raises BagError, after which the bag is closed, if the file that is being written is not there.
        """
        self._check_open()
        if _identity(self.path) != self._place:
            self._closed = True
            messages = self._tally.counts.total()
            with suppress(OSError, sqlite3.Error, BagError):
                self._storage.flush()
            with suppress(OSError, sqlite3.Error, BagError):
                self._storage.abandon()
            self._lock.release()
            raise BagError(
                f"{self.path} was removed, moved or replaced while it was written, with {messages} messages "
                "in it; nothing more is recorded (valve-control bag recover ends a file that was moved)"
            )
        return [file.path for file in self._files if not (self.folder / file.path).exists()]

    def close(self) -> None:
        """Finish the bag and write its metadata.yaml; nothing if it is closed already."""
        if self._closed:
            return
        self._finish_file()
        self._closed = True
        try:
            self._write_metadata()
        except OSError as error:
            raise BagError(
                f"{self.folder / metadata.NAME} cannot be written: {reason(error)}; "
                "the bag's other files are whole (valve-control bag recover writes it)"
            ) from error
        finally:
            self._lock.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # Files

    def _check_open(self) -> None:
        if self._closed:
            raise BagError(f"the bag {self.folder} is closed; nothing more can be written")

    def _is_full(self, log_time: int) -> bool:
        tally = self._tally
        if not tally.end:
            return False
        if self._max_span and log_time - tally.start >= self._max_span:
            return True
        return bool(self._max_bytes) and self._storage.size() >= self._max_bytes

    def _open_file(self) -> None:
        suffix = SUFFIXES[self._storage_name]
        path = self.folder / f"{self.folder.name}_{len(self._files)}{suffix}"
        self._tally, self._kept = Tally(), Tally()
        try:
            self._storage = STORAGES[self._storage_name](path, self._compression)
            for topic, definition in self._topics.values():
                self._storage.add_topic(topic, definition)
        except (OSError, sqlite3.Error) as error:
            for part in (path, path.with_name(f"{path.name}-wal"), path.with_name(f"{path.name}-shm")):
                with suppress(OSError):
                    part.unlink()
            self._closed = True
            with suppress(OSError):
                self._write_metadata()
            self._lock.release()
            raise BagError(f"{path} cannot be begun: {reason(error)}") from error

        self._place = _identity(path)

    def _finish_file(self) -> None:
        self.flush()
        file = self._tally.file(self.path)
        topics = [Counted(topic, self._tally.counts[name]) for name, (topic, _) in self._topics.items()]
        try:
            self._storage.finish(metadata.as_text(metadata.of_files(self._storage_name, topics, [file])))
        except (OSError, sqlite3.Error) as error:
            self._fail(error)
        self._finished_bytes += self._storage.size()
        self._book(self._tally)

    def _book(self, tally: Tally) -> None:
        self._files.append(tally.file(self.path))
        self._totals += tally.counts
        self._tally, self._kept = Tally(), Tally()

    def _rotate(self) -> None:
        self._finish_file()
        self._open_file()
        # What opens a file belongs to it, however large it is.
        self._rotating = True
        try:
            self._on_new_file()
        finally:
            self._rotating = False

    def _write_metadata(self) -> None:
        topics = [Counted(topic, self._totals[name]) for name, (topic, _) in self._topics.items()]
        metadata.write(self.folder, metadata.of_files(self._storage_name, topics, self._files))

    def _fail(self, error: Exception) -> NoReturn:
        """Handle an error of writing: go back to the last flush, and finish the file if there is room."""
        self._closed = True
        path = self.path
        end = "the bag is closed and whole"
        self._book(self._kept)
        try:
            self._storage.abandon()
            self._write_metadata()
        except (OSError, sqlite3.Error, BagError):
            end = "the bag has no end (valve-control bag recover gives it one where there is room)"
        self._lock.release()
        messages = self._totals.total()
        raise BagError(
            f"{path} cannot be written any further: {reason(error)}; {end}, with {messages} messages"
        ) from error


def _identity(path: Path) -> tuple[int, int] | None:
    """What distinguishes a file from another one of the same name, None if there is none."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino


def check(storage: str, compression: str) -> None:
    """Raise BagError unless there is such a storage with such a compression."""
    if storage not in STORAGES:
        raise BagError(f"storage is '{storage}'; it must be mcap or sqlite3")
    if compression not in COMPRESSION:
        raise BagError(f"compression is '{compression}'; it must be none, zstd or lz4")
    if storage == "sqlite3" and compression != "none":
        raise BagError(f"compression is '{compression}'; storage sqlite3 has none, storage mcap has")
