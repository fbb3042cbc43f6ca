# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Decodes numeric fields of serialized ROS messages (CDR), thousands of messages at once.

Where a field lies depends only on the lengths of the strings and sequences before it. A layout is found by
walking through one message; it holds for every message of the same size with the same lengths at the same
places, which is all of them for most topics.
"""

import functools
import re
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from valve_control.arrays import Bytes, Floats, Integers
from valve_control.control.compiling import compile_function
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.messages import Topic, full_type

SIZES = {
    "bool": 1, "octet": 1, "byte": 1, "char": 1, "int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4,
    "uint32": 4, "int64": 8, "uint64": 8, "float32": 4, "float64": 8,
}  # fmt: skip
KINDS = {"bool": "u1", "octet": "u1", "byte": "u1", "char": "u1"} | {
    name: {"i": "i", "u": "u", "f": "f"}[name[0]] + str(size)
    for name, size in SIZES.items()
    if name[0] in "iuf"
}
PART = re.compile(r"\.?([A-Za-z_][A-Za-z0-9_]*)|\[([^\]]*)\]")
HEADER = 4  # bytes before the message proper
EMPTY = "structure_needs_at_least_one_member"  # a byte that stands in messages without fields
HOPELESS = 100  # undecodable messages of one size in a block after which the rest is not tried
UNDECODABLE = (SerdeError, struct.error, ValueError, IndexError)  # what rosbags raises for damaged messages


class AbsentError(BagError):
    """A sound message does not have a number that is asked for; ``labels``: those that it has."""

    def __init__(self, text: str, labels: Sequence[str] = ()) -> None:
        super().__init__(f"{text}; its labels are {', '.join(labels)}" if labels else text)
        self.text = text
        self.labels = tuple(labels)


class Leaf(NamedTuple):
    """Consecutive numbers of one type in a message."""

    offset: int
    kind: str  # of numpy, without byte order
    entries: int  # of a sequence or array
    single: bool


class Layout(NamedTuple):
    """Offsets of the fields in messages of one size."""

    where: Integers  # bytes that decide about the layout ...
    expected: Bytes  # ... and what stands there
    sources: Integers  # offset of each field
    sizes: Integers
    kinds: tuple[str, ...]  # of numpy
    absent: AbsentError | None = None  # why the fields are not there


class _Walk:
    """Walks once through one message and notes where each field lies."""

    def __init__(self, types: Any, name: str, message: bytes) -> None:
        if len(message) < HEADER or message[0] != 0 or message[1] > 1:
            raise BagError(f"a message of type {name} is not plain CDR")
        self.order = "<" if message[1] == 1 else ">"
        self.message = message
        self.at = HEADER
        self.leaves: dict[str, Leaf] = {}
        self.strings: dict[str, tuple[int, int]] = {}
        self.lengths: list[int] = [0, 1]  # bytes that decide
        self._types = types
        self._message_type(name, "")

    def _align(self, size: int) -> None:
        self.at = HEADER + -(-(self.at - HEADER) // size) * size

    def _length(self) -> int:
        self._align(4)
        (value,) = struct.unpack_from(self.order + "I", self.message, self.at)
        self.lengths += range(self.at, self.at + 4)
        self.at += 4
        return int(value)

    def _message_type(self, name: str, path: str) -> None:
        for field, description in self._types[name][1]:
            self._field(description, f"{path}.{field}" if path else field)

    def _field(self, description: Any, path: str) -> None:
        node, detail = description
        if node == Nodetype.BASE:
            self._several(description, path, 1, single=True)
        elif node == Nodetype.NAME:
            self._message_type(detail, path)
        else:
            inner, count = detail
            if node == Nodetype.SEQUENCE:
                count = self._length()
                if count > len(self.message):
                    raise BagError(
                        f"a message says that its {path} has {count} entries, more than it has bytes"
                    )
            self._several(inner, path, count, single=False)

    def _several(self, description: Any, path: str, count: int, single: bool) -> None:
        node, detail = description
        if node == Nodetype.NAME:
            for i in range(count):
                self._message_type(detail, f"{path}[{i}]")
        elif detail[0] in ("string", "wstring"):
            for i in range(count):
                size = self._length()
                self.strings[path if single else f"{path}[{i}]"] = (self.at, size)
                self.at += size
        else:
            size = SIZES[detail[0]]
            if count > 0:
                self._align(size)
            if path.rpartition(".")[2] != EMPTY:
                self.leaves[path] = Leaf(self.at, KINDS[detail[0]], count, single)
            self.at += size * count
        if self.at > len(self.message):
            raise BagError(f"a message ends in the middle of its {path}")

    def text(self, path: str) -> str:
        """The string at ``path``."""
        at, size = self.strings[path]
        return self.message[at : at + size].rstrip(b"\0").decode(errors="replace")

    def labels(self, path: str) -> list[str]:
        """Paths of the strings that name the entries of the sequence at ``path``."""
        parent, dot, _ = path.rpartition(".")
        found = [
            p for p in self.strings if re.fullmatch(rf"{re.escape(parent + dot)}layout\.dim\[\d+\]\.label", p)
        ]
        return found or [
            p for p in self.strings if re.fullmatch(rf"{re.escape(parent + dot)}names?\[\d+\]", p)
        ]

    def find(self, field: str) -> Leaf:
        """The single number that ``field`` names. Raises BagError, and AbsentError if others may have it."""
        path, index = normal(field)
        leaf = self.leaves.get(path)
        if leaf is None:
            numbers = [name if entry.single else f"{name}[0]" for name, entry in self.leaves.items()]
            raise AbsentError(f"there is no number '{field}'; there is {', '.join(numbers[:12]) or 'none'}")
        if index is None:
            if not leaf.single:
                raise BagError(f"{field} is a list; write {field}[0] for its first entry")
            return leaf
        number = self._index(path, index)
        if leaf.single or not 0 <= number < leaf.entries:
            has = "is a single number" if leaf.single else f"has {leaf.entries} entries"
            raise AbsentError(f"there is no {field}: {path} {has}")
        size = int(leaf.kind[1:])
        return Leaf(leaf.offset + number * size, leaf.kind, 1, True)

    def _index(self, path: str, index: str) -> int:
        if index.isdigit():
            return int(index)
        labels = self.labels(path)
        for i, place in enumerate(labels):
            at, size = self.strings[place]
            self.lengths += range(at, at + size)
            if self.text(place) == index:
                return i
        if not labels:
            raise AbsentError(f"there is no {path}[{index}]; it has no labels")
        raise AbsentError(f"there is no {path}[{index}]", [self.text(place) for place in labels])


def normal(field: str) -> tuple[str, str | None]:
    """``field`` as the path of its numbers and the index or label at its end, if any. Raises BagError."""
    parts = PART.findall(field)
    rebuilt = "".join(f".{name}" if name else f"[{index}]" for name, index in parts).lstrip(".")
    if not parts or rebuilt != field.lstrip("."):
        raise BagError(f"'{field}' is not a field; write it like position[0], data or twist.linear.x")
    if parts[-1][0]:
        return rebuilt, None
    return rebuilt[: -len(parts[-1][1]) - 2], parts[-1][1]


@functools.cache
def jazzy() -> Typestore:
    """Message types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def deserialized(raw: bytes, kind: str) -> Any:
    """The message of type ``kind`` of ROS 2 Jazzy, None if it cannot be decoded.

    What rclpy serializes may have bytes to spare at its end.
    """
    if len(raw) < HEADER or raw[0] != 0 or raw[1] > 1:
        return None
    definition = jazzy().get_msgdef(kind)
    decode = definition.deserialize_cdr_le if raw[1] else definition.deserialize_cdr_be
    try:
        return decode(raw[HEADER:], 0, definition.cls, jazzy())[0]
    except UNDECODABLE:
        return None


