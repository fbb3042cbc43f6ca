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
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from valve_control.arrays import Bytes, Floats, Integers
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.messages import Topic, full_type

KINDS = dict.fromkeys(("bool", "octet", "byte", "char"), "u1") | {
    f"{word}{8 * size}": f"{word[0]}{size}" for word in ("int", "uint", "float") for size in (1, 2, 4, 8)
}
PART = re.compile(r"\.?([A-Za-z_][A-Za-z0-9_]*)|\[([^\]]*)\]")
HEADER = 4  # bytes before the message proper
EMPTY = "structure_needs_at_least_one_member"  # a byte that stands in messages without fields
HOPELESS = 100  # undecodable messages of one size in a block after which the rest is not tried
UNDECODABLE = (SerdeError, struct.error, ValueError, IndexError)  # what rosbags raises for damaged messages


class AbsentError(BagError):
    """A sound message does not have a number that is asked for; ``labels``: those that it has."""

    def __init__(self, text: str, labels: Sequence[str] = ()) -> None:
        super().__init__(text)
        self.labels = labels


class Leaf(NamedTuple):
    """Consecutive numbers of one type in a message."""

    offset: int
    kind: str  # of numpy
    entries: int | None  # of a sequence or array, None: a single number


class Layout(NamedTuple):
    """Place of a field in messages of one size."""

    where: list[int]  # bytes that decide about the layout ...
    expected: bytes  # ... and what stands there
    leaf: Leaf | None  # None: such messages lack it


