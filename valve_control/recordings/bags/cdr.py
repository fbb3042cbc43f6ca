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
    """Places of the fields in messages of one size."""

    where: list[int]  # bytes that decide about the layout ...
    expected: bytes  # ... and what stands there
    fields: list[tuple[int, str] | None]  # offset and kind of numpy of each; None: such messages lack it
    absent: AbsentError | None  # why the fields are not there


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
        self._fields(name, "")

    def _align(self, size: int) -> None:
        self.at = HEADER + -(-(self.at - HEADER) // size) * size

    def _length(self) -> int:
        self._align(4)
        (value,) = struct.unpack_from(self.order + "I", self.message, self.at)
        self.lengths += range(self.at, self.at + 4)
        self.at += 4
        return int(value)

    def _fields(self, name: str, path: str) -> None:
        for field, description in self._types[name][1]:
            place = f"{path}.{field}" if path else field
            node, detail = description
            if node in (Nodetype.BASE, Nodetype.NAME):
                self._several(description, [place], place)
                continue
            inner, count = detail
            if node == Nodetype.SEQUENCE:
                count = self._length()
                if count > len(self.message):
                    raise BagError(
                        f"a message says that its {place} has {count} entries, more than it has bytes"
                    )
            self._several(inner, [f"{place}[{i}]" for i in range(count)], place, single=False)

    def _several(self, description: Any, places: list[str], path: str, single: bool = True) -> None:
        node, detail = description
        if node == Nodetype.NAME:
            for place in places:
                self._fields(detail, place)
        elif detail[0] in ("string", "wstring"):
            for place in places:
                size = self._length()
                self.strings[place] = (self.at, size)
                self.at += size
        else:
            kind = KINDS[detail[0]]
            size = int(kind[1:])
            if places:
                self._align(size)
            if path.rpartition(".")[2] != EMPTY:
                self.leaves[path] = Leaf(self.at, kind, len(places), single)
            self.at += size * len(places)
        if self.at > len(self.message):
            raise BagError(f"a message ends in the middle of its {path}")

    def text(self, path: str) -> str:
        """The string at ``path``."""
        at, size = self.strings[path]
        return self.message[at : at + size].rstrip(b"\0").decode(errors="replace")

    def labels(self, path: str) -> list[str]:
        """Paths of the strings that name the entries of the sequence at ``path``."""
        parent = re.escape("".join(path.rpartition(".")[:2]))
        forms = (rf"{parent}layout\.dim\[\d+\]\.label", rf"{parent}names?\[\d+\]")
        found = ([place for place in self.strings if re.fullmatch(form, place)] for form in forms)
        return next(filter(None, found), [])

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
        if node == Nodetype.BASE and detail[0] not in (*KINDS, "string", "wstring"):
            return str(detail[0])
    return ""


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
        result = np.full((len(offset), len(self.fields)), np.nan)
        done = np.zeros(len(offset), dtype=np.bool_)
        for size in np.unique(length).tolist():
            left = np.flatnonzero(length == size)
            known = self._layouts.setdefault(size, [])
            tried, failed = 0, 0
            while len(left) > 0 and failed < HOPELESS:
                if tried == len(known):
                    start = int(offset[left[0]])
                    try:
                        known.append(self._layout(buffer[start : start + size].tobytes()))
                    except (BagError, struct.error, KeyError) as error:
                        self.error = self.error or str(error)
                        left = left[1:]
                        failed += 1
                        continue
                layout = known[tried]
                fits = np.ones(len(left), dtype=np.bool_)
                for where, expected in zip(layout.where, layout.expected, strict=True):
                    fits &= buffer[offset[left] + where] == expected
                if layout.absent is None:
                    result[left[fits]] = self._take(layout, buffer, offset[left[fits]])
                    done[left[fits]] = True
                else:
                    self.absent += int(np.count_nonzero(fits))
                left = left[~fits]
                tried += 1
        return result, done

    def _layout(self, message: bytes) -> Layout:
        """Layout of messages like this one, which may not have all fields. Raises BagError."""
        walk = _Walk(self._types, self.topic.type, message)
        fields: list[tuple[int, str] | None] = []
        absent = None
        try:
            fields += [self._find(walk, field) for field in self.fields]
        except AbsentError as error:
            absent, before = error, self.absence
            known = (*before.labels, *error.labels) if before is not None else error.labels
            self.absence = AbsentError((before or error).text, tuple(dict.fromkeys(known)))
        where = sorted(set(walk.lengths))
        return Layout(where, bytes(message[at] for at in where), fields, absent)

    def _find(self, walk: _Walk, field: str) -> tuple[int, str] | None:
        try:
            leaf = walk.find(field)
        except BagError:
            if self._optional:
                return None
            raise
        return leaf.offset, walk.order + leaf.kind

    def _take(self, layout: Layout, buffer: Bytes, offset: Integers) -> Floats:
        values = np.full((len(offset), len(layout.fields)), np.nan)
        for k, place in enumerate(layout.fields):
            if place is not None:
                kind = np.dtype(place[1])
                raw = buffer[offset[:, None] + np.arange(place[0], place[0] + kind.itemsize)]
                values[:, k] = raw.view(kind)[:, 0]
        return values