def types_of(topic: Topic) -> Any:
    """Field definitions for the topic's type: the bag's own, completed by those of ROS 2 Jazzy.

    Where the bag's own are not complete even so, those of Jazzy alone. Raises BagError.
    """
    if topic.unreadable:
        raise BagError(topic.unreadable)
    known = jazzy().fielddefs
    own = known | _defined(topic)
    missing = _missing(own, topic.type)
    if not missing:
        return own
    if topic.type not in known:
        has = f"a definition that lacks {missing}" if topic.type in own else "no definition"
        raise BagError(f"{topic.name} has the type {topic.type}, of which the bag has {has}")
    return known


def _defined(topic: Topic) -> dict[str, Any]:
    """Field definitions that the bag has for the topic, {} if they cannot be read."""
    store = get_typestore(Stores.EMPTY)
    try:
        if topic.definition_format.endswith("idl"):
            store.register(get_types_from_idl(topic.definition))
        elif topic.definition:
            store.register(get_types_from_msg(topic.definition, topic.type))
    except Exception:  # the parser raises what it meets
        return {}
    return {alias: fields for name, fields in store.fielddefs.items() for alias in (name, full_type(name))}


def _missing(types: Any, name: str, above: tuple[str, ...] = ()) -> str:
    """The first type in ``name`` that ``types`` lacks, or that contains itself; "" if there is none."""
    if name not in types or name in above:
        return name
    for _, description in types[name][1]:
        node, detail = description
        if node not in (Nodetype.BASE, Nodetype.NAME):
            node, detail = detail[0]
        missing = _missing(types, detail, (*above, name)) if node == Nodetype.NAME else ""
        if missing:
            return missing
        if node == Nodetype.BASE and detail[0] not in (*SIZES, "string", "wstring"):
            return str(detail[0])
    return ""


