# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Writes a new MCAP file from what can still be read in a damaged one."""

import json
import struct
import zlib
from collections import Counter
from io import FileIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import ChunkIndex, Header, Metadata, MetadataIndex

from valve_control.recordings.bags.mcap import DOUBTFUL, MAGIC, doubtful
from valve_control.recordings.bags.messages import Bytes, Integers
from valve_control.recordings.bags.repair import Contents, end_file, written
from valve_control.recordings.bags.salvage import FRAME, MESSAGE_HEAD, Piece, Salvage

CHUNK = 1 << 22  # bytes of loose messages that make a chunk
INDEX_HEAD = struct.Struct("<BQHI")  # opcode, length, channel, bytes of the entries


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
            if piece.opcode == Opcode.CHUNK:
                self._chunk(piece)
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
        rest = memoryview(data)
        while rest:
            rest = rest[self._output.write(rest) :]
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

    def _chunk(self, piece: Piece) -> None:
        rows, content = piece.messages, piece.content
        if rows is None or content is None:
            return
        if not piece.sound:
            self._unsure(piece)
            self._messages(content, rows)
            return
        data = self._salvage.raw(piece.begin, piece.end)
        first, last, size, _, name = struct.unpack_from("<QQQII", data, FRAME.size)
        at = FRAME.size + 32
        compression = data[at : at + name].decode()
        self._indexed(data, rows, (first, last), compression, len(data) - at - name - 8, size)

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
            first, last = int(part[:, 1].min()), int(part[:, 1].max())
            head = struct.pack("<QQQIIQ", first, last, len(data), zlib.crc32(data), 0, len(data))
            frame = FRAME.pack(Opcode.CHUNK, len(head) + len(data))
            self._indexed(frame + head + data, part, (first, last), "", len(data), len(data))
            begin = end

    def _indexed(
        self, data: bytes, rows: Integers, times: tuple[int, int], compression: str, packed: int, size: int
    ) -> None:
        """Write a chunk and its message indexes."""
        contents = self._contents
        start = contents.end
        self._put(data)
        offsets: dict[int, int] = {}
        begun = contents.end
        for channel in np.unique(rows[:, 0]).tolist():
            chosen = rows[rows[:, 0] == channel]
            entries = np.column_stack((chosen[:, 1], chosen[:, 4] - MESSAGE_HEAD)).astype("<u8").tobytes()
            offsets[channel] = contents.end
            self._put(
                INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + len(entries), channel, len(entries)) + entries
            )
        contents.chunks.append(
            ChunkIndex(
                chunk_length=len(data),
                chunk_start_offset=start,
                compression=compression,
                compressed_size=packed,
                message_end_time=times[1],
                message_index_length=contents.end - begun,
                message_index_offsets=offsets,
                message_start_time=times[0],
                uncompressed_size=size,
            )
        )
        if len(rows):
            contents.counts += Counter(dict(zip(*_counted(rows[:, 0]), strict=True)))
            first = int(rows[:, 1].min())
            known = contents.start_time
            contents.start_time = first if known is None else min(known, first)
            contents.end_time = max(contents.end_time, int(rows[:, 1].max()))

    def _attachment(self, piece: Piece) -> None:
        self._contents.attach(piece.record, self._contents.end, piece.end - piece.begin)
        self._put(self._salvage.raw(piece.begin, piece.end))

    def _metadata(self, data: bytes, name: str) -> None:
        self._contents.metadata.append(MetadataIndex(self._contents.end, len(data), name))
        self._put(data)


def _counted(channels: Any) -> tuple[list[int], list[int]]:
    numbers, counts = np.unique(channels, return_counts=True)
    return numbers.tolist(), counts.tolist()
