# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads SQLite files of rosbag2 (.db3) into arrays, many messages at a time."""

import sqlite3
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.messages import Block, Topic, absolute, full_type

MAGIC = b"SQLite format 3\0"
LOGGED = b"\2\2"  # two bytes behind magic and page size: changes go into a write-ahead log
ROWS = 5000  # of a block
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
        self.damaged: set[int] = set()  # 0 once a damaged place was met
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
        # Whoever writes to a database with a log has one: without, nobody does, and none is made.
        access = "mode=ro&immutable=1" if mode == LOGGED and not log.exists() else "mode=ro"
        try:
            self._db = sqlite3.connect(f"{real.as_uri()}?{access}", uri=True)
        except sqlite3.Error as error:
            raise BagError(f"{path} cannot be opened: {error}") from error
        self._db.text_factory = lambda data: data.decode(errors="replace")
        try:
            self._learn()
        except BagError:
            self._db.close()
            raise
        except DAMAGE as error:
            self._db.close()
            raise BagError(f"{path} is not a bag that can be read: {error} ({SALVAGE})") from error

    def _learn(self) -> None:
        self._tables = {n for (n,) in self._db.execute("SELECT name FROM sqlite_master WHERE type='table'")}
        for table in ("topics", "messages"):
            if table not in self._tables:
                raise BagError(f"{self.path} is not a bag: it has no table '{table}'")
        definitions: dict[str, tuple[str, str]] = {}
        if "message_definitions" in self._tables:
            columns = "topic_type, encoding, encoded_message_definition"
            found = self._db.execute(f"SELECT {columns} FROM message_definitions")
            definitions = {name: (encoding, text) for name, encoding, text in found}
        cursor = self._db.execute("SELECT * FROM topics")
        names = [entry[0] for entry in cursor.description]
        entries = [dict(zip(names, row, strict=True)) for row in cursor]
        self._index = {entry["id"]: i for i, entry in enumerate(entries)}
        self.topics = [
            Topic(
                absolute(entry["name"]),
                full_type(entry["type"]),
                entry.get("serialization_format", "cdr"),
                *definitions.get(entry["type"], ("", "")),
                entry.get("type_description_hash", ""),
                entry.get("offered_qos_profiles", ""),
            )
            for entry in entries
        ]

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
            while rows := cursor.fetchmany(ROWS):
                *numbers, data = zip(*rows, strict=True)
                number, stamp, publish, sequence = np.array(numbers, dtype=np.int64)
                topic = -1 + sum((number == known) * (i + 1) for known, i in self._index.items())
                length = np.fromiter(map(len, data), dtype=np.int64, count=len(data))
                block = Block(
                    np.frombuffer(b"".join(data), dtype=np.uint8),
                    topic,
                    stamp,
                    np.where(publish == 0, stamp, publish),
                    sequence,
                    np.arange(len(data)),
                    np.cumsum(length) - length,
                    length,
                )
                yield block.select(topic >= 0)
        except DAMAGE as error:
            self.damaged.add(0)
            self.problems.append(f"{self.path} is damaged, what follows is left out: {error} ({SALVAGE})")
