# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Opens a bag from any recorder: a folder with or without metadata.yaml, a single file, or a table."""

import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats, Integers
from valve_control.recordings.bags import metadata as bag_metadata
from valve_control.recordings.bags.cdr import Decoder
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.logs import KINDS as TABLES
from valve_control.recordings.bags.messages import Block, Topic
from valve_control.recordings.bags.sqlite_reader import SqliteFile
from valve_control.recordings.bags.table import TableFile

if TYPE_CHECKING:
    from valve_control.recordings.bags.mcap_reader import McapFile

    File = McapFile | SqliteFile | TableFile

KINDS = {".mcap": "mcap", ".db3": "sqlite3"}  # storage by suffix
ZSTD = (".zstd", ".zst")
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
POINTER = b"version https://git-lfs.github.com/spec/"  # of Git LFS, in the place of a file
FAR = 3600.0  # s between two stamps of one recording from which on they belong to different stretches of time


class Series(NamedTuple):
    """Messages of one topic in the order in which they were recorded."""

    log_time: Integers  # ns
    publish_time: Integers  # ns, the log time where the bag has none
    sequence: Integers  # of the publisher, 0 where the bag has none
    place: Integers  # among all messages of the bag
    values: dict[str, Floats]  # by field
    present: dict[str, npt.NDArray[np.bool_]]  # which messages have it, for fields that not all have
    raw: list[bytes]  # the messages themselves, if they were asked for
    undecodable: int  # messages left out
    error: str  # why the first of them
    absent: dict[str, int]  # sound messages without a field, by fields that not all have

    def having(self, field: str) -> "Series":
        """The messages that have ``field``."""
        return self.only(self.present[field]) if field in self.present else self

    def only(self, chosen: npt.NDArray[np.bool_]) -> "Series":
        """The messages chosen by a mask; the others, which are not lost, have no numbers."""
        if chosen.all():
            return self
        numbered = len(self.sequence) > 1 and np.all(np.diff(self.sequence) > 0)  # by one publisher
        return self._replace(sequence=self.sequence - numbered * np.cumsum(~chosen)).pick(chosen)

    def pick(self, chosen: npt.NDArray[Any]) -> "Series":
        """The messages chosen by a mask or by indices."""
        where = np.arange(len(self.log_time))[chosen].tolist() if self.raw else []
        return self._replace(
            log_time=self.log_time[chosen],
            publish_time=self.publish_time[chosen],
            sequence=self.sequence[chosen],
            place=self.place[chosen],
            values={name: numbers[chosen] for name, numbers in self.values.items()},
            present={name: mask[chosen] for name, mask in self.present.items()},
            raw=[self.raw[i] for i in where],
        )


def stretch(time: Integers) -> tuple[int, int]:
    """First and last of ``time`` [ns] in that of its stretches, hours apart, with the most messages."""
    ordered = np.sort(time)
    starts = np.flatnonzero(np.diff(ordered.astype(np.float64)) > FAR * 1e9) + 1
    bounds = [0, *starts.tolist(), len(ordered)]
    longest = len(bounds) - 2 - int(np.argmax(np.diff(bounds)[::-1]))
    return int(ordered[bounds[longest]]), int(ordered[bounds[longest + 1] - 1])


