# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Finds the whole records in a damaged MCAP file, wherever the damage begins and ends.

Damage ends where the next sound record begins: one whose content fills its length and which another record
follows. A chunk tells its length twice, so that it is found again with certainty. A chunk whose checksum is
wrong is read record by record; what is whole in it is had, and counts as doubtful.
"""

import re
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import lz4.frame
import numpy as np
import numpy.typing as npt
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from valve_control.arrays import Bytes, Integers
from valve_control.recordings.bags.mcap import CHUNK_HEAD, FRAME, MAGIC, MESSAGE_HEAD, records

COMPRESSIONS = ("", "zstd", "lz4")
CANDIDATE = re.compile(
    rb"(?=[\x01-\x0f].{5}\0\0\0)", re.DOTALL
)  # where a record of less than 1 TiB may begin
LONGEST = 1 << 40  # bytes of a record
LONGEST_HEADER = 1000  # bytes
LARGEST = 1 << 28  # bytes of a damaged chunk that are decompressed at most
PIECE = 4096  # bytes that are decompressed at once of a damaged chunk
MARGIN = 3_600 * 10**9  # ns before and after all sound chunks from which messages of damaged ones may be
FEW = 3  # lengths of messages of one topic from which on any length is believed
READ: Mapping[int, Any] = {
    Opcode.HEADER: Header,
    Opcode.FOOTER: Footer,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT: Attachment,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.STATISTICS: Statistics,
    Opcode.METADATA: Metadata,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.SUMMARY_OFFSET: SummaryOffset,
    Opcode.DATA_END: DataEnd,
}
PRIVATE = 0x80  # opcodes from here on are of others
INSIDE = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)  # what a chunk holds


class Piece(NamedTuple):
    """A record, a run of loose messages, or (opcode 0) a stretch in which no record is found."""

    opcode: int
    begin: int
    end: int
    sound: bool = True
    record: Any = None  # as the library reads it
    content: Bytes | None = None  # of a chunk its records, of loose messages the file
    messages: Integers | None = None  # a row each: channel, log time, publish time, sequence, offset, length
    skipped: int = 0  # bytes that cannot be read
    doubtful: bool = False  # whether a checksum of the messages is wrong or lost
    torn: bool = False  # whether the file ends before it does


class Survey(NamedTuple):
    """What a file contains, and what is wrong with it."""

    messages: int  # that can be read
    doubtful: int  # of them, whose checksum is wrong or lost
    expected: (
        int | None
    )  # in the file's own statistics; as many as can be read if it has an end and no damage
    skipped: int  # bytes that cannot be read
    whole: bool  # nothing is wrong
    unfinished: bool  # only the end is missing, as after the kill of a recorder


class _Chunk(NamedTuple):
    """What a survey knows of a sound chunk."""

    length: int  # bytes
    channels: set[int]  # that have messages in it
    offsets: dict[int, int]  # where the message indexes behind it begin, by channel

    @property
    def is_indexed(self) -> bool:
        """Whether each channel has its message index."""
        return self.channels <= self.offsets.keys()

    def fits(self, told: ChunkIndex) -> bool:
        """Whether the summary tells where the chunk and its message indexes are."""
        offsets = told.message_index_offsets
        return told.chunk_length == self.length and all(
            offsets.get(c) == self.offsets[c] for c in self.channels
        )


def _agree(told: Statistics | None, messages: int, chunks: int, times: Sequence[int]) -> bool:
    """Whether a file has the ``messages`` and ``chunks`` that it tells, with the log ``times`` [ns]."""
    if told is None:
        return not messages
    # The library of C++ takes a start at 0 for none.
    first, last = (min(times), max(times)) if times else (0, 0)
    ends = not times or told.message_end_time == last
    return (
        (told.message_count, told.chunk_count) == (messages, chunks)
        and ends
        and first in (0, told.message_start_time)
    )


class Salvage:
    """Reads an MCAP file, however damaged. Raises OSError."""

    def __init__(self, path: Path, types: Mapping[str, str] | None = None) -> None:
        """``types``: of topics, for channels whose schemas are lost."""
        self.path = path
        self._data: Bytes = np.empty(0, np.uint8)
        if path.stat().st_size:
            self._data = np.memmap(path, dtype=np.uint8, mode="r")
        self._size = len(self._data)
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self._lengths: dict[int, set[int]] = {}  # channel → lengths of its messages
        self._times = (1 << 63, 0)  # in which messages are that can be trusted [ns]
        if not self._take_summary():
            self._take_all()
            self._complete(types or {})

    def survey(self) -> Survey:
        """Read the whole file once and summarise it."""
        messages, doubtful, skipped, chunks = 0, 0, 0, 0
        whole = unfinished = bytes(self._data[: len(MAGIC)]) == MAGIC[: self._size]
        statistics: Statistics | None = None
        chunk: Piece | None = None  # the one before, whose indexes may follow
        places: dict[int, _Chunk] = {}  # by where they begin
        told: dict[int, ChunkIndex] = {}  # likewise, as the summary has them
        counts: Counter[int] = Counter()  # of messages by channel
        times: list[int] = []  # earliest and latest log times [ns]
        repeated: set[int] = set()  # channels in the summary
        header = ended = footer = False
        for piece in self.pieces():
            whole = whole and piece.sound and not footer
            # What follows the data is made anew; before, only a record that the file's end tore may be wrong.
            unfinished = unfinished and (ended or piece.sound or self.is_torn(piece))
            skipped += piece.skipped
            channels = np.unique(piece.messages[:, 0]).tolist() if piece.messages is not None else []
            if piece.messages is not None and channels:
                counts.update(piece.messages[:, 0].tolist())
                times += [int(piece.messages[:, 1].min()), int(piece.messages[:, 1].max())]
            if piece.messages is not None:
                messages += len(piece.messages)
                doubtful += len(piece.messages) if piece.doubtful else 0
                whole = whole and not ended
                unfinished = unfinished and not ended
            if piece.opcode == Opcode.CHUNK:
                # Only the index of the last chunk can be written in place.
                unfinished = unfinished and (chunk is None or places[chunk.begin].is_indexed)
                chunk = piece
                chunks += 1
                places[piece.begin] = _Chunk(piece.end - piece.begin, set(channels), {})
            elif piece.opcode == Opcode.MESSAGE_INDEX:
                fits = chunk is not None and self._index_fits(piece, chunk)
                whole, unfinished = whole and fits, unfinished and fits
                if chunk is not None:
                    (channel,) = struct.unpack_from("<H", self._data.data, piece.begin + FRAME.size)
                    places[chunk.begin].offsets[channel] = piece.begin
            elif piece.opcode == Opcode.CHUNK_INDEX:
                told[piece.record.chunk_start_offset] = piece.record
            elif piece.opcode == Opcode.CHANNEL and ended:
                repeated.add(piece.record.id)
            elif piece.opcode == Opcode.STATISTICS:
                statistics = piece.record
            header = header or piece.opcode == Opcode.HEADER
            if piece.opcode == Opcode.DATA_END:
                ended = True
                checksum = piece.record.data_section_crc
                whole = whole and checksum in (0, zlib.crc32(self._data[: piece.begin].data))
            footer = footer or piece.opcode == Opcode.FOOTER
        whole = whole and header and footer and told.keys() == places.keys() and repeated >= counts.keys()
        whole = whole and all(place.is_indexed and place.fits(told[at]) for at, place in places.items())
        whole = whole and _agree(statistics, messages, chunks, times) and self._summary_is_sound()
        expected = messages if footer and not (skipped or doubtful) else None
        if statistics is not None:
            expected = statistics.message_count
        unfinished = unfinished and not doubtful and (ended or not footer)
        return Survey(messages, doubtful, expected, skipped, whole, unfinished)

    def is_torn(self, piece: Piece) -> bool:
        """Whether a piece that is not sound may have been left by a killed writer or its file system."""
        if piece.end < self._size or piece.begin == len(MAGIC) < self._size - LONGEST_HEADER:
            return False
        rest = self._data[piece.begin :]
        if piece.torn or not rest.any():
            return True
        if len(rest) < FRAME.size:
            return MAGIC.startswith(rest.tobytes()) if piece.begin == 0 else bool(rest[0] <= Opcode.DATA_END)
        opcode, length = FRAME.unpack_from(rest.data)
        return bool(0 < opcode <= Opcode.DATA_END and len(rest) - FRAME.size < length < LONGEST)

    def pieces(self) -> Iterator[Piece]:
        """Yield all pieces of the file in their order."""
        at = len(MAGIC) if bytes(self._data[: len(MAGIC)]) == MAGIC else 0
        stray = False  # whether loose messages may be the rest of a damaged chunk
        while at < self._size:
            if self._size - at == len(MAGIC) and bytes(self._data[at:]) == MAGIC:
                return
            piece = self._piece(at)
            if piece is None:
                end = self._next(self._data, at + 1, self._size)
                piece = Piece(0, at, end, sound=False, skipped=end - at)
            if piece.opcode == Opcode.MESSAGE:
                piece = piece._replace(doubtful=stray)
            stray = stray or piece.opcode in (0, Opcode.CHUNK)
            yield piece
            at = piece.end

    def raw(self, begin: int, end: int) -> bytes:
        """Bytes of the file."""
        return self._data[begin:end].tobytes()

    # Schemas and channels

    def _summary_is_sound(self) -> bool:
        """Whether the summary begins right behind the data, and the checksum over it is right, if any."""
        footer = self._data[-len(MAGIC) - 20 :]
        start, _, checksum = struct.unpack_from("<QQI", footer.data)
        if start == 0:
            return bool(checksum == 0)
        end = start - FRAME.size - 4  # of the data, where their end is a record of four bytes
        if not 0 < end <= self._size - FRAME.size:
            return False
        if FRAME.unpack_from(self._data.data, end) != (Opcode.DATA_END, 4):
            return False
        summary = self._data[start : self._size - len(MAGIC) - 4]
        return bool(checksum == 0 or zlib.crc32(summary.data) == checksum)

    def _take_summary(self) -> bool:
        """Take in schemas and channels of a sound summary; returns whether there is one."""
        try:
            with self.path.open("rb") as stream:
                summary = make_reader(stream, validate_crcs=True).get_summary()
        except Exception:  # the library has no common error for what it cannot read
            return False
        if summary is None or not summary.channels or not self._summary_is_sound():
            return False
        self.schemas |= summary.schemas
        self.channels |= summary.channels
        if summary.statistics is not None:
            self._times = (summary.statistics.message_start_time, summary.statistics.message_end_time)
        return True

    def _take_all(self) -> None:
        """Take in schemas and channels from anywhere in the file; those in sound chunks win."""
        found: dict[bool, list[Any]] = {True: [], False: []}
        for piece in self.pieces():
            found[piece.sound].extend(self.definitions(piece))
            if piece.opcode == Opcode.CHUNK and piece.content is not None:
                _, rows, _ = records(piece.content, 0, len(piece.content))
                if piece.sound and len(rows):
                    first, last = int(rows[:, 1].min()), int(rows[:, 1].max())
                    self._times = (min(self._times[0], first), max(self._times[1], last))
        for record in found[True] + found[False]:
            if isinstance(record, Schema):
                self.schemas.setdefault(record.id, record)
            elif isinstance(record, Channel) and record.topic.isprintable():
                self.channels.setdefault(record.id, record)

    def _complete(self, types: Mapping[str, str]) -> None:
        """Make a schema for each channel that has none."""
        for channel in self.channels.values():
            if channel.schema_id in self.schemas or channel.schema_id == 0:
                continue
            name = types.get(channel.topic, "")
            if name:
                self.schemas[channel.schema_id] = Schema(channel.schema_id, b"", "", name)
            else:
                channel.schema_id = 0

    def definitions(self, piece: Piece) -> Iterator[Any]:
        """Yield the record of a piece, of a chunk its schemas and channels."""
        if piece.record is not None:
            yield piece.record
        content = piece.content if piece.opcode == Opcode.CHUNK else None
        at = 0
        while content is not None and at < len(content):
            at, _, others = records(content, at, len(content))
            for opcode, begin, length in others.tolist():
                if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    record = self._record(content, begin - FRAME.size, begin + length)
                    if record is not None:
                        yield record
            after = self._next(content, at + 1, len(content), INSIDE) if at < len(content) else at
            if after == at:
                break
            at = after

    # Records

    def _piece(self, at: int) -> Piece | None:
        """The record at ``at``, or the loose messages from there on; None if there is none."""
        if at + FRAME.size > self._size:
            return None
        opcode, length = FRAME.unpack_from(self._data.data, at)
        end = at + FRAME.size + length
        if opcode == Opcode.CHUNK:
            return self._chunk(at)
        if opcode == Opcode.MESSAGE:
            return self._loose(at)
        if end > self._size:
            return None
        if not self._follows(self._data, end) and self._next(self._data, at + 1, end) < end:
            return None  # its length is damaged, or its end
        if opcode == Opcode.MESSAGE_INDEX:
            return Piece(opcode, at, end) if self._is_message_index(self._data, at, end) else None
        if opcode in READ:
            record = self._record(self._data, at, end)
            return Piece(opcode, at, end, record=record) if record is not None else None
        return Piece(opcode, at, end) if opcode >= PRIVATE and self._follows(self._data, end) else None

    @staticmethod
    def _record(data: Bytes, at: int, end: int) -> Any:
        """Read a record with the library; None unless it fills its length."""
        stream = BytesIO(data[at + FRAME.size : end].tobytes())
        try:
            record = READ[int(data[at])].read(ReadDataStream(stream))
        except Exception:  # the library has no common error for what is torn or no text
            return None
        return record if stream.tell() == end - at - FRAME.size else None

    @staticmethod
    def _is_message_index(data: Bytes, at: int, end: int) -> bool:
        length = end - at - FRAME.size
        if length < 6:
            return False
        (size,) = struct.unpack_from("<I", data.data, at + FRAME.size + 2)
        return bool(size == length - 6 and size % 16 == 0)

    def _index_fits(self, piece: Piece, chunk: Piece) -> bool:
        """Whether a message index tells where the messages of its channel are in the chunk."""
        body = self._data[piece.begin + FRAME.size : piece.end]
        (channel,) = struct.unpack_from("<H", body.data)
        told = np.frombuffer(body[6:].tobytes(), dtype="<u8").reshape(-1, 2).astype(np.int64)
        rows = chunk.messages if chunk.messages is not None else np.empty((0, 6), np.int64)
        rows = rows[rows[:, 0] == channel]
        found = np.column_stack((rows[:, 1], rows[:, 4] - MESSAGE_HEAD))
        told, found = (pairs[np.lexsort(pairs.T)] for pairs in (told, found))
        return bool(np.array_equal(told, found))

    # Where records begin

    def _next(self, data: Bytes, at: int, limit: int, kinds: tuple[int, ...] | None = None) -> int:
        """Where the next sound record of ``kinds`` (None: any) begins; ``limit`` if there is none."""
        # A record may begin before ``limit`` and end behind it.
        for found in CANDIDATE.finditer(data.data, at):
            if found.start() >= limit:
                break
            if self._is_sound(data, found.start(), kinds):
                return found.start()
        return limit

    def _is_sound(self, data: Bytes, at: int, kinds: tuple[int, ...] | None) -> bool:
        """Whether the bytes at ``at``, found by search, are certainly a record."""
        opcode, length = FRAME.unpack_from(data.data, at)
        end = at + FRAME.size + length
        if kinds is not None and opcode not in kinds:
            return False
        if opcode == Opcode.CHUNK:
            return data is self._data and self._head(at, strict=True) is not None
        if end > len(data):
            return False
        if opcode == Opcode.MESSAGE:
            if length < MESSAGE_HEAD - FRAME.size:
                return False
            (channel,) = struct.unpack_from("<H", data.data, at + FRAME.size)
            return channel in self.channels and (
                self._follows(data, end) or self._is_usual(channel, length + FRAME.size - MESSAGE_HEAD)
            )
        if opcode == Opcode.MESSAGE_INDEX:
            return self._is_message_index(data, at, end) and self._follows(data, end)
        return opcode in READ and self._follows(data, end) and self._record(data, at, end) is not None

    def _follows(self, data: Bytes, end: int) -> bool:
        """Whether at ``end`` a record begins, or the data end."""
        rest = len(data) - end
        if rest < FRAME.size:
            return rest == 0 or (rest > 0 and bytes(data[end:]) in (MAGIC, MAGIC[:rest], bytes(rest)))
        opcode, length = FRAME.unpack_from(data.data, end)
        return bool(0 < opcode <= Opcode.DATA_END and length < LONGEST)

    def _is_usual(self, channel: int, length: int) -> bool:
        """Whether messages of ``channel`` usually have this length, as far as is known."""
        known = self._lengths.get(channel, set())
        return length in known or len(known) > FEW

    def _known(self, rows: Integers) -> npt.NDArray[np.bool_]:
        """Which messages are of known channels, of any while there are none, and of a time before 2262."""
        possible = rows[:, 1] >= 0
        return possible & np.isin(rows[:, 0], list(self.channels)) if self.channels else possible

    def _first_torn(self, data: Bytes, rows: Integers) -> int:
        """The first of ``rows`` that holds a whole message of the same hour, -1 if none does.

        Such a message lost its end where others now stand, and only by chance a record follows it.
        """
        for i in np.flatnonzero(rows[:, 5] > MESSAGE_HEAD).tolist():
            time, begin, length = (int(rows[i, column]) for column in (1, 4, 5))
            for found in CANDIDATE.finditer(data.data, begin, begin + length):
                at = found.start()
                opcode, inner = FRAME.unpack_from(data.data, at)
                if opcode != Opcode.MESSAGE or at + FRAME.size + inner > begin + length:
                    continue
                channel, _, its_time = struct.unpack_from("<HIQ", data.data, at + FRAME.size)
                usual = inner + FRAME.size - MESSAGE_HEAD in self._lengths.get(channel, ())
                if usual and abs(its_time - time) < MARGIN:
                    return i
        return -1

    def _remember(self, rows: Integers) -> None:
        for channel, length in np.unique(rows[:, (0, 5)], axis=0).tolist():
            self._lengths.setdefault(channel, set()).add(length)

    # Messages

    def _chunk(self, at: int) -> Piece | None:
        head = self._head(at)
        if head is None:
            return None
        compression, size, checksum, times, begin, end = head
        packed = self._data[begin:end]
        content = _unpacked(compression, packed) if end <= self._size else None
        if content is not None and checksum in (0, zlib.crc32(content.data)):
            rows, skipped = self._inside(content, None)
            if skipped == 0:
                _, length = FRAME.unpack_from(self._data.data, at)
                (told,) = struct.unpack_from("<Q", self._data.data, begin - 8)
                sound = (size, length, told) == (len(content), end - at - FRAME.size, end - begin)
                if len(rows):
                    sound = sound and times[0] <= rows[:, 1].min() and rows[:, 1].max() <= times[1]
                return Piece(Opcode.CHUNK, at, end, bool(sound), None, content, rows)
        # What belongs outside of chunks ends this one: it lacks bytes, or has too many if no record follows.
        outside = tuple(kind for kind in (*READ, Opcode.CHUNK, Opcode.MESSAGE_INDEX) if kind not in INSIDE)
        torn = end > self._size
        limit = end if not torn and self._follows(self._data, end) else self._size
        end = self._next(self._data, begin, limit, outside)
        torn = torn and end == self._size
        packed = self._data[begin:end]
        content = _unpacked_in_part(compression, packed)
        rows, skipped = self._inside(content, times)
        if compression and len(rows) == 0:
            skipped = end - begin
        return Piece(Opcode.CHUNK, at, end, False, None, content, rows, skipped, doubtful=not torn, torn=torn)

    def _head(self, at: int, strict: bool = False) -> tuple[str, int, int, tuple[int, int], int, int] | None:
        """Compression, uncompressed size, checksum, times, begin and end of a chunk's records, or None.

        If one of the two lengths is damaged, the one after which a record follows counts, unless ``strict``.
        """
        where = at + FRAME.size
        if where + CHUNK_HEAD.size > self._size:
            return None
        _, length = FRAME.unpack_from(self._data.data, at)
        first, last, size, checksum, name = CHUNK_HEAD.unpack_from(self._data.data, where)
        begin = where + CHUNK_HEAD.size + name + 8
        if name > max(map(len, COMPRESSIONS)) or begin > self._size:
            return None
        compression = bytes(self._data[begin - 8 - name : begin - 8]).decode(errors="replace")
        if compression not in COMPRESSIONS:
            return None
        ends = {where + length, begin + struct.unpack_from("<Q", self._data.data, begin - 8)[0]}
        if len(ends) > 1:
            if strict:
                return None
            ends = {end for end in ends if begin <= end < self._size and self._follows(self._data, end)}
        end = ends.pop() if len(ends) == 1 else -1
        return (compression, size, checksum, (first, last), begin, end) if begin <= end < LONGEST else None

    def _inside(self, content: Bytes, times: tuple[int, int] | None) -> tuple[Integers, int]:
        """Messages of a chunk, and how many bytes of it cannot be read.

        Of a damaged chunk (``times``: those of its head) messages with impossible times are left out.
        """
        parts = [np.empty((0, 6), np.int64)]
        at, skipped = 0, 0
        while at < len(content):
            stop, rows = self._run(content, at, inside=True, checked=times is None)
            parts.append(rows)
            at = self._next(content, max(stop, at + 1), len(content), INSIDE) if stop < len(content) else stop
            skipped += at - stop
        rows = np.concatenate(parts)
        keep = self._known(rows)
        if times is not None:
            first = min(times[0], self._times[0]) - MARGIN
            last = max(times[1], self._times[1]) + MARGIN
            within = (rows[:, 1] >= first) & (rows[:, 1] <= last)
            if 2 * np.count_nonzero(within) > len(rows):  # otherwise it is the chunk's times that are wrong
                keep &= within
        return rows[keep], skipped + int((rows[~keep, 5] + MESSAGE_HEAD).sum())

    def _loose(self, at: int) -> Piece | None:
        stop, rows = self._run(self._data, at, inside=False)
        if stop == at:
            return None
        keep = self._known(rows)
        skipped = int((rows[~keep, 5] + MESSAGE_HEAD).sum())
        return Piece(Opcode.MESSAGE, at, stop, skipped == 0, None, self._data, rows[keep], skipped)

    def _run(self, data: Bytes, at: int, inside: bool, checked: bool = False) -> tuple[int, Integers]:
        """Messages from ``at`` on, ``inside`` a chunk with what else it may hold, and where they end.

        ``checked``: the checksum over them is right.
        """
        parts = [np.empty((0, 6), np.int64)]
        while at < len(data):
            stop, rows, others = records(data, at, len(data))
            for opcode, begin, length in others.tolist():
                allowed = inside and opcode in (Opcode.SCHEMA, Opcode.CHANNEL)
                if not (allowed and self._record(data, begin - FRAME.size, begin + length) is not None):
                    stop = begin - FRAME.size
                    rows = rows[rows[:, 4] < stop]
                    break
            torn = -1 if checked else self._first_torn(data, rows)
            if torn >= 0:
                stop, rows = int(rows[torn, 4]) - MESSAGE_HEAD, rows[:torn]
                parts.append(rows)
                self._remember(rows)
                at = stop
                break
            if stop == at:
                break
            if stop < len(data) and not self._follows(data, stop):
                # What follows is damaged, or the length of the last record.
                definitions = others[others[:, 1] < stop]
                message = int(rows[-1, 4]) - MESSAGE_HEAD if len(rows) else -1
                definition = int(definitions[-1, 1]) - FRAME.size if len(definitions) else -1
                if definition > message:
                    stop = definition
                elif len(rows):
                    swallowed = self._next(data, message + 1, stop) < stop
                    if swallowed or not self._is_usual(int(rows[-1, 0]), int(rows[-1, 5])):
                        stop, rows = message, rows[:-1]
            parts.append(rows)
            self._remember(rows)
            if stop == at or not self._follows(data, stop):
                at = stop
                break
            at = stop
            if not inside and int(data[at]) != Opcode.MESSAGE:
                break
        return at, np.concatenate(parts)


def _unpacked(compression: str, packed: Bytes) -> Bytes | None:
    """Uncompressed records of a chunk, None if they cannot be unpacked to their end."""
    try:
        if compression == "zstd":
            return np.frombuffer(
                zstandard.ZstdDecompressor().decompressobj().decompress(packed.tobytes()), np.uint8
            )
        if compression == "lz4":
            return np.frombuffer(lz4.frame.decompress(packed), np.uint8)
    except (zstandard.ZstdError, RuntimeError, ValueError, EOFError, MemoryError):
        return None
    return packed


def _unpacked_in_part(compression: str, packed: Bytes) -> Bytes:
    """Uncompressed records of a damaged chunk, as far as they can be unpacked."""
    if compression == "":
        return packed
    machine: Any = (
        zstandard.ZstdDecompressor().decompressobj()
        if compression == "zstd"
        else lz4.frame.LZ4FrameDecompressor()
    )
    parts: list[bytes] = []
    total = 0
    for at in range(0, len(packed), PIECE):
        try:
            parts.append(machine.decompress(packed[at : at + PIECE].tobytes()))
        except (zstandard.ZstdError, RuntimeError, ValueError, EOFError, MemoryError):
            break
        total += len(parts[-1])
        if total > LARGEST:
            break
    return np.frombuffer(b"".join(parts), np.uint8)
