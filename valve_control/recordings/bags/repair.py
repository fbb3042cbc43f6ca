# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Finishes an MCAP file whose writer was killed: adds the missing indexes, summary and footer.

The records are read and written by the mcap library; only the frames around them, nine bytes each, are looked
at here, since the library cannot say where a torn record begins.
"""

import os
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from io import BytesIO, FileIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import get_chunk_data_stream

from valve_control.recordings.bags.errors import BagError

MAGIC = b"\x89MCAP0\r\n"
FRAME = struct.Struct("<BQ")  # opcode, length
MESSAGE = struct.Struct("<HIQ")  # channel, sequence, log time
CHUNK_HEAD = struct.Struct("<QQQI")  # times, uncompressed size, checksum
FOOTER_LENGTH = 20
MADE_ANEW = (Opcode.MESSAGE_INDEX, Opcode.DATA_END, Opcode.FOOTER)
KNOWN = (0, *Opcode)  # zeros are what a file system leaves of bytes that never reached the disk
LONGEST_HEADER = 1000


class Repaired(NamedTuple):
    """What a repair found."""

    messages: int
    cut: int  # bytes of torn records that were cut off


class Place(NamedTuple):
    """A whole record: its frame begins at ``start``, its content at ``begin``, and it ends before ``end``."""

    opcode: int
    start: int
    begin: int
    end: int


class Records(NamedTuple):
    """Content of a chunk."""

    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    entries: dict[int, list[tuple[int, int]]]  # channel → log time [ns], offset
    end: int  # of the whole records


class Contents:
    """Content of a file, collected record by record."""

    def __init__(self) -> None:
        self.end = 0  # where the whole records of the data section end
        self.torn = False  # whether part of a record follows
        self.ended = False  # whether the data section has its end
        self.head: bytes | None = None  # new head of a torn chunk whose first messages are whole
        self.chunk: ChunkIndex | None = None  # the last one
        self.entries: dict[int, list[tuple[int, int]]] = {}  # its messages: channel → log time, offset
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.chunks: list[ChunkIndex] = []
        self.attachments: list[AttachmentIndex] = []
        self.metadata: list[MetadataIndex] = []
        self.counts: Counter[int] = Counter()
        self.start_time: int | None = None
        self.end_time = 0

    def count(self, channel: int, log_time: int) -> None:
        """Count one more message of ``channel`` at ``log_time`` [ns]."""
        self.counts[channel] += 1
        if self.start_time is None or log_time < self.start_time:
            self.start_time = log_time
        self.end_time = max(self.end_time, log_time)

    def attach(self, attachment: Attachment, start: int, length: int) -> None:
        """Enter ``attachment``, whose record of ``length`` bytes begins at ``start``, into the index."""
        self.attachments.append(
            AttachmentIndex(
                offset=start,
                length=length,
                log_time=attachment.log_time,
                create_time=attachment.create_time,
                data_size=len(attachment.data),
                name=attachment.name,
                media_type=attachment.media_type,
            )
        )

    def statistics(self) -> Statistics:
        """The Statistics record."""
        return Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(self.channels),
            channel_message_counts=dict(self.counts),
            chunk_count=len(self.chunks),
            message_count=self.counts.total(),
            message_end_time=self.end_time,
            message_start_time=self.start_time or 0,
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )


def repair(path: Path) -> Repaired:
    """Write the missing end of the MCAP file ``path``, in place; an interrupted call loses no whole record.

    Only the record that was being written is cut off, and of a chunk that is not compressed only what follows
    its last whole message. Raises BagError if it is no MCAP file or damaged before its end, OSError.
    """
    with path.open("r+b", buffering=0) as output:
        size = path.stat().st_size
        with path.open("rb") as stream:
            contents = scan(stream, size, path)
        if contents.head is not None and contents.chunk is not None:
            # One small write makes the torn chunk a whole, shorter one; only then what follows it may go.
            output.seek(contents.chunk.chunk_start_offset)
            _write(output, contents.head)
        output.truncate(contents.end)
        end_file(output, contents)
    return Repaired(contents.counts.total(), size - contents.end if contents.torn else 0)


# Reading


def scan(stream: BinaryIO, size: int, path: Path) -> Contents:
    """Whole records of the file ``path`` of ``size`` bytes. Raises BagError, OSError."""
    start = stream.read(len(MAGIC))
    if not MAGIC.startswith(start):
        raise BagError(f"{path} is not an MCAP file: it does not begin with MCAP's magic bytes")
    contents = Contents()
    if len(start) < len(MAGIC):
        return contents
    damaged: int | None = None
    for place in _frames(stream, len(MAGIC), size):
        if place.opcode == Opcode.DATA_END:
            contents.ended = True
            break
        try:
            _take(contents if damaged is None else Contents(), place, stream)
        except Exception:  # decompressors and record classes have no common error
            damaged = place.start if damaged is None else damaged
            continue
        if damaged is None:
            contents.end = place.end
        elif place.opcode in (Opcode.CHUNK, Opcode.MESSAGE):
            raise _damage(path, damaged)
    if damaged is not None and not contents.end:
        raise _damage(path, damaged)
    if damaged is not None:
        contents.torn = True
    elif not contents.ended:
        _look_at_torn(contents, stream, size, path)
    _drop_part_of_index(contents)
    return contents


def _damage(path: Path, at: int) -> BagError:
    return BagError(
        f"{path} is damaged at byte {at}, before its end, and is left as it is; "
        "only what a killed recorder leaves can be repaired"
    )


def _frames(stream: BinaryIO, start: int, size: int) -> Iterator[Place]:
    """Yield the whole records from ``start`` on."""
    while start + FRAME.size <= size:
        stream.seek(start)
        opcode, length = FRAME.unpack(stream.read(FRAME.size))
        begin = start + FRAME.size
        if opcode == 0 or length > size - begin:
            return
        yield Place(opcode, start, begin, begin + length)
        start = begin + length


def _take(contents: Contents, place: Place, stream: BinaryIO) -> None:
    """Take in one record of the data section."""
    length = place.end - place.begin
    readers: dict[int, Callable[[ReadDataStream], Any]] = {
        Opcode.HEADER: Header.read,
        Opcode.SCHEMA: Schema.read,
        Opcode.CHANNEL: Channel.read,
        Opcode.CHUNK: Chunk.read,
        Opcode.MESSAGE_INDEX: MessageIndex.read,
        Opcode.ATTACHMENT: Attachment.read,
        Opcode.METADATA: Metadata.read,
    }
    if place.opcode == Opcode.MESSAGE:
        channel, _, log_time = MESSAGE.unpack(stream.read(MESSAGE.size))
        contents.count(channel, log_time)
        contents.chunk = None
        return
    if place.opcode not in readers:
        return
    record = readers[place.opcode](ReadDataStream(BytesIO(stream.read(length))))
    if isinstance(record, MessageIndex):
        if contents.chunk is not None:
            contents.chunk.message_index_offsets[record.channel_id] = place.start
            contents.chunk.message_index_length += place.end - place.start
        return
    if isinstance(record, Schema):
        contents.schemas[record.id] = record
    elif isinstance(record, Channel):
        contents.channels[record.id] = record
    elif isinstance(record, Chunk):
        _take_chunk(contents, record, place.start, place.end - place.start)
        return
    elif isinstance(record, Attachment):
        contents.attach(record, place.start, place.end - place.start)
    elif isinstance(record, Metadata):
        contents.metadata.append(MetadataIndex(place.start, place.end - place.start, record.name))
    contents.chunk = None


def _take_chunk(contents: Contents, chunk: Chunk, start: int, length: int) -> None:
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    records = _records(stream.read(size))
    if records.end != size or size != chunk.uncompressed_size:
        raise ValueError("records do not fill the chunk")
    contents.schemas |= records.schemas
    contents.channels |= records.channels
    contents.entries = records.entries
    for channel, entries in records.entries.items():
        for log_time, _ in entries:
            contents.count(channel, log_time)
    contents.chunk = ChunkIndex(
        chunk_length=length,
        chunk_start_offset=start,
        compression=chunk.compression,
        compressed_size=len(chunk.data),
        message_end_time=chunk.message_end_time,
        message_index_length=0,
        message_index_offsets={},
        message_start_time=chunk.message_start_time,
        uncompressed_size=size,
    )
    contents.chunks.append(contents.chunk)


def _records(data: bytes) -> Records:
    """The whole records of a chunk that holds ``data``."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    entries: dict[int, list[tuple[int, int]]] = {}
    start = 0
    while start + FRAME.size <= len(data):
        opcode, length = FRAME.unpack_from(data, start)
        begin = start + FRAME.size
        end = begin + length
        if opcode == 0 or end > len(data):
            break
        if opcode == Opcode.MESSAGE:
            channel_id, _, log_time = MESSAGE.unpack_from(data, begin)
            entries.setdefault(channel_id, []).append((log_time, start))
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(data[begin:end])))
            schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(data[begin:end])))
            channels[channel.id] = channel
        start = end
    return Records(schemas, channels, entries, start)