class Places:
    """Where each number and string lies in one message of a topic. Raises BagError if it is damaged."""

    def __init__(self, types: Any, name: str, message: bytes) -> None:
        if len(message) < HEADER or message[0] != 0 or message[1] > 1:
            raise BagError(f"a message of type {name} is not plain CDR")
        self.message = message
        self.leaves: dict[str, Leaf] = {}
        self.decisive: list[int] = [0, 1]  # bytes that decide
        self._order = "<" if message[1] == 1 else ">"
        self._at = HEADER
        self._strings: dict[str, tuple[int, int]] = {}
        self._types = types
        try:
            self._walk(name, "")
        except (struct.error, KeyError, RecursionError) as error:
            raise BagError(f"a message of type {name} cannot be decoded: {error}") from error

    def _align(self, size: int) -> None:
        self._at = HEADER + -(-(self._at - HEADER) // size) * size

    def _length(self) -> int:
        self._align(4)
        (value,) = struct.unpack_from(self._order + "I", self.message, self._at)
        self.decisive += range(self._at, self._at + 4)
        self._at += 4
        return int(value)

    def _walk(self, name: str, path: str) -> None:
        for field, (node, detail) in self._types[name][1]:
            place, entries = f"{path}.{field}" if path else field, None
            if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                several = node == Nodetype.SEQUENCE
                (node, detail), entries = detail
                entries = self._length() if several else entries
                if entries > len(self.message):
                    raise BagError(
                        f"a message says that its {place} has {entries} entries, more than it has bytes"
                    )
            count = 1 if entries is None else entries
            if node == Nodetype.BASE and detail[0] not in ("string", "wstring"):
                kind = KINDS[detail[0]]
                size = int(kind[1:])
                if count:
                    self._align(size)
                if field != EMPTY:
                    self.leaves[place] = Leaf(self._at, self._order + kind, entries)
                self._at += size * count
            else:
                for one in [place] if entries is None else [f"{place}[{i}]" for i in range(count)]:
                    if node == Nodetype.NAME:
                        self._walk(detail, one)
                    else:
                        size = self._length()
                        self._strings[one] = self._at, size
                        self._at += size
            if self._at > len(self.message):
                raise BagError(f"a message ends in the middle of its {place}")

    def labels(self, path: str) -> list[str]:
        """Names of the entries of the sequence at ``path``, [] without; they decide about the layout."""
        parent = re.escape("".join(path.rpartition(".")[:2]))
        for form in (rf"{parent}layout\.dim\[\d+\]\.label", rf"{parent}names?\[\d+\]"):
            found = [lies for place, lies in self._strings.items() if re.fullmatch(form, place)]
            if found:
                self.decisive += (i for at, size in found for i in range(at, at + size))
                texts = (self.message[at : at + size] for at, size in found)
                return [text.rstrip(b"\0").decode(errors="replace") for text in texts]
        return []

    def find(self, path: str, index: str | None) -> Leaf:
        """The single number at ``path``. Raises BagError, and AbsentError if other messages may have it."""
        leaf = self.leaves.get(path)
        if leaf is None:
            numbers = [name if one.entries is None else f"{name}[0]" for name, one in self.leaves.items()]
            raise AbsentError(f"there is no number '{path}'; there is {', '.join(numbers[:12]) or 'none'}")
        if index is None:
            if leaf.entries is not None:
                raise BagError(f"{path} is a list; write {path}[0] for its first entry")
            return leaf
        labels = [] if index.isdigit() else self.labels(path)
        if not index.isdigit() and index not in labels:
            raise AbsentError(f"there is no {path}[{index}]{'' if labels else '; it has no labels'}", labels)
        number = labels.index(index) if labels else int(index)
        if leaf.entries is None or number >= leaf.entries:
            has = "is a single number" if leaf.entries is None else f"has {leaf.entries} entries"
            raise AbsentError(f"there is no {path}[{index}]: {path} {has}")
        return Leaf(leaf.offset + number * np.dtype(leaf.kind).itemsize, leaf.kind, None)


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


def places(topic: Topic, message: bytes) -> Places:
    """Where what lies in a message of ``topic``. Raises BagError."""
    return Places(types_of(topic), topic.type, message)


def types_of(topic: Topic) -> Any:
    """Field definitions for the topic's type: the bag's own, completed by those of ROS 2 Jazzy.

    Where the bag's own are not complete even so, those of Jazzy alone. Raises BagError.
    """
    if topic.unreadable:
        raise BagError(topic.unreadable)
    own, known = get_typestore(Stores.EMPTY), jazzy().fielddefs
    own.fielddefs = known | _defined(topic)
    try:
        own.generate_msgdef(topic.type, ros_version=2)  # needs all types in it
    except TypesysError as error:
        if topic.type not in known:
            raise BagError(
                f"{topic.name} has the type {topic.type}, of which the bag has no definition that is "
                f"complete: {error}"
            ) from error
        return known
    return own.fielddefs


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


class Decoder:
    """Takes the number ``field`` out of the messages of one topic.

    Raises BagError if that is no field, or the topic's type is unknown.
    """

    def __init__(self, topic: Topic, field: str) -> None:
        self.error = ""  # why the first message that could not be decoded could not
        self.absent = 0  # sound messages that do not have it
        self._path, self._index = normal(field)
        self._topic, self._types = topic, types_of(topic)
        self._layouts: dict[int, list[Layout]] = {}
        self._absence = ""  # why the first of these does not have it
        self._labels: dict[str, None] = {}  # that they have

    @property
    def reason(self) -> str:
        """Why some messages have no such number, "" if all have it."""
        labels = f"; its labels are {', '.join(self._labels)}" if self._labels else ""
        return f"{self._absence}{labels}" or self.error

    def decode(
        self, buffer: Bytes, offset: Integers, length: Integers
    ) -> tuple[Floats, npt.NDArray[np.bool_]]:
        """The field in each message, NaN where it is not there, and a mask of where it is."""
        values, done = np.full(len(offset), np.nan), np.zeros(len(offset), dtype=np.bool_)
        for size in np.unique(length).tolist():
            left = np.flatnonzero(length == size)
            known = self._layouts.setdefault(size, [])
            tried, failed = 0, 0
            while len(left) > 0 and failed < HOPELESS:
                if tried == len(known):
                    start = int(offset[left[0]])
                    try:
                        known.append(self._layout(buffer[start : start + size].tobytes()))
                    except BagError as error:
                        self.error = self.error or str(error)
                        left = left[1:]
                        failed += 1
                        continue
                layout = known[tried]
                fits = np.ones(len(left), dtype=np.bool_)
                for where, expected in zip(layout.where, layout.expected, strict=True):
                    fits &= buffer[offset[left] + where] == expected
                found, left = left[fits], left[~fits]
                tried += 1
                if layout.leaf is None:
                    self.absent += len(found)
                    continue
                kind = np.dtype(layout.leaf.kind)
                begin = offset[found][:, None] + layout.leaf.offset
                values[found] = buffer[begin + np.arange(kind.itemsize)].view(kind)[:, 0]
                done[found] = True
        return values, done

    def _layout(self, message: bytes) -> Layout:
        """Layout of messages like this one, which may not have the field. Raises BagError."""
        found, leaf = Places(self._types, self._topic.type, message), None
        try:
            leaf = found.find(self._path, self._index)
        except AbsentError as error:
            self._absence = self._absence or str(error)
            self._labels |= dict.fromkeys(error.labels)
        where = sorted(set(found.decisive))
        return Layout(where, bytes(message[at] for at in where), leaf)
