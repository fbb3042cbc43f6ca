# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads SQLite files of rosbag2 (.db3) into arrays, many messages at a time."""

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Integers
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.messages import Block, Topic, absolute, full_type

MAGIC = b"SQLite format 3\0"
LOGGED = b"\2\2"  # two bytes behind magic and page size: changes go into a write-ahead log
ROWS = 500
PIECES = 100
DAMAGE = (sqlite3.Error, KeyError, TypeError, ValueError, OverflowError)
SALVAGE = "sqlite3's own recovery reads what is left of it: sqlite3 FILE .recover | sqlite3 NEW.db3"
TIMES = "valve_control_times"  # source times and sequence numbers, which rosbag2's own tables lack


class SqliteFile:
    """One .db3 file.

    Raises BagError if it is not one, OSError if it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.problems: list[str] = []
        self.topics: list[Topic] = []
        self.damaged = False
        with path.open("rb") as stream:
            head, mode = stream.read(len(MAGIC)), stream.read(len(LOGGED) + 2)[2:]
        self.size = path.stat().st_size
        if not head:
            raise BagError(f"{path} is empty")
        if head != MAGIC:
            raise BagError(f"{path} is not a sqlite3 file: it does not begin with sqlite's magic bytes")
        # A write-ahead log beside it is read too; SQLite follows links.
        real = path.resolve()
        log = real.with_name(real.name + "-wal")
        if log.exists() and log.stat().st_size > 0:
            self.problems.append(f"{path}: a part of it is in {log.name} beside it, the two belong together")
        try:
            # Whoever writes to a database with a log has one: without, nobody does.
            self._db = opened(path, immutable=mode == LOGGED and not log.exists())
        except sqlite3.Error as error:
            raise BagError(f"{path} cannot be opened: {error}") from error
        try:
            self._learn()
        except BagError:
            self._db.close()
            raise
        except DAMAGE as error:
            self._db.close()
            raise BagError(f"{path} is not a bag that can be read: {error} ({SALVAGE})") from error

    def _learn(self) -> None:
        self._tables = {
            name for (name,) in self._db.execute("SELECT name FROM sqlite_master WHERE type='table'")
        }
        for table in ("topics", "messages"):
            if table not in self._tables:
                raise BagError(f"{self.path} is not a bag: it has no table '{table}'")
        definitions: dict[str, tuple[str, str]] = {}
        if "message_definitions" in self._tables:
            for row in self._db.execute(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            ):
                name, encoding, text = row
                definitions[name] = (encoding, text)
        self._ids: dict[int, int] = {}
        cursor = self._db.execute("SELECT * FROM topics")
        columns = [entry[0] for entry in cursor.description]
        for row in cursor:
            entry = dict(zip(columns, row, strict=True))
            encoding, text = definitions.get(entry["type"], ("", ""))
            self._ids[entry["id"]] = len(self.topics)
            self.topics.append(
                Topic(
                    absolute(entry["name"]),
                    full_type(entry["type"]),
                    entry.get("serialization_format", "cdr"),
                    encoding,
                    text,
                    entry.get("type_description_hash", ""),
                    entry.get("offered_qos_profiles", ""),
                )
            )

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    def blocks(self) -> Iterator[Block]:
        """Yield all messages."""
        times = f"LEFT JOIN {TIMES} ON message_id = id" if TIMES in self._tables else ""
        columns = "ifnull(publish_time, 0), ifnull(sequence, 0)" if times else "0, 0"
        query = f"SELECT topic_id, timestamp, {columns}, data FROM messages {times} ORDER BY id"
        try:
            cursor = self._db.execute(query)
            while (block := self._block(cursor)) is not None:
                yield block if (block.topic >= 0).all() else block.select(block.topic >= 0)
        except DAMAGE as error:
            self.damaged = True
            self.problems.append(f"{self.path} is damaged, what follows is left out: {error} ({SALVAGE})")

    def _topics_of(self, numbers: Integers) -> Integers:
        """Topics of messages by the ``numbers`` of the database, -1 for one that has none."""
        known = np.array(sorted(self._ids), dtype=np.int64)
        if not len(known):
            return np.full(len(numbers), -1, dtype=np.int64)
        topics = np.array([self._ids[number] for number in known.tolist()], dtype=np.int64)
        at = np.minimum(np.searchsorted(known, numbers), len(known) - 1)
        return np.where(known[at] == numbers, topics[at], -1)

    def _block(self, cursor: sqlite3.Cursor) -> Block | None:
        """The next messages; fetched in pieces that fit in the processor's cache, which is twice as fast."""
        numbers: list[npt.NDArray[Any]] = []
        datas: list[bytes] = []
        lengths: list[npt.NDArray[Any]] = []
        for _ in range(PIECES):
            rows = cursor.fetchmany(ROWS)
            if not rows:
                break
            *columns, data = zip(*rows, strict=True)
            numbers.append(np.array(columns, dtype=np.int64))
            lengths.append(np.fromiter(map(len, data), dtype=np.int64, count=len(data)))
            datas.append(b"".join(data))
        if not numbers:
            return None
        topic, stamp, publish, sequence = np.concatenate(numbers, axis=1)
        length = np.concatenate(lengths)
        return Block(
            np.frombuffer(b"".join(datas), dtype=np.uint8),
            self._topics_of(topic),
            stamp,
            np.where(publish == 0, stamp, publish),
            sequence,
            np.arange(len(topic)),
            np.cumsum(length) - length,
            length,
        )


def opened(path: Path, immutable: bool) -> sqlite3.Connection:
    """Open a database read-only; ``immutable``: nobody writes, and SQLite makes no file beside it.

    A text that is damaged is read with replacement characters. Raises sqlite3.Error.
    """
    mode = "mode=ro&immutable=1" if immutable else "mode=ro"
    database = sqlite3.connect(f"{path.resolve().as_uri()}?{mode}", uri=True)
    database.text_factory = lambda data: data.decode(errors="replace")
    return database