def _look_at_torn(contents: Contents, stream: BinaryIO, size: int, path: Path) -> None:
    """Judge the torn record that follows the last whole one."""
    begin = contents.end or len(MAGIC)
    stream.seek(begin)
    rest = stream.read(size - begin)
    if not rest or rest[0] in MADE_ANEW:
        return
    if rest[0] not in KNOWN or (begin == len(MAGIC) and len(rest) > LONGEST_HEADER):
        raise _damage(path, begin)
    contents.torn = True
    head = FRAME.size + CHUNK_HEAD.size + 4 + 8
    compressed = rest[head - 12 : head - 8] != bytes(4)
    if rest[0] != Opcode.CHUNK or len(rest) < head or compressed:
        return
    records = _records(rest[head:])
    times = [log_time for entries in records.entries.values() for log_time, _ in entries]
    if not times:
        return
    data = rest[head : head + records.end]
    chunk = Chunk(
        compression="",
        data=data,
        message_start_time=min(times),
        message_end_time=max(times),
        uncompressed_crc=zlib.crc32(data),
        uncompressed_size=len(data),
    )
    chunk.write(builder := RecordBuilder())
    contents.head = written(builder)[:head]
    _take_chunk(contents, chunk, begin, head + len(data))
    contents.end = begin + head + len(data)


