# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Writes the file of a new bag: SQLite."""

import sqlite3
from pathlib import Path

from valve_control.recordings.bags import metadata
from valve_control.recordings.bags.messages import Topic

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


class SqliteWriter:
    """An SQLite database with rosbag2's schema 4, and a table of ours for source times and numbers.

    ``write`` and ``size`` apart, all methods raise OSError or sqlite3.Error.
    """

    def __init__(self, path: Path) -> None:
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

    def add_topic(self, topic: Topic) -> None:
        """Add a row of topics, and one of message_definitions for its type."""
        if topic.definition and topic.type not in self._types:
            self._types.add(topic.type)
            self._database.execute(
                "INSERT INTO message_definitions VALUES (?, ?, ?, ?, ?)",
                (len(self._types), topic.type, topic.definition_format, topic.definition, topic.type_hash),
            )
        number = self._topics[topic.name] = len(self._topics) + 1
        self._database.execute(
            "INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)",
            (number, topic.name, topic.type, topic.encoding, topic.qos, topic.type_hash),
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
