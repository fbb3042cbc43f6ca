# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Writes a new MCAP file from what can still be read in a damaged one."""

import json
from io import FileIO
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Header, Metadata, MetadataIndex

from valve_control.arrays import Bytes, Integers
from valve_control.recordings.bags.mcap import DOUBTFUL, MAGIC, MESSAGE_HEAD, doubtful
from valve_control.recordings.bags.repair import Contents, chunk_head, end_file, put, written
from valve_control.recordings.bags.salvage import Piece, Salvage

CHUNK = 1 << 22  # bytes of loose messages that make a chunk


class Rewritten(NamedTuple):
    """What a new file contains."""

    messages: int
    doubtful: int  # of them, out of chunks whose checksum is wrong


def rewrite(salvage: Salvage, path: Path) -> Rewritten:
    """Write the new file ``path`` of all messages that ``salvage`` finds. Raises OSError.

    Sound chunks are copied as they are. Where the messages are whose values may be wrong is written into a
    metadata record.
    """
    with path.open("xb", buffering=0) as output:
        return _Rewriting(salvage, output).run()


class _Rewriting:
    def __init__(self, salvage: Salvage, output: FileIO) -> None:
        self._salvage = salvage
        self._output = output
        self._contents = Contents()
        self._doubtful: list[tuple[int, int, int]] = []  # messages, first and last log time [ns]

    def run(self) -> Rewritten:
        contents = self._contents
        contents.schemas, contents.channels = dict(self._salvage.schemas), dict(self._salvage.channels)
        self._begin()
        for piece in self._salvage.pieces():
            if piece.opcode == Opcode.CHUNK and piece.sound and piece.messages is not None:
                self._indexed(self._salvage.raw(piece.begin, piece.end), piece.messages)
            elif piece.messages is not None and piece.content is not None:
                self._unsure(piece)
                self._messages(piece.content, piece.messages)
            elif piece.opcode == Opcode.ATTACHMENT:
                self._attachment(piece)
            elif piece.opcode == Opcode.METADATA and piece.record.name != DOUBTFUL:
                self._metadata(self._salvage.raw(piece.begin, piece.end), piece.record.name)
            elif piece.opcode == Opcode.METADATA:
                self._doubtful += doubtful(piece.record)
        if self._doubtful:
            Metadata(DOUBTFUL, {"messages": json.dumps(self._doubtful)}).write(builder := RecordBuilder())
            self._metadata(written(builder), DOUBTFUL)
        contents.chunk = None
        end_file(self._output, contents)
        return Rewritten(contents.counts.total(), sum(count for count, _, _ in self._doubtful))

    def _put(self, data: bytes) -> None:
        put(self._output, data)
        self._contents.end += len(data)

    def _begin(self) -> None:
        headers = (piece.record for piece in self._salvage.pieces() if piece.opcode == Opcode.HEADER)
        header: Header = next(headers, None) or Header("ros2", "valve_control")
        builder = RecordBuilder()
        builder.write(MAGIC)
        header.write(builder)
        for record in (*self._contents.schemas.values(), *self._contents.channels.values()):
            record.write(builder)
        self._put(written(builder))

    def _unsure(self, piece: Piece) -> None:
        rows = piece.messages
        if piece.doubtful and rows is not None and len(rows):
            self._doubtful.append((len(rows), int(rows[:, 1].min()), int(rows[:, 1].max())))

    def _messages(self, content: Bytes, rows: Integers) -> None:
        """Write chunks of the messages ``rows`` of ``content``."""
        sizes = rows[:, 5] + MESSAGE_HEAD
        ends = np.cumsum(sizes)
        begin = 0
        while begin < len(rows):
            before = int(ends[begin] - sizes[begin])
            end = max(begin + 1, int(np.searchsorted(ends, before + CHUNK, side="right")))
            part = rows[begin:end].copy()
            places = zip(
                (part[:, 4] - MESSAGE_HEAD).tolist(), (part[:, 4] + part[:, 5]).tolist(), strict=True
            )
            data = b"".join(content[start:stop].tobytes() for start, stop in places)
            part[:, 4] = np.cumsum(part[:, 5] + MESSAGE_HEAD) - part[:, 5]
            self._indexed(chunk_head(data, part) + data, part)
            begin = end

    def _indexed(self, chunk: bytes, rows: Integers) -> None:
        """Write a chunk and its message indexes."""
        entry = self._contents.add_chunk(chunk, self._contents.end, len(chunk), rows)
        self._put(chunk)
        self._put(self._contents.message_indexes(entry))

    def _attachment(self, piece: Piece) -> None:
        self._contents.attach(piece.record, self._contents.end, piece.end - piece.begin)
        self._put(self._salvage.raw(piece.begin, piece.end))

    def _metadata(self, data: bytes, name: str) -> None:
        self._contents.metadata.append(MetadataIndex(self._contents.end, len(data), name))
        self._put(data)