def _drop_part_of_index(contents: Contents) -> None:
    """Drop the last chunk's message indexes, to be written anew, unless they are complete."""
    chunk = contents.chunk
    if chunk is None or set(chunk.message_index_offsets) == set(contents.entries):
        return
    contents.end = chunk.chunk_start_offset + chunk.chunk_length
    chunk.message_index_offsets.clear()
    chunk.message_index_length = 0


# Writing


def _write(output: FileIO, data: bytes) -> None:
    rest = memoryview(data)
    while rest:
        rest = rest[output.write(rest) :]


def written(builder: RecordBuilder) -> bytes:
    """Records as bytes."""
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def end_file(output: FileIO, contents: Contents) -> None:
    """Append all that is missing; without a summary if only that finds room. Raises OSError."""
    output.seek(contents.end)
    whole, bare = _tail(contents)
    try:
        _write(output, whole)
    except OSError:
        output.truncate(contents.end)
        output.seek(contents.end)
        try:
            _write(output, bare)
        except OSError:
            output.truncate(contents.end)
            raise
    os.fsync(output.fileno())


def _tail(contents: Contents) -> tuple[bytes, bytes]:
    """Records that follow the data, with indexes and summary, and without."""
    builder = RecordBuilder()
    if contents.end == 0:
        builder.write(MAGIC)
        Header("ros2", "valve_control").write(builder)
    chunk = contents.chunk
    begun = builder.count
    if chunk is not None and not chunk.message_index_offsets:
        for channel, entries in contents.entries.items():
            chunk.message_index_offsets[channel] = contents.end + builder.count
            MessageIndex(channel, entries).write(builder)
        chunk.message_index_length = builder.count - begun
    DataEnd(0).write(builder)
    data = written(builder)
    summary_start = contents.end + len(data)
    offsets: list[SummaryOffset] = []
    for opcode, records in (
        (Opcode.SCHEMA, contents.schemas.values()),
        (Opcode.CHANNEL, contents.channels.values()),
        (Opcode.STATISTICS, [contents.statistics()]),
        (Opcode.CHUNK_INDEX, contents.chunks),
        (Opcode.ATTACHMENT_INDEX, contents.attachments),
        (Opcode.METADATA_INDEX, contents.metadata),
    ):
        start = builder.count
        for record in records:
            record.write(builder)
        if builder.count > start:
            offsets.append(
                SummaryOffset(
                    group_opcode=opcode, group_start=summary_start + start, group_length=builder.count - start
                )
            )
    offset_start = summary_start + builder.count
    for offset in offsets:
        offset.write(builder)
    summary = written(builder)
    # The checksum also covers the footer up to itself.
    footer = struct.pack("<BQQQ", Opcode.FOOTER, FOOTER_LENGTH, summary_start, offset_start)
    Footer(summary_start, offset_start, zlib.crc32(footer, zlib.crc32(summary))).write(builder)
    Footer(0, 0, 0).write(bare := RecordBuilder())
    return data + summary + written(builder) + MAGIC, data + written(bare) + MAGIC
