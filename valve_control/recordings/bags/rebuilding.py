# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Writes a new SQLite bag from the rows that can still be read in a damaged one."""

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import NamedTuple

from valve_control.recordings.bags import metadata
from valve_control.recordings.bags.errors import BagError, NothingError
from valve_control.recordings.bags.messages import CDR
from valve_control.recordings.bags.metadata import Metadata
from valve_control.recordings.bags.pages import Pages, Row, Value
from valve_control.recordings.bags.storage import SQLITE_SCHEMA

LOST_TOPIC = "/unknown_topic_{}"
FEWEST = 2  # messages of a topic that nobody names, with less it is its number that is damaged
ENCODINGS = ("ros2msg", "ros2idl", "")  # of definitions; a topic has its type in the same column
ROWS = 10_000  # in a piece


class Rebuilt(NamedTuple):
    """What was found in the damaged file."""

    messages: int
    highest: int  # number of a message
    nameless: int  # messages of topics whose names are lost


def rebuild(path: Path, out: Path, told: Metadata | None) -> Rebuilt:
    """Write the new database ``out`` with all rows of a bag that are in the pages of ``path`` and its log.

    Names of topics that are lost are taken from ``told``, the bag's metadata.yaml, if this package recorded
    the bag. Raises BagError if there is nothing of a bag, OSError, sqlite3.Error.
    """
    pages = Pages(path)
    with closing(sqlite3.connect(out, isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode=OFF")
        database.execute("PRAGMA synchronous=OFF")
        database.executescript(SQLITE_SCHEMA)
        topics, text = _fill(database, pages)
        ((count, highest),) = database.execute(
            "SELECT count(*), max(ifnull(max(id), 0), (SELECT ifnull(max(message_id), 0) FROM "
            "valve_control_times)) FROM messages"
        )
        if not count and not topics:
            raise NothingError(f"{path} is not a database of a bag: its pages hold no message and no topic")
        ((ours,),) = database.execute("SELECT count(*) FROM valve_control_times")
        if told is None and text:
            with suppress(BagError):
                told = metadata.parse(text, str(path))
        nameless = _name(database, topics, told if ours else None)
        database.execute("DELETE FROM messages WHERE topic_id NOT IN (SELECT id FROM topics)")
        database.execute("DELETE FROM valve_control_times WHERE message_id NOT IN (SELECT id FROM messages)")
        if not ours:
            database.execute("DROP TABLE valve_control_times")
        ((count,),) = database.execute("SELECT count(*) FROM messages")
    return Rebuilt(count, highest, nameless)


def _fill(database: sqlite3.Connection, pages: Pages) -> tuple[dict[int, Sequence[Value]], str]:
    """Write messages and times into ``database``; returns the topics, and the metadata found among them."""
    topics: dict[int, Sequence[Value]] = {}
    definitions: dict[int, Sequence[Value]] = {}
    text = ""
    messages: list[Row] = []
    times: list[Row] = []

    def put() -> None:
        database.execute("BEGIN")
        database.executemany("INSERT OR REPLACE INTO messages VALUES (?, ?, ?, ?)", messages)
        database.executemany("INSERT OR REPLACE INTO valve_control_times VALUES (?, ?, ?)", times)
        database.execute("COMMIT")
        messages.clear()
        times.clear()

    for number, columns in pages.rows():
        match columns:
            case (None, int(), int(), bytes()):
                messages.append((number, *columns[1:]))
            case (None, int(), int()):
                times.append((number, *columns[1:]))
            case (None, str(), str()):  # of the first releases of rosbag2
                topics[number] = (*columns[1:], CDR, "", "")
            case (None, str(), str() as encoding, str(), *rest) if _are_texts(rest):
                if encoding in ENCODINGS:
                    definitions[number] = (*columns[1:], "")[:4]
                else:
                    topics[number] = (*columns[1:], "", "")[:5]
            case (None, int(), str() as found) if metadata.ROOT in found:
                text = found
        if len(messages) + len(times) >= ROWS:
            put()
    put()
    for table, rows in (("topics", topics), ("message_definitions", definitions)):
        for number, row in rows.items():
            places = ", ".join("?" * (1 + len(row)))
            database.execute(f"INSERT INTO {table} VALUES ({places})", (number, *row))
    return topics, text


def _are_texts(values: Sequence[Value]) -> bool:
    return len(values) <= 2 and all(isinstance(value, str) for value in values)


def _name(database: sqlite3.Connection, topics: dict[int, Sequence[Value]], told: Metadata | None) -> int:
    """Name the topics that have messages but no row; returns the number of messages without a name."""
    counts = dict(database.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
    known = dict(_as_recorded(told)) if told is not None else {}
    if any(number in known and known[number][0] != row[0] for number, row in topics.items()):
        known = {}
    nameless = 0
    for number, count in counts.items():
        if number in topics or (number not in known and count < FEWEST):
            continue
        if number not in known:
            nameless += count
        named = known.get(number, (LOST_TOPIC.format(number), "", "cdr", "", ""))
        database.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)", (number, *named))
    return nameless


def _as_recorded(told: Metadata) -> Iterator[tuple[int, tuple[str, str, str, str, str]]]:
    """Topics with the row numbers that this package's recorder gives them."""
    for number, (topic, _) in enumerate(told.topics, 1):
        qos = metadata.qos_text(topic.offered_qos_profiles)
        yield number, (topic.name, topic.type, topic.serialization_format, qos, topic.type_description_hash)
