# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads tables of numbers, text or MATLAB files, as bags: each column is a topic of std_msgs/Float64."""

from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np

from valve_control.arrays import Integers
from valve_control.recordings.bags import columns, matlab
from valve_control.recordings.bags.errors import BagError, refuse_pointer
from valve_control.recordings.bags.messages import Block, Topic, absolute

FLOAT = "std_msgs/msg/Float64"
HEADER = np.array([0, 1, 0, 0], dtype=np.uint8)  # of a message: CDR, little endian
SIZE = len(HEADER) + 8  # bytes of a message
ROWS = 20_000  # of one block
TEXT = "csv"
MATLAB = "mat"
KINDS = {".csv": TEXT, ".txt": TEXT, ".tsv": TEXT, ".dat": TEXT, ".mat": MATLAB}


class TableFile:
    """One table, whose rows have no times until ``use_times``.

    Raises BagError if it is none, OSError if it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.problems: list[str] = []
        self.damaged: set[int] = set()
        refuse_pointer(path)
        self.size = path.stat().st_size
        matlab_file = KINDS[path.suffix.lower()] == MATLAB
        self.columns = matlab.read(path) if matlab_file else columns.read(path, self.problems)
        self.topics = [
            Topic(absolute(name), FLOAT, flaw=column.flaw)
            for name, column in zip(self._topic_names(), self.columns, strict=True)
        ]
        self.times: Integers = np.empty(0, dtype=np.int64)  # ns, of each row
        self.clock = ""  # what these times are of
        self.wanted: Collection[int] = range(len(self.topics))  # columns that are read

    def _topic_names(self) -> list[str]:
        """Names of the columns, for those that have none of their own their numbers."""
        names = [column.bare_name for column in self.columns]
        found = [
            name if name and names.count(name) == 1 else str(number)
            for number, name in enumerate(names, start=1)
        ]
        if len(set(map(absolute, found))) < len(found):  # the name of one is the number of another
            return [str(number) for number in range(1, 1 + len(found))]
        return found

    @property
    def listed(self) -> str:
        """Names of the columns, in words."""
        return ", ".join(topic.name.removeprefix("/") for topic in self.topics)

    def named(self, name: str) -> bool:
        """Whether a column has exactly this name, or several have."""
        return any(name in (column.name, column.bare_name) for column in self.columns)

    def column(self, name: str) -> int:
        """Index of the column with this name, or else this number from 1. Raises BagError."""
        found = [i for i, column in enumerate(self.columns) if name == column.name]
        found = found or [i for i, column in enumerate(self.columns) if name == column.bare_name]
        if len(found) > 1:
            numbers = " and ".join(str(i + 1) for i in found)
            raise BagError(f"{self.path} has {len(found)} columns {name}; take one by its number: {numbers}")
        if not found and name.isdigit() and 1 <= int(name) <= len(self.columns):
            found = [int(name) - 1]
        if not found:
            raise BagError(f"{self.path} has no column {name}; it has {self.listed}")
        return found[0]

    def use_times(self, times: Integers, clock: str) -> None:
        """Take ``times`` [ns] of the rows, each at least that of the row before; ``clock`` names them.

        Columns with another number of rows cannot be read from then on.
        """
        self.times = times
        self.clock = clock
        for i, column in enumerate(self.columns):
            if not column.flaw and len(column.values) != len(times):
                flaw = (
                    f"column {column.name or i + 1} has {len(column.values)} rows and the time {len(times)}; "
                    "they must agree"
                )
                self.columns[i] = column._replace(flaw=flaw)
                self.topics[i] = self.topics[i]._replace(flaw=flaw)

    def close(self) -> None:
        """Close the file, which has been read as a whole."""

    def blocks(self) -> Iterator[Block]:
        """Yield all rows, one message for each column; the messages of a row share their place."""
        usable = [i for i in self.wanted if not self.columns[i].flaw]
        for begin in range(0, len(self.times), ROWS):
            if usable:
                yield self._block(usable, begin, min(begin + ROWS, len(self.times)))

    def _block(self, usable: list[int], begin: int, end: int) -> Block:
        rows = slice(begin, end)
        filled = np.column_stack([self.columns[i].filled[rows] for i in usable])
        values = np.column_stack([self.columns[i].values[rows] for i in usable])[filled]
        buffer = np.empty((len(values), SIZE), dtype=np.uint8)
        buffer[:, : len(HEADER)] = HEADER
        buffer[:, len(HEADER) :] = values.astype("<f8").view(np.uint8).reshape(-1, 8)
        row, column = np.nonzero(filled)
        times = self.times[rows][row]
        length = np.full(len(values), SIZE, dtype=np.int64)
        return Block(
            buffer=buffer.ravel(),
            topic=np.array(usable, dtype=np.int64)[column],
            log_time=times,
            publish_time=times,
            sequence=np.zeros(len(values), dtype=np.int64),
            place=begin + row,
            offset=np.cumsum(length) - length,
            length=length,
        )
