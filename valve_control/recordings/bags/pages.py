# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads the rows of a damaged SQLite bag straight from its pages, when SQLite itself cannot.

Python's sqlite3 has no recovery. SQLite's own (`.recover` of its shell) needs a part of the library that many
systems leave out (sqlite_dbpage), and fails there on whole databases too. What it does is done here for the
tables of a bag alone: each page that is a leaf of a table is read by itself, in the database and in its
write-ahead log, old images included, since a bag only grows. (https://www.sqlite.org/fileformat2.html)
"""

import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from valve_control.control.compiling import compile_function

HEADER = 100  # bytes of the database's header, on its first page
LEAF = 0x0D  # first byte of a leaf of a table
LEAF_HEAD = struct.Struct(">BHHHB")  # type, first free block, cells, begin of the cells, fragmented bytes
SIZES = tuple(1 << k for k in range(9, 17))  # of pages [bytes]
KINDS = (0, 2, 5, 10, LEAF)  # first bytes of a page
WAL_MAGIC = (0x377F0682, 0x377F0683)
WAL_HEAD = struct.Struct(">8I")  # magic, version, page size, number, two salts, two checksums
FRAME_HEAD = struct.Struct(">6I")  # page, size of the database after a commit or 0, salts, checksums
INTEGERS = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}  # serial type → bytes
LONGEST = 1 << 30  # bytes of a row

Value = int | float | bytes | str | None
Row = tuple[Value, ...]


class Image(NamedTuple):
    """Content of a page at some time."""

    number: int  # from 1 on; 0: not known
    data: bytes


class Log(NamedTuple):
    """Content of a write-ahead log."""

    sound: list[Image]  # frames whose checksum is right, in their order
    other: list[Image]  # what else looks like one
    damaged: bool  # whether it holds more than SQLite reads of it


def read_log(path: Path) -> Log:
    """Read the write-ahead log ``path``, in whatever state it is. Raises OSError."""
    data = path.read_bytes() if path.exists() else b""
    if len(data) < WAL_HEAD.size:
        return Log([], [], bool(data))
    magic, _, size, _, salt, pepper, *checksum = WAL_HEAD.unpack_from(data)
    head_sound = magic in WAL_MAGIC and size in SIZES
    size = size if size in SIZES else 4096
    big = magic != WAL_MAGIC[0]
    first, second = _checksum(data, 0, 24, 0, 0, big)
    head_sound = head_sound and [first, second] == checksum
    sound: list[Image] = []
    other: list[Image] = []
    chain, beyond = head_sound, False
    before = checksum
    for at in range(WAL_HEAD.size, len(data) - FRAME_HEAD.size - size + 1, FRAME_HEAD.size + size):
        number, commit, one, two, *told = FRAME_HEAD.unpack_from(data, at)
        page = at + FRAME_HEAD.size
        image = Image(number, data[page : page + size])
        first, second = _checksum(data, at, at + 8, before[0], before[1], big)
        first, second = _checksum(data, page, page + size, first, second, big)
        before = told
        if (one, two) == (salt, pepper) and [first, second] == told and number > 0:
            sound.append(image)
        else:
            other.append(image)
            chain = False
        # Frames of an earlier use of the log have other salts; of ours SQLite reads up to the last commit.
        if one == salt or two == pepper:
            beyond = not (chain and commit)
    return Log(sound, other, beyond or not head_sound)


def _words(buffer: Any, start: int, end: int, first: int, second: int, big: bool) -> tuple[int, int]:
    for at in range(start, end, 8):
        for k in range(2):
            word = 0
            for i in range(4):
                shift = 8 * (3 - i) if big else 8 * i
                word |= int(buffer[at + 4 * k + i]) << shift
            if k == 0:
                first = (first + word + second) & 0xFFFFFFFF
            else:
                second = (second + word + first) & 0xFFFFFFFF
    return first, second


def _checksum(data: bytes, start: int, end: int, first: int, second: int, big: bool) -> tuple[int, int]:
    buffer = np.frombuffer(data, np.uint8)
    one, two = compile_function(_words)(buffer, start, end, first, second, big)
    return int(one), int(two)


class Pages:
    """All pages of a database and its log. Raises OSError."""

    def __init__(self, path: Path) -> None:
        self._data = np.memmap(path, np.uint8, "r") if path.stat().st_size else np.empty(0, np.uint8)
        self._log = read_log(path.with_name(path.name + "-wal"))
        self.size = self._page_size()
        self._newest = {image.number: image.data for image in (*self._log.other, *self._log.sound)}

    def rows(self) -> Iterator[tuple[int, Row]]:
        """Row number and columns of all rows of all tables; of rows with one number the last one counts."""
        for image in self._images():
            yield from self._leaf(image)

    def _images(self) -> Iterator[Image]:
        """Images of all pages; more reliable ones come later."""
        size, total = self.size, len(self._data)
        firsts = self._data[size::size]
        if total % size or not np.isin(firsts, KINDS).all():
            # Inserted or missing bytes shift what follows them.
            for at in self._shifted():
                yield Image(0, self._data[at : at + size].tobytes())
        yield from self._log.other
        for at in range(0, total, size):
            yield Image(at // size + 1, self._data[at : at + size].tobytes())
        yield from self._log.sound

    def _shifted(self) -> Iterator[int]:
        """Offsets of leaves that lie where no page should begin."""
        data, size = self._data, self.size
        places = np.flatnonzero(data[: max(0, len(data) - size + 1)] == LEAF)
        places = places[places % size != 0]
        free, cells, begin = (
            data[places + k].astype(np.int64) << 8 | data[places + k + 1] for k in (1, 3, 5)
        )
        last = places + np.minimum(LEAF_HEAD.size + 2 * cells, size) - 2  # the newest cell is the lowest
        lowest = data[last].astype(np.int64) << 8 | data[last + 1]
        fits = (free == 0) & (cells > 0) & (LEAF_HEAD.size + 2 * cells <= begin) & (lowest == begin)
        yield from places[fits & (begin < size)].tolist()

    def _page_size(self) -> int:
        """Size of a page [bytes] from the header, or that with which most pages begin as pages do."""
        if len(self._data) >= HEADER:
            size = int(self._data[16]) << 8 | int(self._data[17])
            size = 65536 if size == 1 else size
            if bytes(self._data[:16]) == b"SQLite format 3\0" and size in SIZES:
                return size
        for image in self._log.sound:
            return len(image.data)
        shares = {size: _share_of_pages(self._data[size::size]) for size in SIZES}
        best = max(shares.values())
        # Of twice the size as many begin as pages do.
        return next((size for size, share in shares.items() if share > 0.8 * best), 4096)

    def _leaf(self, image: Image) -> Iterator[tuple[int, Row]]:
        data = image.data
        head = HEADER if image.number == 1 and data[:6] == b"SQLite" else 0
        first = head + LEAF_HEAD.size
        if len(data) < first:
            return
        kind, _, cells, _, _ = LEAF_HEAD.unpack_from(data, head)
        if kind != LEAF or cells == 0 or first + 2 * cells > len(data):
            return
        rows = [
            self._row(data, at) if first + 2 * cells <= at else None
            for at in (place % self.size for place in struct.unpack_from(f">{cells}H", data, first))
        ]
        if image.number == 0 and None in rows:
            return
        yield from _in_order(rows)

    def _row(self, data: bytes, at: int) -> tuple[int, Row] | None:
        try:
            length, at = _varint(data, at)
            number, at = _varint(data, at)
            payload = self._payload(data, at, length)
            return (number, _columns(payload)) if payload is not None else None
        except (IndexError, struct.error, ValueError):
            return None

    def _payload(self, data: bytes, at: int, length: int) -> bytes | None:
        usable = self.size
        most = usable - 35
        if length <= most:
            return data[at : at + length] if at + length <= len(data) else None
        if length > LONGEST:
            return None
        least = (usable - 12) * 32 // 255 - 23
        local = least + (length - least) % (usable - 4)
        local = local if local <= most else least
        parts = [data[at : at + local]]
        (page,) = struct.unpack_from(">I", data, at + local)
        rest = length - local
        seen: set[int] = set()
        while rest > 0:
            content = self._page(page)
            if content is None or page in seen:
                return None
            seen.add(page)
            parts.append(content[4 : 4 + rest])
            rest -= len(parts[-1])
            (page,) = struct.unpack_from(">I", content)
        return b"".join(parts)

    def _page(self, number: int) -> bytes | None:
        if number in self._newest:
            return self._newest[number]
        at = (number - 1) * self.size
        if number < 1 or at + self.size > len(self._data):
            return None
        return self._data[at : at + self.size].tobytes()


def _in_order(rows: list[tuple[int, Row] | None]) -> Iterator[tuple[int, Row]]:
    """Rows of a leaf, whose numbers rise; one that breaks the order gets the number that it should have."""
    steps = Counter(row[0] - i for i, row in enumerate(rows) if row is not None).most_common(1)
    base, count = steps[0] if steps else (0, 0)
    before: int | None = None
    for i, row in enumerate(rows):
        if row is None:
            continue
        number = row[0]
        after = rows[i + 1] if i + 1 < len(rows) else None
        ordered = (before is None or before < number) and after is not None and number < after[0]
        if 2 * count > len(rows) and not ordered:
            number = base + i
        before = number
        yield number, row[1]


def _share_of_pages(firsts: Any) -> float:
    """Share of these first bytes of pages that are those of a table's tree."""
    return float(np.isin(firsts, KINDS[1:]).mean()) if len(firsts) else 0.0


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for k in range(9):
        byte = data[at + k]
        if k == 8:
            value = value << 8 | byte
            break
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            break
    return value - (1 << 64) if value >> 63 else value, at + k + 1


def _columns(payload: bytes) -> Row:
    """Columns of a record. Raises IndexError, struct.error, ValueError."""
    end, at = _varint(payload, 0)
    kinds: list[int] = []
    while at < end:
        kind, at = _varint(payload, at)
        kinds.append(kind)
    row: list[Value] = []
    for kind in kinds:
        if kind == 0:
            row.append(None)
            continue
        if kind in (8, 9):
            row.append(kind - 8)
            continue
        if kind in (10, 11) or kind < 0:
            raise ValueError("no such type")
        size = INTEGERS.get(kind, 8 if kind == 7 else (kind - 12) // 2)
        part = payload[at : at + size]
        if len(part) < size:
            raise ValueError("the row is too short")
        at += size
        if kind in INTEGERS:
            row.append(int.from_bytes(part, "big", signed=True))
        elif kind == 7:
            row.extend(struct.unpack(">d", part))
        else:
            row.append(part if kind % 2 == 0 else part.decode())
    if at != len(payload):
        raise ValueError("the row is too long")
    return tuple(row)
