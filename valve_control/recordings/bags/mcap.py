# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads MCAP files into arrays: one column for times, offsets and lengths of all messages.

The mcap library makes one Python object of each message, some 10 µs; a compiled walk over the records of a
chunk takes some 10 ns. Everything but messages (schemas, channels, chunk headers) is read with the library.
"""

import json
import mmap
import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from valve_control.arrays import Bytes, Integers
from valve_control.control.compiling import compile_function
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.messages import Block, Topic, absolute, full_type, qos_profiles

MAGIC = b"\x89MCAP0\r\n"
WINDOW = 100_000  # messages, records
DOUBTFUL = "valve_control.doubtful"  # metadata record: which messages were recovered from damaged chunks
FRAME = struct.Struct("<BQ")  # opcode, length
CHUNK_HEAD = struct.Struct("<QQQII")  # times, uncompressed size, checksum, length of the compression's name
MESSAGE_HEAD = 31  # bytes of a message record before its data
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


def records(buffer: Bytes, start: int, end: int) -> tuple[int, Integers, Integers]:
    """Where a walk over records from ``start`` stopped, its messages and other records (see ``_walk``)."""
    messages = np.empty((WINDOW, 6), dtype=np.int64)
    others = np.empty((WINDOW, 3), dtype=np.int64)
    at, count, rest = compile_function(_walk)(buffer, start, end, messages, others)
    return int(at), messages[:count], others[:rest]


def doubtful(record: Metadata) -> list[tuple[int, int, int]]:
    """Count, first and last log time [ns] of messages from damaged chunks, as a recovered file states."""
    if record.name != DOUBTFUL:
        return []
    try:
        entries = json.loads(record.metadata["messages"])
        return [(int(count), int(first), int(last)) for count, first, last in entries]
    except (KeyError, TypeError, ValueError, OverflowError):
        return []


class ChunkPlace(NamedTuple):
    """Where a chunk lies, and what its header says."""

    begin: int  # of its content in the file
    length: int
    start: int  # ns
    end: int  # ns


class McapFile:
    """One MCAP file, whole or unfinished.

    Raises BagError if it is not an MCAP file, OSError if it cannot be read. ``problems`` says what is wrong
    with a file that can be read in part.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.problems: list[str] = []
        self.topics: list[Topic] = []
        self.finished = False
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, int] = {}  # channel → topic
        self._table = np.full(65536, -1, dtype=np.int64)  # likewise, for whole columns
        self._known = 0
        self._buffer = self._map()
        self.size = len(self._buffer)
        self._chunks: list[ChunkPlace] = []
        self._loose = False  # whether messages stand outside of chunks
        self._index()

    def _map(self) -> Bytes:
        if self.path.stat().st_size == 0:
            raise BagError(f"{self.path} is empty")
        with self.path.open("rb") as stream:
            self._mapped = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        buffer = np.frombuffer(self._mapped, dtype=np.uint8)
        if bytes(buffer[: len(MAGIC)]) != MAGIC:
            raise BagError(f"{self.path} is not an MCAP file: it does not begin with MCAP's magic bytes")
        return buffer

    def close(self) -> None:
        """Release the memory; the file itself is closed already."""
        self._release(0, self.size)

    def blocks(
        self, start: int | None = None, end: int | None = None, told: Callable[[int], None] | None = None
    ) -> Iterator[Block]:
        """Yield messages with a log time [ns] from ``start`` to before ``end``.

        ``told`` is called with the number of bytes read since its last call.
        """
        done = 0
        if self._loose:
            at = len(MAGIC)
            while at < self.size:
                at, messages, others = records(self._buffer, at, self.size)
                yield from self._chosen(self._buffer, messages, start, end)
                self._release(done, at)
                if told is not None:
                    told(at - done)
                done = at
                if len(messages) == 0 and len(others) == 0:
                    break
        for place in self._chunks:
            inside = (start is None or place.end >= start) and (end is None or place.start < end)
            data = self._content(place) if inside else None
            if data is not None:
                at, total = 0, len(data)
                while at < total:
                    before = at
                    at, messages, others = records(data, at, total)
                    self._learn(data, others)
                    yield from self._chosen(data, messages, start, end)
                    if at == before:
                        self.problems.append(f"{self.path}: the chunk at byte {place.begin} is damaged")
                        break
            self._release(place.begin, place.begin + place.length)
            if not self._loose:
                if told is not None:
                    told(max(0, place.begin + place.length - done))
                done = place.begin + place.length
        if told is not None:
            told(max(0, self.size - done))

    def head(self) -> Block | None:
        """The first messages, None if there are none."""
        return next((block for block in self.blocks() if len(block.topic)), None)

    # How

    def _release(self, begin: int, end: int) -> None:
        """Release the memory behind a part of the file that has been read."""
        start = -(-begin // mmap.PAGESIZE) * mmap.PAGESIZE
        if end > start:
            self._mapped.madvise(mmap.MADV_DONTNEED, start, end - start)

    def _chosen(
        self, buffer: Bytes, messages: Integers, start: int | None, end: int | None
    ) -> Iterator[Block]:
        if len(messages) == 0:
            return
        channel, log, publish, sequence, offset, length = np.ascontiguousarray(messages.T)
        topic = self._topic_of()[channel]
        keep = topic >= 0
        if start is not None:
            keep &= log >= start
        if end is not None:
            keep &= log < end
        publish = np.where(publish == 0, log, publish)
        block = Block(buffer, topic, log, publish, sequence, np.arange(len(topic)), offset, length)
        yield block if keep.all() else block.select(keep)

    def _topic_of(self) -> Integers:
        if len(self._channels) != self._known:
            self._known = len(self._channels)
            for channel, topic in self._channels.items():
                self._table[channel] = topic
        return self._table

    def _index(self) -> None:
        """Find chunks, schemas and channels; a whole file repeats them in its summary."""
        at = len(MAGIC)
        ended = False
        while at < self.size:
            before = at
            at, messages, others = records(self._buffer, at, self.size)
            self._loose = self._loose or len(messages) > 0
            self._learn(self._buffer, others)
            for opcode, begin, length in others.tolist():
                if opcode == Opcode.CHUNK:
                    self._chunks.append(self._place(begin, length))
                elif opcode == Opcode.METADATA:
                    self._tell_doubtful(begin, length)
                ended = ended or opcode in (Opcode.DATA_END, Opcode.FOOTER)
                self.finished = opcode == Opcode.FOOTER
            if self.finished or at == before:
                break
        if not self.finished:
            rest = self.size - at
            if rest > 0 and not ended and not self._is_torn(at):
                self.problems.append(
                    f"{self.path} is damaged at byte {at}, the {rest} bytes from there on are not read "
                    "(valve-control bag recover finds what is whole in them)"
                )
            else:
                torn = f"; its last {rest} bytes are part of a record" if rest > 0 and not ended else ""
                self.problems.append(
                    f"{self.path} is unfinished{torn} (valve-control bag recover makes it whole)"
                )
        if not self.finished or not self.topics:
            for place in self._chunks:
                data = self._content(place)
                inner = 0
                while data is not None and inner < len(data):
                    before = inner
                    inner, _, others = records(data, inner, len(data))
                    self._learn(data, others)
                    if inner == before:
                        break
        self._release(0, self.size)

    def _is_torn(self, at: int) -> bool:
        """Whether a record begins at ``at`` that the end of the file cuts off."""
        if self.size - at < 9:
            return True
        opcode, length = struct.unpack_from("<BQ", self._buffer.data, at)
        return bool(0 < opcode <= Opcode.DATA_END and length > self.size - at - 9)

    def _tell_doubtful(self, begin: int, length: int) -> None:
        record = self._record(Metadata, self._buffer, begin, length)
        stretches = doubtful(record) if record is not None else []
        if stretches:
            count = sum(number for number, _, _ in stretches)
            self._complain(
                f"{self.path} was repaired: {count} of its messages, in {len(stretches)} stretches, stood in "
                "chunks whose checksum was wrong or lost, and some of their values may be wrong"
            )

    def _record(self, kind: Any, buffer: Bytes, begin: int, length: int) -> Any:
        """Read a record with the library; None, and a note in ``problems``, if it is damaged."""
        try:
            return kind.read(ReadDataStream(BytesIO(buffer[begin : begin + length].tobytes())))
        except (McapError, struct.error, ValueError, MemoryError) as error:
            self._complain(f"{self.path}: a {kind.__name__} record is damaged: {type(error).__name__}")
            return None

    def _place(self, begin: int, length: int) -> ChunkPlace:
        start, end = self._buffer[begin : begin + 16].view(np.uint64).tolist() if length >= 16 else (0, 0)
        return ChunkPlace(begin, length, start, end)

    def _learn(self, buffer: Bytes, others: Integers) -> None:
        """Take in the schemas and channels among ``others``."""
        for opcode, begin, length in others.tolist():
            if opcode == Opcode.SCHEMA:
                schema = self._record(Schema, buffer, begin, length)
                if schema is not None:
                    self._schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = self._record(Channel, buffer, begin, length)
                if channel is not None and channel.id not in self._channels:
                    self._channels[channel.id] = self._topic(channel)

    def _topic(self, channel: Channel) -> int:
        schema = self._schemas.get(channel.schema_id)
        topic = Topic(
            absolute(channel.topic),
            full_type(schema.name) if schema else "",
            channel.message_encoding,
            schema.encoding if schema else "",
            schema.data.decode(errors="replace") if schema else "",
            channel.metadata.get("topic_type_hash", ""),
            qos_profiles(channel.metadata.get("offered_qos_profiles", "")),
        )
        for i, known in enumerate(self.topics):
            if (known.name, known.type, known.encoding) == (topic.name, topic.type, topic.encoding):
                return i
        self.topics.append(topic)
        return len(self.topics) - 1

    def _content(self, place: ChunkPlace) -> Bytes | None:
        """Uncompressed records of a chunk; None, and a note in ``problems``, if it is damaged."""
        where = f"{self.path}: the chunk at byte {place.begin}"
        try:
            _, _, size, crc, name_length = CHUNK_HEAD.unpack_from(self._buffer.data, place.begin)
            at = place.begin + CHUNK_HEAD.size
            compression = bytes(self._buffer[at : at + name_length]).decode()
            at += name_length + 8
            records = self._buffer[at : place.begin + place.length]
            if compression == "zstd":
                records = np.frombuffer(zstandard.decompress(records.data, size), dtype=np.uint8)
            elif compression == "lz4":
                records = np.frombuffer(lz4.frame.decompress(records.data), dtype=np.uint8)
            elif compression != "":
                self._complain(f"{where} is compressed with {compression!r}; zstd and lz4 are known")
                return None
        except DAMAGE as error:
            reason = (str(error) or type(error).__name__).splitlines()[0]
            self._complain(f"{where} is damaged and left out: {reason}")
            return None
        if crc and zlib.crc32(records.data) != crc:
            self._complain(f"{where} is damaged (its checksum is wrong) and left out")
            return None
        return records

    def _complain(self, text: str) -> None:
        if text not in self.problems:
            self.problems.append(text)
