# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads MCAP files into arrays: one column for times, offsets and lengths of all messages.

The mcap library makes one Python object of each message, some 10 µs; a compiled walk over the records of a
chunk takes some 10 ns. Everything but messages (schemas, channels, chunk headers) is read with the library.
"""

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from valve_control.arrays import Bytes, Integers
from valve_control.control.compiling import compile_function
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.messages import Block, Topic, absolute, full_type

MAGIC = b"\x89MCAP0\r\n"
WINDOW = 100_000  # messages, records
CHUNK_HEAD = struct.Struct("<QQQII")  # times, uncompressed size, checksum, length of the compression's name
# Raised for a damaged chunk; OverflowError: its size has more than 63 bits.
DAMAGE = (zstandard.ZstdError, struct.error, RuntimeError, ValueError, EOFError, MemoryError, OverflowError)


def _little_endian(buffer: Any, at: int, size: int) -> int:
    value = 0
    for i in range(size):
        value |= int(buffer[at + i]) << (8 * i)
    return value


def _walk(buffer: Any, start: int, end: int, messages: Any, others: Any) -> Any:
    """Walk over the records from ``start``; returns where it stopped and how many of each kind it found.

    ``messages`` (n×6) takes channel, log time, publish time, sequence, offset and length of the data;
    ``others`` (m×3) opcode, offset and length. It stops at a torn record, or where either is full.
    """
    at, count, rest = start, 0, 0
    while at + 9 <= end and count < messages.shape[0] and rest < others.shape[0]:
        opcode = int(buffer[at])
        length = _little_endian(buffer, at + 1, 8)
        body = at + 9
        if length < 0 or length > end - body:
            break
        if opcode == 5:
            if length < 22:
                break
            messages[count, 0] = _little_endian(buffer, body, 2)
            messages[count, 1] = _little_endian(buffer, body + 6, 8)
            messages[count, 2] = _little_endian(buffer, body + 14, 8)
            messages[count, 3] = _little_endian(buffer, body + 2, 4)
            messages[count, 4] = body + 22
            messages[count, 5] = length - 22
            count += 1
        else:
            others[rest, 0] = opcode
            others[rest, 1] = body
            others[rest, 2] = length
            rest += 1
        at = body + length
        if opcode == 2:
            break
    return at, count, rest


def _windows(buffer: Bytes, start: int) -> Iterator[tuple[Integers, Integers, int]]:
    """Yield messages, other records (see ``_walk``) and their end, from ``start`` up to a torn record."""
    at, before = start, -1
    while at < len(buffer) and at > before:
        before = at
        messages = np.empty((WINDOW, 6), dtype=np.int64)
        others = np.empty((WINDOW, 3), dtype=np.int64)
        at, count, rest = compile_function(_walk)(buffer, at, len(buffer), messages, others)
        if count or rest:
            yield messages[:count], others[:rest], int(at)


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
        self._damaged: set[int] = set()  # places of the chunks that are left out
        self._loose = False  # whether messages stand outside of chunks
        self._index()

    @property
    def damaged_chunks(self) -> int:
        """Number of chunks that are left out, of those read so far."""
        return len(self._damaged)

    def close(self) -> None:
        """Release the file."""
        self._buffer = np.empty(0, dtype=np.uint8)

    def blocks(self) -> Iterator[Block]:
        """Yield all messages."""
        if self._loose:
            for messages, _, _ in _windows(self._buffer, len(MAGIC)):
                yield from self._block(self._buffer, messages)
        for place in self._chunks:
            content = self._content(*place)
            for messages, _, _ in _windows(content, 0):
                yield from self._block(content, messages)

    def _block(self, buffer: Bytes, messages: Integers) -> Iterator[Block]:
        if len(messages) == 0:
            return
        channel, log, publish, sequence, offset, length = np.ascontiguousarray(messages.T)
        topic = self._topic_of[channel]
        publish = np.where(publish == 0, log, publish)
        block = Block(buffer, topic, log, publish, sequence, np.arange(len(topic)), offset, length)
        yield block if (topic >= 0).all() else block.select(topic >= 0)

    def _index(self) -> None:
        """Find chunks, schemas and channels; a finished file repeats the last two in its summary."""
        finished = False
        end = len(MAGIC)
        for messages, others, reached in _windows(self._buffer, len(MAGIC)):
            end = reached
            self._loose = self._loose or len(messages) > 0
            self._learn(self._buffer, others)
            for opcode, begin, length in others.tolist():
                if opcode == Opcode.CHUNK and length >= CHUNK_HEAD.size:
                    self._chunks.append((begin, length))
                finished = opcode == Opcode.FOOTER
        if not finished:
            self._complain(
                f"{self.path} is unfinished or damaged: its last {self.size - end} bytes are no whole record "
                "(valve-control bag recover writes a finished copy)"
            )
        if not finished or not self.topics:
            for place in self._chunks:
                content = self._content(*place)
                for _, others, _ in _windows(content, 0):
                    self._learn(content, others)

    def _learn(self, buffer: Bytes, others: Integers) -> None:
        """Take in the schemas and channels among ``others``."""
        for opcode, begin, length in others.tolist():
            if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL):
                continue
            stream = ReadDataStream(BytesIO(buffer[begin : begin + length].tobytes()))
            try:
                if opcode == Opcode.SCHEMA:
                    schema = Schema.read(stream)
                    self._schemas[schema.id] = schema
                else:
                    channel = Channel.read(stream)
                    if self._topic_of[channel.id] < 0:
                        self._topic_of[channel.id] = self._topic(channel)
            except (McapError, struct.error, ValueError, MemoryError) as error:
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
        for i, known in enumerate(self.topics):
            if (known.name, known.type, known.encoding) == (topic.name, topic.type, topic.encoding):
                return i
        self.topics.append(topic)
        return len(self.topics) - 1

    def _content(self, begin: int, record: int) -> Bytes:
        """Uncompressed records of a chunk; none, and a note in ``problems``, if it is damaged."""
        try:
            _, _, size, crc, name_length = CHUNK_HEAD.unpack_from(self._buffer.data, begin)
            at = begin + CHUNK_HEAD.size
            compression = bytes(self._buffer[at : at + name_length]).decode()
            content = self._buffer[at + name_length + 8 : begin + record]
            if compression == "zstd":
                content = np.frombuffer(zstandard.decompress(content.data, size), dtype=np.uint8)
            elif compression == "lz4":
                content = np.frombuffer(lz4.frame.decompress(content.data), dtype=np.uint8)
            elif compression != "":
                raise ValueError(f"compression {compression!r} is not known")
            if crc and zlib.crc32(content.data) != crc:
                raise ValueError("its checksum is wrong")
        except DAMAGE as error:
            reason = (str(error) or type(error).__name__).splitlines()[0]
            self._damaged.add(begin)
            self._complain(f"{self.path}: the chunk at byte {begin} is damaged and left out: {reason}")
            return np.empty(0, dtype=np.uint8)
        return content

    def _complain(self, text: str) -> None:
        if text not in self.problems:
            self.problems.append(text)
