"""Opens a bag from any recorder: a folder with or without metadata.yaml, or a single file."""

import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import zstandard

from valve_control.bags import metadata as bag_metadata
from valve_control.bags.cdr import Decoder
from valve_control.bags.errors import BagError
from valve_control.bags.mcap import McapFile
from valve_control.bags.messages import Block, Integers, Topic
from valve_control.bags.sqlite import SqliteFile

Floats = npt.NDArray[np.float64]
KINDS: dict[str, tuple[str, type[McapFile] | type[SqliteFile]]] = {
    ".mcap": ("mcap", McapFile),
    ".db3": ("sqlite3", SqliteFile),
}
ZSTD = (".zstd", ".zst")
MANY = 500_000  # messages that are kept of a sparse topic


class Series(NamedTuple):
    """Messages of one topic in the order in which they were recorded."""

    log_time: Integers  # ns
    publish_time: Integers  # ns, the log time where the bag has none
    sequence: Integers  # of the publisher, 0 where the bag has none
    values: dict[str, Floats]  # by field
    raw: list[bytes]  # the messages themselves, if they were asked for
    undecodable: int  # messages left out
    error: str  # why the first of them


class Bag:
    """An open bag with its topics and files.

    Raises BagError if nothing of it can be read; what is wrong with a part of it is in ``problems``.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.problems: list[str] = []
        self.topics: dict[str, Topic] = {}
        self.storage = ""
        self.compression = ""  # of files or messages, as in metadata.yaml
        self.version: int | None = None  # of metadata.yaml
        self.distribution = ""
        self._unpacked: tempfile.TemporaryDirectory[str] | None = None
        self._files = self._open()
        for file in self._files:
            self.problems += file.problems
            for topic in file.topics:
                known = self.topics.setdefault(topic.name, topic)
                if known.type != topic.type:
                    self._complain(
                        f"{topic.name} has two types, {known.type} and {topic.type}; the second is left out"
                    )
        if not self.topics:
            reasons = f": {'; '.join(self.problems)}" if self.problems else ""
            self.close()
            raise BagError(f"{self.path} has no topics that can be read{reasons}")

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.size for file in self._files)

    @property
    def files(self) -> list[str]:
        """Names of the data files."""
        return [file.path.name for file in self._files]

    @property
    def begin(self) -> int:
        """Log time [ns] of the first message, 0 if there are none."""
        # A piece may hold nothing: messages of channels that a damaged file does not describe.
        firsts = (next((b for b in file.blocks() if len(b.topic)), None) for file in self._files)
        return min((int(block.log_time.min()) for block in firsts if block is not None), default=0)

    def close(self) -> None:
        """Close the files; nothing can be read afterwards."""
        for file in self._files:
            file.close()

    # Reading

    def blocks(
        self,
        topics: Collection[str],
        start: int | None = None,
        end: int | None = None,
        told: Callable[[int], None] | None = None,
    ) -> Iterator[tuple[str, Block]]:
        """Yield messages of ``topics`` in blocks, each of one topic; ``start``, ``end`` [ns]: log times."""
        for file in self._files:
            names = [t.name if self.topics[t.name].type == t.type else "" for t in file.topics]
            wanted = [i for i, name in enumerate(names) if name in topics]
            for block in file.blocks(start, end, told):
                for i in wanted:
                    chosen = np.flatnonzero(block.topic == i)
                    if len(chosen) == 0:
                        continue
                    part = block if len(chosen) == len(block.topic) else block.select(chosen)
                    yield names[i], self._decompressed(part) if self.compression == "message" else part
            for problem in file.problems:
                self._complain(problem)

    def read(
        self,
        fields: Mapping[str, Sequence[str]],
        raw: Collection[str] = (),
        sparse: Collection[str] = (),
        start: int | None = None,
        end: int | None = None,
        told: Callable[[int], None] | None = None,
    ) -> dict[str, Series]:
        """Read numeric ``fields`` of topics, and whole messages of the topics in ``raw``.

        Of topics in ``sparse`` only every second, fourth, ... message is kept once there are many, and fields
        that a message does not have are NaN. ``told`` is called with the number of bytes read since its
        last call. Raises BagError if there is no such topic, or its type is unknown.
        """
        collected = {
            name: _Collector(self.topic(name), fields.get(name, ()), name in raw, name in sparse)
            for name in {*fields, *raw}
        }
        for name, block in self.blocks(collected, start, end, told):
            collected[name].take(block)
        return {name: collector.series() for name, collector in collected.items()}

    def topic(self, name: str) -> Topic:
        """Topic ``name``. Raises BagError if there is none."""
        if name not in self.topics:
            raise BagError(f"{self.path} has no topic {name}; it has {', '.join(sorted(self.topics))}")
        return self.topics[name]

    def first(self, name: str) -> bytes | None:
        """First message of a topic, None if it has none."""
        return next(self.messages(name), None)

    def messages(self, name: str) -> Iterator[bytes]:
        """Yield messages of a topic from its beginning, read only as they are asked for."""
        for _, block in self.blocks([name]):
            for at, size in zip(block.offset.tolist(), block.length.tolist(), strict=True):
                yield block.buffer[at : at + size].tobytes()

    # How

    def _open(self) -> list[McapFile | SqliteFile]:
        if not self.path.exists():
            raise BagError(f"there is no bag {self.path}")
        if self.path.is_file():
            return [self._file(self.path)]
        paths = self._listed() if (self.path / "metadata.yaml").exists() else self._found()
        files: list[McapFile | SqliteFile] = []
        refused = []
        for path in paths:
            try:
                files.append(self._file(path))
            except (BagError, OSError) as error:
                text = (
                    str(error) if isinstance(error, BagError) else f"{path} cannot be read: {error.strerror}"
                )
                refused.append(text)
        if not files:
            raise BagError("; ".join(refused))
        self.problems += [f"{text}, it is left out" for text in refused]
        return files

    def _listed(self) -> list[Path]:
        try:
            told = bag_metadata.read(self.path)
        except bag_metadata.UnknownVersionError:
            raise
        except BagError as error:
            self._complain(f"{error}; it is not used (valve-control bag recover writes it anew)")
            return self._found(complain=False)
        self.version = told.version
        self.distribution = told.ros_distro
        self.compression = told.compression_mode.lower() if told.compression_mode.lower() != "none" else ""
        if self.compression and told.compression_format != "zstd":
            raise BagError(f"{self.path} is compressed with {told.compression_format!r}; zstd is known")
        paths = [self.path / Path(name).name for name in told.relative_file_paths]
        missing = [path for path in paths if not path.exists()]
        for path in missing:
            self._complain(f"{path.name}, which metadata.yaml names, is missing")
        if len(missing) == len(paths):
            raise BagError(f"{self.path} has none of the files that its metadata.yaml names")
        return [path for path in paths if path.exists()]

    def _found(self, complain: bool = True) -> list[Path]:
        paths = [p for p in self.path.iterdir() if _plain_suffix(p) in KINDS]
        if not paths:
            raise BagError(f"{self.path} is not a bag: it has neither metadata.yaml nor .mcap nor .db3 files")
        if complain:
            self._complain(
                f"{self.path} is unfinished: it has no metadata.yaml "
                "(valve-control bag recover makes it whole)"
            )
        return sorted(paths, key=lambda p: (len(p.name), p.name))

    def _file(self, path: Path) -> McapFile | SqliteFile:
        suffix = _plain_suffix(path)
        if suffix not in KINDS:
            raise BagError(
                f"{path} is not a bag; a bag is a folder with metadata.yaml, an .mcap or a .db3 file"
            )
        self.storage, kind = KINDS[suffix]
        return kind(self._unpack(path) if path.suffix in ZSTD else path)

    def _unpack(self, path: Path) -> Path:
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
        decompress = zstandard.ZstdDecompressor().decompressobj
        parts, good = [], []
        for i, (at, size) in enumerate(zip(block.offset.tolist(), block.length.tolist(), strict=True)):
            try:
                parts.append(decompress().decompress(block.buffer[at : at + size].tobytes()))
                good.append(i)
            except zstandard.ZstdError as error:
                self._complain(f"messages of {self.path} cannot be decompressed and are left out: {error}")
        length = np.array([len(part) for part in parts], dtype=np.int64)
        kept = block.select(np.array(good, dtype=np.int64))
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


class _Collector:
    """Collects the columns of one topic, block by block."""

    def __init__(self, topic: Topic, fields: Sequence[str], raw: bool, sparse: bool) -> None:
        self._decoder = Decoder(topic, fields, optional=sparse) if fields else None
        self._sparse = sparse
        self._stride, self._seen, self._kept = 1, 0, 0
        self._fields = tuple(fields)
        self._keep_raw = raw
        # Piece by piece: log time, publish time, sequence, fields.
        self._integers: list[list[Integers]] = [[], [], []]
        self._floats: list[list[Floats]] = [[] for _ in fields]
        self._raw: list[bytes] = []
        self._undecodable = 0

    def take(self, block: Block) -> None:
        if self._sparse:
            block = self._thinned(block)
        values = np.empty((len(block.topic), 0))
        if self._decoder is not None:
            values, done = self._decoder.decode(block.buffer, block.offset, block.length)
            if not done.all():
                self._undecodable += int(np.count_nonzero(~done))
                block, values = block.select(done), values[done]
        if self._keep_raw:
            for at, size in zip(block.offset.tolist(), block.length.tolist(), strict=True):
                self._raw.append(block.buffer[at : at + size].tobytes())
        for pieces, column in zip(self._integers, block[2:5], strict=True):
            pieces.append(column.copy())
        for k, numbers in enumerate(self._floats):
            numbers.append(values[:, k].copy())

    def _thinned(self, block: Block) -> Block:
        """Every ``stride``-th message, counted from the first of the topic."""
        count = len(block.topic)
        while self._kept + count // self._stride > MANY and self._stride < count:
            self._stride *= 2
            for times in self._integers:
                times[:] = [_joined(times, np.int64)[::2]]
            for numbers in self._floats:
                numbers[:] = [_joined(numbers, np.float64)[::2]]
            self._kept = len(self._integers[0][0])
        chosen = np.arange(-self._seen % self._stride, count, self._stride)
        self._seen += count
        self._kept += len(chosen)
        return block.select(chosen)

    def series(self) -> Series:
        log, publish, sequence = (_joined(pieces, np.int64) for pieces in self._integers)
        numbers = [_joined(pieces, np.float64) for pieces in self._floats]
        return Series(
            log,
            publish,
            sequence,
            dict(zip(self._fields, numbers, strict=True)),
            self._raw,
            self._undecodable,
            self._decoder.error if self._decoder is not None else "",
        )


def _joined(pieces: list[npt.NDArray[Any]], kind: Any) -> npt.NDArray[Any]:
    """One array made of ``pieces``, whose memory is released."""
    array = np.concatenate([np.empty(0, dtype=kind), *pieces])
    pieces.clear()
    return array
