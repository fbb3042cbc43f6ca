# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Writes rosbag2 bags (Jazzy); what was flushed survives a kill of the process."""

import os
import sqlite3
from collections import Counter
from collections.abc import Sequence
from contextlib import AbstractContextManager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import dump_qos_v9

from valve_control.recordings.bags import metadata
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.messages import CDR, Topic
from valve_control.recordings.bags.sqlite_writer import PENDING, SqliteWriter

if TYPE_CHECKING:
    from valve_control.recordings.bags.mcap_writer import McapWriter

SUFFIXES = {"mcap": ".mcap", "sqlite3": ".db3"}


def reason(error: Exception) -> str:
    """Message of the operating system or of SQLite."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def usual() -> str:
    """Storage of a new bag: mcap, or sqlite3 where the package mcap is not installed."""
    return "mcap" if find_spec("mcap") else "sqlite3"


def _storage(name: str, path: Path, compression: str) -> "SqliteWriter | McapWriter":
    if name == "sqlite3":
        return SqliteWriter(path)
    from valve_control.recordings.bags.mcap_writer import McapWriter

    return McapWriter(path, compression)


class BagWriter(AbstractContextManager["BagWriter"]):
    """Writes a new bag into ``folder``. Each method raises BagError, after which the bag is closed."""

    def __init__(self, folder: Path, storage: str = "mcap", compression: str = "none") -> None:
        check(storage, compression)
        self.folder = folder
        self._storage_name = storage
        self._topics: dict[str, Topic] = {}
        self.counts: Counter[str] = Counter()  # messages so far by topic, flushed or not
        self._begin, self._end = 2**63 - 1, 0  # ns
        self._flushed = Counter[str]()  # counts of what was flushed
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            raise BagError(f"{folder} exists already; a bag needs a new folder") from None
        except OSError as error:
            raise BagError(f"{folder} cannot be made: {reason(error)}") from error
        self.path = folder / f"{folder.name}_0{SUFFIXES[storage]}"
        self._closed = False
        try:
            self._storage = _storage(storage, self.path, compression)
        except (OSError, sqlite3.Error) as error:
            raise BagError(f"{self.path} cannot be begun: {reason(error)}") from error
        self._file = self.path.stat()

    @property
    def message_count(self) -> int:
        """Number of messages so far, flushed or not."""
        return self.counts.total()

    @property
    def total_bytes(self) -> int:
        """Size of the file [bytes], what is not flushed included."""
        return self._storage.size()

    def add_topic(
        self, name: str, type_name: str, definition: str = "", type_hash: str = "", qos: Sequence[Qos] = (),
        definition_format: str = "ros2msg",
    ) -> None:  # fmt: skip
        """Add a topic; ``definition``: of its type in this format, with the types that it needs."""
        self._check_open()
        if name in self._topics:
            raise BagError(f"{name} is in the bag {self.folder} already; a topic is added once")
        form = definition_format if definition else ""
        offered = metadata.as_text(dump_qos_v9(list(qos))) if qos else ""
        topic = Topic(name, type_name, CDR, form, definition, type_hash, offered)
        self._topics[name] = topic
        try:
            self._storage.add_topic(topic)
        except (OSError, sqlite3.Error) as error:
            self._fail(error)

    def write(self, topic: str, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        """Write a serialized message of ``topic``; ``log_time``: received, ``publish_time``: sent [ns]."""
        self._check_open()
        self._storage.write(topic, log_time, publish_time, sequence, data)
        self._begin, self._end = min(self._begin, log_time), max(self._end, log_time)
        self.counts[topic] += 1
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
        self._flushed = self.counts.copy()

    def check_place(self) -> None:
        """Raise BagError, after which the bag is closed, if the file that is being written is not there."""
        self._check_open()
        with suppress(OSError):
            if os.path.samestat(self.path.stat(), self._file):
                return
        with suppress(OSError, sqlite3.Error):
            self._storage.flush()
            self._flushed = self.counts
        self._end_with(
            f"{self.path} was removed, moved or replaced while it was written; nothing more is recorded"
        )

    def close(self) -> None:
        """Finish the bag and write its metadata.yaml; nothing if it is closed already."""
        if self._closed:
            return
        self.flush()
        tree = self._metadata()
        try:
            self._storage.finish(metadata.as_text(tree))
        except (OSError, sqlite3.Error) as error:
            self._fail(error)
        self._closed = True
        try:
            metadata.write(self.folder, tree)
        except OSError as error:
            raise BagError(
                f"{self.folder / metadata.NAME} cannot be written: {reason(error)}; "
                "the bag's file is whole (valve-control bag recover writes a copy with one)"
            ) from error

    def __exit__(self, *raised: object) -> None:
        self.close()

    def _check_open(self) -> None:
        if self._closed:
            raise BagError(f"the bag {self.folder} is closed; nothing more can be written")

    def _metadata(self) -> dict[str, Any]:
        topics = [(topic, self.counts[name]) for name, topic in self._topics.items()]
        begin = min(self._begin, self._end)
        return metadata.of_file(self._storage_name, self.path.name, begin, self._end, topics)

    def _fail(self, error: Exception) -> NoReturn:
        """Handle an error of writing."""
        self._end_with(f"{self.path} cannot be written any further: {reason(error)}")

    def _end_with(self, text: str) -> NoReturn:
        """Close the bag, whose flushed messages stay, without an end, and raise BagError."""
        self._closed, self.counts = True, self._flushed
        with suppress(OSError, sqlite3.Error):
            self._storage.abandon()
        raise BagError(
            f"{text}; the bag has no end (valve-control bag recover writes a finished copy), with "
            f"{self.message_count} messages"
        )


def check(storage: str, compression: str) -> None:
    """Raise BagError unless the ``storage`` can be written with this ``compression``."""
    if storage == "mcap" and usual() != "mcap":
        raise BagError("storage mcap needs the Python package mcap (pip install mcap); sqlite3 needs none")
    if storage == "sqlite3" and compression != "none":
        raise BagError(f"compression is '{compression}'; storage sqlite3 has none, storage mcap has")
