# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads MCAP files into arrays: one column for times, offsets and lengths of all messages.

The mcap library makes one Python object of each message, some 10 µs; a compiled walk over the records of a
chunk takes some 10 ns. Everything but messages (schemas, channels, chunks) is read with the library.
"""

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Schema
from mcap.stream_reader import get_chunk_data_stream

from valve_control.arrays import Bytes, Integers
from valve_control.control.compiling import compile_function
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.messages import Block, Topic, absolute, full_type

MAGIC = b"\x89MCAP0\r\n"
WINDOW = 100_000  # records
COMPRESSIONS = ("", "lz4", "zstd")
HEAD = np.dtype([("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")])  # of a message
# Raised for a damaged record; OverflowError: its size has more than 63 bits.
DAMAGE = (
    McapError, zstandard.ZstdError, struct.error, RuntimeError, ValueError, EOFError, MemoryError,
    OverflowError,
)  # fmt: skip


def _walk(buffer: Any, start: int, records: Any) -> Any:
    """Walk over the records from ``start``; returns where it stopped and how many it found.

    ``records`` (n×3) takes opcode, offset and length. It stops at a torn record, and where that is full.
    """
    at, count = start, 0
    while at + 9 <= buffer.shape[0] and count < records.shape[0]:
        length = 0
        for i in range(8):
            length |= int(buffer[at + 1 + i]) << (8 * i)
        if length < 0 or length > buffer.shape[0] - at - 9:
            break
        records[count, 0], records[count, 1], records[count, 2] = int(buffer[at]), at + 9, length
        count += 1
        at += 9 + length
        if buffer[at - 9 - length] == 2:
            break
    return at, count


def _windows(buffer: Bytes, start: int) -> Iterator[tuple[Integers, Integers, int]]:
    """Yield messages, other records (see ``_walk``) and their end, from ``start`` up to a torn record."""
    at, count = start, 1
    while count:
        records = np.empty((WINDOW, 3), dtype=np.int64)
        at, count = compile_function(_walk)(buffer, at, records)
        messages = (records[:count, 0] == Opcode.MESSAGE) & (records[:count, 2] >= HEAD.itemsize)
        yield records[:count][messages], records[:count][~messages], int(at)


class McapFile:
    """One MCAP file, finished or not.

    Raises BagError if it is not an MCAP file, OSError if it cannot be read. ``problems`` says what is wrong
    with a file that can be read in part.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.problems: list[str] = []
        self.topics: list[Topic] = []
        self._schemas: dict[int, Schema] = {}
        self._topic_of = np.full(65536, -1, dtype=np.int64)  # by channel
        self.size = path.stat().st_size
        if self.size == 0:
            raise BagError(f"{path} is empty")
        self._buffer: Bytes = np.asarray(np.memmap(path, dtype=np.uint8, mode="r"))
        if bytes(self._buffer[: len(MAGIC)]) != MAGIC:
            raise BagError(f"{path} is not an MCAP file: it does not begin with MCAP's magic bytes")
        self._chunks: list[tuple[int, int]] = []  # beginnings and lengths of their records
        self.damaged: set[int] = set()  # beginnings of the chunks that are left out, of those read so far
        self._index()

    def close(self) -> None:
        """Release the file."""
        self._buffer = np.empty(0, dtype=np.uint8)

    def blocks(self) -> Iterator[Block]:
        """Yield all messages, first those outside of chunks."""
        yield from self._blocks(self._buffer, len(MAGIC))
        for place in self._chunks:
            yield from self._blocks(self._content(*place), 0)

    def _blocks(self, buffer: Bytes, start: int) -> Iterator[Block]:
        for messages in (found for found, _, _ in _windows(buffer, start) if len(found)):
            _, offset, length = np.ascontiguousarray(messages.T)
            head = np.lib.stride_tricks.sliding_window_view(buffer, HEAD.itemsize)[offset].view(HEAD)[:, 0]
            log, publish, sequence = (head[name].astype(np.int64) for name in ("log", "publish", "sequence"))
            topic, publish = self._topic_of[head["channel"]], np.where(publish == 0, log, publish)
            place, at = np.arange(len(topic)), offset + HEAD.itemsize
            block = Block(buffer, topic, log, publish, sequence, place, at, length - HEAD.itemsize)
            yield block.select(topic >= 0)

    def _index(self) -> None:
        """Find chunks, schemas and channels; a finished file repeats the last two in its summary."""
        finished, rest = False, self.size
        for _, others, end in _windows(self._buffer, len(MAGIC)):
            rest = self.size - end
            self._learn(self._buffer, others)
            self._chunks += [(at, length) for opcode, at, length in others.tolist() if opcode == Opcode.CHUNK]
            finished = finished or Opcode.FOOTER in others[:, 0]
        if not finished:
            self._complain(
                f"{self.path} is unfinished or damaged: its last {rest} bytes are no whole record "
                "(valve-control bag recover writes a finished copy)"
            )
        if not finished or not self.topics:
            for place in self._chunks:
                content = self._content(*place)
                for _, others, _ in _windows(content, 0):
                    self._learn(content, others)

    def _learn(self, buffer: Bytes, others: Integers) -> None:
        """Take in the schemas and channels among ``others``."""
        for opcode, begin, length in others[np.isin(others[:, 0], (Opcode.SCHEMA, Opcode.CHANNEL))].tolist():
            stream = ReadDataStream(BytesIO(buffer[begin : begin + length].tobytes()))
            try:
                if opcode == Opcode.SCHEMA:
                    schema = Schema.read(stream)
                    self._schemas[schema.id] = schema
                else:
                    channel = Channel.read(stream)
                    if self._topic_of[channel.id] < 0:
                        self._topic_of[channel.id] = self._topic(channel)
            except DAMAGE as error:
                self._complain(f"{self.path}: a schema or channel is damaged: {type(error).__name__}")

    def _topic(self, channel: Channel) -> int:
        schema = self._schemas.get(channel.schema_id)
        topic = Topic(
            absolute(channel.topic),
            full_type(schema.name) if schema else "",
            channel.message_encoding,
            schema.encoding if schema else "",
            schema.data.decode(errors="replace") if schema else "",
            channel.metadata.get("topic_type_hash", ""),
            channel.metadata.get("offered_qos_profiles", ""),
        )
        known = [(one.name, one.type, one.encoding) for one in self.topics]
        if topic[:3] in known:
            return known.index(topic[:3])
        self.topics.append(topic)
        return len(known)

    def _content(self, begin: int, length: int) -> Bytes:
        """Uncompressed records of a chunk; none, and a note in ``problems``, if it is damaged."""
        try:
            chunk = Chunk.read(ReadDataStream(BytesIO(self._buffer[begin : begin + length].tobytes())))
            if chunk.compression not in COMPRESSIONS:  # the library takes any other for none
                raise ValueError(f"compression {chunk.compression!r} is not known")
            stream, size = get_chunk_data_stream(chunk, validate_crc=True)
        except DAMAGE as error:
            reason = (str(error) or type(error).__name__).splitlines()[0]
            self.damaged.add(begin)
            self._complain(f"{self.path}: the chunk at byte {begin} is damaged and left out: {reason}")
            return np.empty(0, dtype=np.uint8)
        return np.frombuffer(stream.read(size), dtype=np.uint8)

    def _complain(self, text: str) -> None:
        if text not in self.problems:
            self.problems.append(text)
