# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Writes rosbag2 bags (Jazzy); what was flushed survives a kill of the process."""

import sqlite3
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import NoReturn, Self

from rosbags.interfaces import Qos

from valve_control.recordings.bags import metadata
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.metadata import Counted, File, TopicMetadata
from valve_control.recordings.bags.storage import PENDING, Definition, SqliteStorage, Storage

COMPRESSIONS = ("none", "zstd", "lz4")
SUFFIXES = {"mcap": ".mcap", "sqlite3": ".db3"}


def reason(error: Exception) -> str:
    """Message of the operating system or of SQLite."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def usual() -> str:
    """Storage of a new bag: mcap, or sqlite3 where the package mcap is not installed."""
    return "mcap" if find_spec("mcap") else "sqlite3"


def _storage(name: str, path: Path, compression: str) -> Storage:
    if name == "sqlite3":
        return SqliteStorage(path)
    from valve_control.recordings.bags.mcap_storage import McapStorage

    return McapStorage(path, compression)


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
        self._topics: dict[str, tuple[TopicMetadata, Definition]] = {}
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
        self, name: str, type_name: str, definition: str = "", type_hash: str = "", qos: Sequence[Qos] = (),
        definition_format: str = "ros2msg",
    ) -> None:  # fmt: skip
        """Add a topic; ``definition``: of its type in this format, with the types that it needs."""
        self._check_open()
        if name in self._topics:
            raise BagError(f"{name} is in the bag {self.folder} already; a topic is added once")
        topic = TopicMetadata(name, type_name, "cdr", tuple(qos), type_hash)
        self._topics[name] = (topic, Definition(definition_format if definition else "", definition))
        try:
            self._storage.add_topic(*self._topics[name])
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
        if not tally.counts:
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
            raise BagError(
                f"{self.path} was removed, moved or replaced while it was written, with {messages} messages "
                "in it; nothing more is recorded (bag recover writes a finished copy of a moved file)"
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
                "the bag's other files are whole (valve-control bag recover writes a copy with one)"
            ) from error

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
        if not tally.counts:
            return False
        if self._max_span and log_time - tally.start >= self._max_span:
            return True
        return bool(self._max_bytes) and self._storage.size() >= self._max_bytes

    def _open_file(self) -> None:
        suffix = SUFFIXES[self._storage_name]
        path = self.folder / f"{self.folder.name}_{len(self._files)}{suffix}"
        self._tally, self._kept = Tally(), Tally()
        try:
            self._storage = _storage(self._storage_name, path, self._compression)
            for topic, definition in self._topics.values():
                self._storage.add_topic(topic, definition)
        except (OSError, sqlite3.Error) as error:
            endings = () if isinstance(error, FileExistsError) else ("", "-wal", "-shm")  # it is not ours
            for ending in endings:
                with suppress(OSError):
                    path.with_name(path.name + ending).unlink()
            self._closed = True
            with suppress(OSError):
                self._write_metadata()
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
            end = "the bag has no end (valve-control bag recover writes a finished copy)"
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
    if storage not in SUFFIXES:
        raise BagError(f"storage is '{storage}'; it must be mcap or sqlite3")
    if storage == "mcap" and usual() != "mcap":
        raise BagError("storage mcap needs the Python package mcap (pip install mcap); sqlite3 needs none")
    if compression not in COMPRESSIONS:
        raise BagError(f"compression is '{compression}'; it must be none, zstd or lz4")
    if storage == "sqlite3" and compression != "none":
        raise BagError(f"compression is '{compression}'; storage sqlite3 has none, storage mcap has")
