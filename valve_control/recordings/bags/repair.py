# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Finishes an MCAP file whose writer was killed: adds the missing indexes, summary and footer."""

import os
import struct
import zlib
from collections import Counter
from io import FileIO
from pathlib import Path

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from valve_control.arrays import Integers
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.mcap import CHUNK_HEAD, FRAME, MAGIC, MESSAGE_HEAD, records
from valve_control.recordings.bags.salvage import INSIDE, PRIVATE, Piece, Salvage

WHOLE_HEAD = struct.Struct("<BQQQQIIQ")  # of a chunk without compression, up to its records
INDEX_HEAD = struct.Struct("<BQHI")  # opcode, length, channel, bytes of the entries
FOOTER_LENGTH = 20
MADE_ANEW = (Opcode.MESSAGE_INDEX, Opcode.DATA_END, Opcode.FOOTER)


class Contents:
    """Content of a file, collected piece by piece."""

    def __init__(self) -> None:
        self.end = 0  # where the whole records of the data section end
        self.torn = False  # whether part of a record follows
        self.head = b""  # new head of a torn chunk whose first messages are whole
        self.chunk: ChunkIndex | None = None  # the last one
        self.rows: Integers = np.empty((0, 6), np.int64)  # its messages, as in Piece
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.chunks: list[ChunkIndex] = []
        self.attachments: list[AttachmentIndex] = []
        self.metadata: list[MetadataIndex] = []
        self.counts: Counter[int] = Counter()
        self.start_time: int | None = None
        self.end_time = 0

    def count(self, rows: Integers) -> None:
        """Count the messages ``rows`` (as in Piece)."""
        if len(rows) == 0:
            return
        self.counts.update(rows[:, 0].tolist())
        first = int(rows[:, 1].min())
        self.start_time = first if self.start_time is None else min(self.start_time, first)
        self.end_time = max(self.end_time, int(rows[:, 1].max()))

    def add_chunk(self, head: bytes, start: int, length: int, rows: Integers) -> ChunkIndex:
        """Enter the chunk of ``length`` bytes at ``start``, which begins with ``head``, and its messages."""
        first, last, size, _, name = CHUNK_HEAD.unpack_from(head, FRAME.size)
        at = FRAME.size + CHUNK_HEAD.size
        self.chunk = ChunkIndex(
            chunk_length=length,
            chunk_start_offset=start,
            compression=head[at : at + name].decode(),
            compressed_size=length - at - name - 8,
            message_end_time=last,
            message_index_length=0,
            message_index_offsets={},
            message_start_time=first,
            uncompressed_size=size,
        )
        self.chunks.append(self.chunk)
        self.rows = rows
        self.count(rows)
        return self.chunk

    def message_indexes(self, chunk: ChunkIndex) -> bytes:
        """Message indexes of ``chunk``, the last one, which are to be written at the end."""
        data = b""
        for channel in dict.fromkeys(self.rows[:, 0].tolist()):
            chosen = self.rows[self.rows[:, 0] == channel]
            entries = np.column_stack((chosen[:, 1], chosen[:, 4] - MESSAGE_HEAD)).astype("<u8").tobytes()
            chunk.message_index_offsets[channel] = self.end + len(data)
            data += INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + len(entries), channel, len(entries)) + entries
        chunk.message_index_length = len(data)
        return data

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


def repair(path: Path, contents: Contents) -> int:
    """Write the missing end of the MCAP file ``path``, in place; an interrupted call loses no whole record.

    Only the record that was being written is cut off, and of a chunk that is not compressed only what follows
    its last whole message. Returns the number of bytes of torn records that were cut off. Raises OSError.
    """
    with path.open("r+b", buffering=0) as output:
        size = path.stat().st_size
        if contents.head and contents.chunk is not None:
            # One small write makes the torn chunk a whole, shorter one; only then what follows it may go.
            output.seek(contents.chunk.chunk_start_offset)
            put(output, contents.head)
        output.truncate(contents.end)
        end_file(output, contents)
    return size - contents.end if contents.torn else 0


# Reading