def _gather(
    buffer: Any, offsets: Any, where: Any, expected: Any, sources: Any, sizes: Any, out: Any, fits: Any
) -> None:
    """Copy the fields (n×m×8 bytes) of those messages that have the layout."""
    for i in range(offsets.shape[0]):
        base = offsets[i]
        fit = True
        for j in range(where.shape[0]):
            if buffer[base + where[j]] != expected[j]:
                fit = False
                break
        fits[i] = fit
        if fit:
            for k in range(sources.shape[0]):
                for byte in range(sizes[k]):
                    out[i, k, byte] = buffer[base + sources[k] + byte]


class Decoder:
    """Takes the numbers ``fields`` out of the messages of one topic.

    With ``optional``, a field that a message does not have is NaN; otherwise that message is left out, and
    counted in ``absent``. Raises BagError if the topic's type is unknown.
    """

    def __init__(self, topic: Topic, fields: Sequence[str], optional: bool = False) -> None:
        self.topic = topic
        self.fields = tuple(fields)
        self._optional = optional
        self.error = ""  # why the first message that could not be decoded could not
        self.absent = 0  # sound messages that do not have all fields
        self.absence: AbsentError | None = None  # with the labels that they have
        self._types = types_of(topic)
        self._layouts: dict[int, list[Layout]] = {}

    def labels(self, message: bytes, path: str = "data") -> list[str]:
        """Names of the entries of a labelled sequence, [] if it has none."""
        walk = _Walk(self._types, self.topic.type, message)
        return [walk.text(place) for place in walk.labels(path)]

    def numbers(self, message: bytes) -> dict[str, Leaf]:
        """All numbers of a message by their path."""
        return _Walk(self._types, self.topic.type, message).leaves

    def decode(
        self, buffer: Bytes, offset: Integers, length: Integers
    ) -> tuple[Floats, npt.NDArray[np.bool_]]:
        """Fields (n×m) of the messages, and a mask of those that could be decoded."""
        if len(length) and length[0] == length.min() == length.max() and self._layouts.get(int(length[0])):
            layout = self._layouts[int(length[0])][0]
            fits, values = self._take(layout, buffer, offset)
            if fits.all() and layout.absent is None:
                return values, fits
        result = np.full((len(offset), len(self.fields)), np.nan)
        done = np.zeros(len(offset), dtype=np.bool_)
        for size in np.unique(length).tolist():
            left = np.flatnonzero(length == size)
            tried, failed = 0, 0
            while len(left) > 0 and failed < HOPELESS:
                known = self._layouts.setdefault(size, [])
                if tried == len(known):
                    start = int(offset[left[0]])
                    try:
                        known.append(self._any_layout(buffer[start : start + size].tobytes()))
                    except (BagError, struct.error, KeyError) as error:
                        self.error = self.error or str(error)
                        left = left[1:]
                        failed += 1
                        continue
                fits, values = self._take(known[tried], buffer, offset[left])
                if known[tried].absent is None:
                    result[left[fits]] = values[fits]
                    done[left[fits]] = True
                else:
                    self.absent += int(np.count_nonzero(fits))
                left = left[~fits]
                tried += 1
        return result, done

    def layout(self, message: bytes) -> Layout:
        """Layout of messages like this one. Raises BagError if a field is not there."""
        layout = self._any_layout(message)
        if layout.absent is not None:
            raise layout.absent
        return layout

    def _any_layout(self, message: bytes) -> Layout:
        """Likewise, or a layout of messages that do not have all fields."""
        walk = _Walk(self._types, self.topic.type, message)
        leaves: list[Leaf] = []
        absent = None
        try:
            leaves += [self._find(walk, field) for field in self.fields]
        except AbsentError as error:
            absent, before = error, self.absence
            known = (*before.labels, *error.labels) if before is not None else error.labels
            self.absence = AbsentError((before or error).text, tuple(dict.fromkeys(known)))
        where = np.array(sorted(set(walk.lengths)), dtype=np.int64)
        return Layout(
            where,
            np.frombuffer(message, dtype=np.uint8)[where],
            np.array([leaf.offset for leaf in leaves], dtype=np.int64),
            np.array([leaf.entries * int(leaf.kind[1:]) for leaf in leaves], dtype=np.int64),
            tuple(walk.order + leaf.kind for leaf in leaves),
            absent,
        )

    def _find(self, walk: _Walk, field: str) -> Leaf:
        try:
            return walk.find(field)
        except BagError:
            if self._optional:
                return Leaf(0, "f8", 0, True)
            raise

    def _take(self, layout: Layout, buffer: Bytes, offset: Integers) -> tuple[npt.NDArray[np.bool_], Floats]:
        raw = np.empty((len(offset), len(layout.kinds), 8), dtype=np.uint8)
        fits = np.empty(len(offset), dtype=np.bool_)
        compile_function(_gather)(
            buffer, offset, layout.where, layout.expected, layout.sources, layout.sizes, raw, fits
        )
        values = np.empty((len(offset), len(layout.kinds)))
        for k, kind in enumerate(layout.kinds):
            if layout.sizes[k] == 0:
                values[:, k] = np.nan
                continue
            values[:, k] = np.ascontiguousarray(raw[:, k, : layout.sizes[k]]).view(kind)[:, 0]
        return fits, values