class Bag:
    """An open bag with its topics and files.

    Raises BagError if nothing of it can be read; what is wrong with a part of it is in ``problems``.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.problems: list[str] = []
        self.topics: dict[str, Topic] = {}
        self.storage = ""
        self.listing = bag_metadata.Listing()
        self._unpacked: tempfile.TemporaryDirectory[str] | None = None
        try:
            self._files = self._open()
        except OSError as error:
            raise BagError(
                f"{error.filename or self.path} cannot be read: {error.strerror or error}"
            ) from error
        for file in self._files:
            self.problems += file.problems
            for topic in file.topics:
                known = self.topics.setdefault(topic.name, topic)
                if not self._is_known(topic):
                    one, other = (f"{t.type} ({t.encoding})" for t in (known, topic))
                    self._complain(f"{topic.name} is {one} and {other}; the second is left out")
        if not self.topics:
            reasons = f": {'; '.join(self.problems)}" if self.problems else ""
            self.close()
            raise BagError(f"{self.path} has no topics that can be read{reasons}")

    @property
    def table(self) -> TableFile | None:
        """The table that is read as a bag, None of others."""
        return next((file for file in self._files if isinstance(file, TableFile)), None)

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.size for file in self._files)

    @property
    def files(self) -> list[str]:
        """Names of the data files."""
        return [file.path.name for file in self._files]

    @property
    def compression(self) -> str:
        """``file`` or ``message`` for a bag that rosbag2 compressed, "" for others."""
        return self.listing.compression or ("file" if self._unpacked is not None else "")

    @property
    def begin(self) -> int:
        """Log time [ns] of the first message, 0 if there are none; not of one hours from all near it."""
        if self.table is not None:
            return min((int(time[0]) for _, time in self.table.times if len(time)), default=0)
        firsts = filter(None, map(_first_block, self._files))
        return min((stretch(block.log_time)[0] for block in firsts), default=0)

    @property
    def damaged(self) -> int:
        """Number of places that were left out, of those read so far: of chunks in MCAP files."""
        return sum(len(file.damaged) for file in self._files)

    def close(self) -> None:
        """Close the files; nothing can be read afterwards."""
        for file in self._files:
            file.close()
        if self._unpacked is not None:
            self._unpacked.cleanup()

    # Reading

    def blocks(self, topics: Collection[str]) -> Iterator[tuple[str, Block]]:
        """Yield messages of ``topics`` in blocks, each of one topic."""
        for names, block in self._parts(topics):
            for i in np.flatnonzero(np.bincount(block.topic)).tolist():
                if names[i]:
                    yield names[i], self._decompressed(block.select(block.topic == i))

    def in_file_order(self) -> Iterator[tuple[str, int, int, int, bytes]]:
        """Yield topic, log time [ns], publish time [ns], number and content of all messages."""
        for names, block in self._parts(self.topics):
            part = self._decompressed(block)
            columns = zip(*(column.tolist() for column in part[1:5]), part.contents(), strict=True)
            yield from ((names[topic], *rest) for topic, *rest in columns if names[topic])

    def _parts(self, topics: Collection[str]) -> Iterator[tuple[list[str], Block]]:
        """Yield all messages, and the names of the topics of their file, "" but for ``topics``."""
        before = 0
        for file in self._files:
            names = [t.name if t.name in topics and self._is_known(t) else "" for t in file.topics]
            for block in file.blocks():
                if len(block.topic):
                    block = block._replace(place=before + block.place)
                    before = int(block.place[-1]) + 1
                    yield names, block
            for problem in file.problems:
                self._complain(problem)

    def read(
        self,
        fields: Mapping[str, Sequence[str]],
        raw: Collection[str] = (),
        start: int | None = None,
        end: int | None = None,
    ) -> dict[str, Series]:
        """Read numeric ``fields`` of topics, and whole messages of the topics in ``raw``.

        ``start``, ``end`` [ns]: log times of what is kept; whole messages count from the bag's beginning.
        Raises BagError if there is no such topic, or its type is unknown.
        """
        if self.table is not None:
            return {name: self._column(name, names, start, end) for name, names in fields.items()}
        collected = {
            name: _Collector(self.topic(name), fields.get(name, ()), name in raw)
            for name in dict.fromkeys([*fields, *sorted(raw)])
        }
        last = np.inf if end is None else end
        for name, block in self.blocks(collected):
            since = -np.inf if start is None or name in raw else start
            inside = (block.log_time >= since) & (block.log_time < last)
            collected[name].take(block.select(inside))
        return {name: collector.series() for name, collector in collected.items()}

    def _column(self, name: str, fields: Sequence[str], start: int | None, end: int | None) -> Series:
        """Values of a column of a table as messages, each row at its place; empty cells are none."""
        assert self.table is not None
        if set(fields) != {"data"}:
            raise BagError(f"{name} is a column of {self.path}, which has no {', '.join(fields)}")
        rows, time = self.table.row_times(name)
        values = self.table.columns[self.table.topics.index(self.topic(name))].values[rows]
        chosen = ~np.isnan(values) & (time >= (-np.inf if start is None else start))
        chosen &= time < (np.inf if end is None else end)
        place, time, values = rows[chosen], time[chosen], values[chosen]
        numbers = np.zeros(len(time), dtype=np.int64)
        return Series(time, time, numbers, place, {"data": values}, {}, [], 0, "", {})

    def topic(self, name: str) -> Topic:
        """Topic ``name``. Raises BagError if there is none."""
        if name not in self.topics:
            raise BagError(f"{self.path} has no topic {name}; it has {', '.join(sorted(self.topics))}")
        return self.topics[name]

    def messages(self, name: str) -> Iterator[bytes]:
        """Yield messages of a topic from its beginning, read only as they are asked for."""
        for _, block in self.blocks([name]):
            yield from block.contents()

    # How

    def _open(self) -> "list[File]":
        if not self.path.exists():
            raise BagError(f"there is no bag {self.path}")
        if self.path.is_file():
            return [self._file(self.path)]
        if not self.path.is_dir():
            raise BagError(f"{self.path} is neither a file nor a folder; a bag is one of them")
        files: list[File] = []
        refused = []
        for path in self._listed():
            try:
                files.append(self._file(path))
            except (BagError, OSError) as error:
                refused.append(str(error))
        if not files:
            raise BagError("; ".join(refused))
        self.problems += [f"{text}, it is left out" for text in refused]
        return sorted(files, key=_begin) if len(files) > 1 else files

    def _listed(self) -> list[Path]:
        """Files of the bag by its metadata.yaml, or else those in its folder."""
        found = [path for path in self.path.iterdir() if _plain_suffix(path) in KINDS]
        found.sort(key=lambda path: (len(path.name), path.name))
        if not (self.path / bag_metadata.NAME).exists():
            if not found:
                raise BagError(
                    f"{self.path} is not a bag: it has neither metadata.yaml nor .mcap nor .db3 files"
                )
            self._complain(
                f"{self.path} is unfinished: it has no metadata.yaml (valve-control bag recover writes a "
                "finished copy)"
            )
            return found
        try:
            self.listing = bag_metadata.read(self.path)
        except BagError as error:
            self._complain(
                f"{error}; it is not used (valve-control bag recover writes a copy with a new one)"
            )
            return found
        paths = [self.path / name for name in self.listing.files]
        for path in sorted({*paths, *found}):
            if not path.exists():
                self._complain(f"{path.name}, which metadata.yaml names, is missing")
            elif path not in paths:
                self._complain(
                    f"{path.name} lies in the folder, but metadata.yaml does not list it: not read"
                )
        present = [path for path in paths if path.exists()]
        if not present:
            raise BagError(f"{self.path} has none of the files that its metadata.yaml names")
        return present

    def _is_known(self, topic: Topic) -> bool:
        known = self.topics[topic.name]
        return (known.type, known.encoding) == (topic.type, topic.encoding)

    def _file(self, path: Path) -> "File":
        suffix = _plain_suffix(path)
        if path.suffix.lower() in TABLES:
            self.storage = TABLES[path.suffix.lower()][0]
            return TableFile(path)
        if suffix not in KINDS:
            raise BagError(
                f"{path} is not a bag; a bag is a folder with metadata.yaml, an .mcap or a .db3 file, or a "
                f"table of numbers ({', '.join(TABLES)})"
            )
        with path.open("rb") as stream:
            if stream.read(len(POINTER)) == POINTER:
                raise BagError(f"{path} is a Git LFS pointer, not the file itself; run git lfs pull")
        self.storage = KINDS[suffix]
        plain = self._unpack(path) if path.suffix in ZSTD else path
        if self.storage == "sqlite3":
            return SqliteFile(plain)
        from valve_control.recordings.bags.mcap_reader import McapFile

        return McapFile(plain)

    def _unpack(self, path: Path) -> Path:
        import zstandard

        if self._unpacked is None:
            self._unpacked = tempfile.TemporaryDirectory(prefix="valve_control-")
        plain = Path(self._unpacked.name) / path.stem
        try:
            with path.open("rb") as packed, plain.open("wb") as stream:
                zstandard.ZstdDecompressor().copy_stream(packed, stream)
        except zstandard.ZstdError as error:
            self._complain(f"{path} cannot be decompressed to its end: {error}")
        return plain

    def _decompressed(self, block: Block) -> Block:
        """``block``, whose messages rosbag2 may have compressed, with the messages as they were sent."""
        if not next(block.contents()).startswith(ZSTD_MAGIC):
            return block
        import zstandard

        decompress = zstandard.ZstdDecompressor().decompressobj
        parts, good = [], np.ones(len(block.topic), dtype=np.bool_)
        for i, content in enumerate(block.contents()):
            try:
                parts.append(decompress().decompress(content))
            except zstandard.ZstdError as error:
                good[i] = False
                self._complain(f"messages of {self.path} cannot be decompressed and are left out: {error}")
        length = np.array([len(part) for part in parts], dtype=np.int64)
        kept = block.select(good)
        return kept._replace(
            buffer=np.frombuffer(b"".join(parts), dtype=np.uint8),
            offset=np.cumsum(length) - length,
            length=length,
        )

    def _complain(self, text: str) -> None:
        if text not in self.problems:
            self.problems.append(text)


def _plain_suffix(path: Path) -> str:
    return Path(path.stem).suffix if path.suffix in ZSTD else path.suffix


def _first_block(file: "File") -> Block | None:
    """The first messages of a file, None if it has none."""
    return next((block for block in file.blocks() if len(block.topic)), None)


def _begin(file: "File") -> int:
    """Log time [ns] of the first message of a file; files without one come last."""
    block = _first_block(file)
    return 2**63 if block is None else int(block.log_time[0])


class _Collector:
    """Collects the columns of one topic, block by block."""

    def __init__(self, topic: Topic, fields: Sequence[str], raw: bool) -> None:
        # Each field has a decoder: messages of one publisher may have one, those of another the other.
        self._decoders = [Decoder(topic, field) for field in fields]
        self._fields = fields
        self._keep_raw = raw
        self._raw: list[bytes] = []
        # Piece by piece: log time, publish time, sequence, place; fields; which messages have these.
        kinds = [np.int64] * 4 + [np.float64] * len(fields) + [np.bool_] * len(fields)
        self._columns: list[list[npt.NDArray[Any]]] = [[np.empty(0, dtype=kind)] for kind in kinds]

    def take(self, block: Block) -> None:
        found = [one.decode(block.buffer, block.offset, block.length) for one in self._decoders]
        if self._keep_raw:
            self._raw += block.contents()
        columns = (*block[2:6], *(values for values, _ in found), *(mask for _, mask in found))
        for pieces, column in zip(self._columns, columns, strict=True):
            pieces.append(column.copy())

    def series(self) -> Series:
        log, publish, sequence, place, *rest = map(_joined, self._columns)
        values, masks = rest[: len(self._fields)], rest[len(self._fields) :]
        decoded = list(zip(self._fields, self._decoders, masks, strict=True))
        series = Series(
            log_time=log,
            publish_time=publish,
            sequence=sequence,
            place=place,
            values=dict(zip(self._fields, values, strict=True)),
            present={field: mask for field, _, mask in decoded if not mask.all()},
            raw=self._raw,
            undecodable=sum(int(np.count_nonzero(~mask)) - one.absent for _, one, mask in decoded[:1]),
            error="".join(one.error for _, one, _ in decoded[:1]),
            absent={field: one.absent for field, one, _ in decoded if one.absent},
        )
        return series.only(np.logical_or.reduce(masks)) if masks else series


def _joined(pieces: list[npt.NDArray[Any]]) -> npt.NDArray[Any]:
    """One array made of ``pieces``, whose memory is released."""
    array = np.concatenate(pieces)
    pieces.clear()
    return array