def scan(salvage: Salvage) -> Contents:
    """Whole records of a file that only lacks its end. Raises BagError if it is damaged before, OSError."""
    contents = Contents()
    for piece in salvage.pieces():
        if piece.opcode == Opcode.DATA_END:
            break
        if piece.sound:
            _take(contents, salvage, piece)
            continue
        if not salvage.is_torn(piece):
            raise BagError(
                f"{salvage.path} is damaged at byte {piece.begin}, before its end, and is left as it is; "
                "only what a killed recorder leaves can be repaired"
            )
        contents.torn = piece.begin > 0 and salvage.raw(piece.begin, piece.begin + 1)[0] not in MADE_ANEW
        if piece.opcode == Opcode.CHUNK:
            _take_torn(contents, salvage, piece)
        break
    # The last chunk's message indexes are written anew unless they are complete.
    chunk = contents.chunk
    if chunk is not None and set(chunk.message_index_offsets) != set(contents.rows[:, 0].tolist()):
        contents.end = chunk.chunk_start_offset + chunk.chunk_length
        chunk.message_index_offsets.clear()
    return contents


def _take(contents: Contents, salvage: Salvage, piece: Piece) -> None:
    """Take in one piece of the data section."""
    length = piece.end - piece.begin
    contents.end = piece.end
    if piece.opcode == Opcode.MESSAGE_INDEX:
        if contents.chunk is not None:
            (channel,) = struct.unpack(
                "<H", salvage.raw(piece.begin + FRAME.size, piece.begin + FRAME.size + 2)
            )
            contents.chunk.message_index_offsets[channel] = piece.begin
            contents.chunk.message_index_length += length
        return
    if piece.opcode < PRIVATE:
        contents.chunk = None
    for record in salvage.definitions(piece):
        if isinstance(record, Schema):
            contents.schemas[record.id] = record
        elif isinstance(record, Channel):
            contents.channels[record.id] = record
    if piece.opcode == Opcode.CHUNK and piece.messages is not None:
        head = contents.head or salvage.raw(piece.begin, piece.begin + WHOLE_HEAD.size)
        contents.add_chunk(head, piece.begin, length, piece.messages)
    elif piece.messages is not None:
        contents.count(piece.messages)
    elif piece.opcode == Opcode.ATTACHMENT:
        contents.attach(piece.record, piece.begin, length)
    elif piece.opcode == Opcode.METADATA:
        contents.metadata.append(MetadataIndex(piece.begin, length, piece.record.name))


def _take_torn(contents: Contents, salvage: Salvage, piece: Piece) -> None:
    """Take in the whole messages of a torn chunk that is not compressed."""
    *_, name = CHUNK_HEAD.unpack(salvage.raw(piece.begin + FRAME.size, piece.begin + WHOLE_HEAD.size - 8))
    if name or piece.content is None:
        return
    stop, rows, others = records(piece.content, 0, len(piece.content))
    for begin in others[~np.isin(others[:, 0], INSIDE), 1].tolist()[:1]:
        stop = begin - FRAME.size
        rows = rows[rows[:, 4] < stop]
    if len(rows):
        content = piece.content[:stop]
        contents.head = chunk_head(content.tobytes(), rows)
        end = piece.begin + WHOLE_HEAD.size + stop
        _take(contents, salvage, piece._replace(end=end, content=content, messages=rows))


# Writing


def put(output: FileIO, data: bytes) -> None:
    """Write all of ``data``. Raises OSError."""
    rest = memoryview(data)
    while rest:
        rest = rest[output.write(rest) :]


def chunk_head(data: bytes, rows: Integers) -> bytes:
    """What stands before the records ``data``, with the messages ``rows``, in a chunk."""
    first, last = int(rows[:, 1].min()), int(rows[:, 1].max())
    length = WHOLE_HEAD.size - FRAME.size + len(data)
    return WHOLE_HEAD.pack(Opcode.CHUNK, length, first, last, len(data), zlib.crc32(data), 0, len(data))


def written(builder: RecordBuilder) -> bytes:
    """Records as bytes."""
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def end_file(output: FileIO, contents: Contents) -> None:
    """Append all that is missing; without a summary if only that finds room. Raises OSError."""
    output.seek(contents.end)
    whole, bare = _tail(contents)
    try:
        put(output, whole)
    except OSError:
        output.truncate(contents.end)
        output.seek(contents.end)
        try:
            put(output, bare)
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
    if contents.chunk is not None and not contents.chunk.message_index_offsets:
        builder.write(contents.message_indexes(contents.chunk))
    DataEnd(0).write(builder)
    data = written(builder)
    summary_start = contents.end + len(data)
    offsets: list[SummaryOffset] = []
    for opcode, group in (
        (Opcode.SCHEMA, contents.schemas.values()),
        (Opcode.CHANNEL, contents.channels.values()),
        (Opcode.STATISTICS, [contents.statistics()]),
        (Opcode.CHUNK_INDEX, contents.chunks),
        (Opcode.ATTACHMENT_INDEX, contents.attachments),
        (Opcode.METADATA_INDEX, contents.metadata),
    ):
        start = builder.count
        for record in group:
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
