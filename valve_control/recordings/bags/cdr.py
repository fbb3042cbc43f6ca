# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Decodes numeric fields of serialized ROS messages (CDR).

In messages of a type without strings and lists, such as Float64, each field lies at one place: thousands are
decoded at once. All others are decoded one by one by the rosbags library.
"""

import dataclasses
import functools
import re
import struct
from collections import Counter
from collections.abc import Generator, Iterator, Sequence
from typing import Any

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
LISTED = 12  # numbers of a message that an error names
UNDECODABLE = (SerdeError, struct.error, ValueError, IndexError)  # what rosbags raises for damaged messages


def steps_of(field: str) -> list[tuple[str, str]]:
    """Names, or indices and labels, that lead to ``field`` in a message. Raises BagError."""
    parts = PART.findall(field)
    rebuilt = "".join(f".{name}" if name else f"[{index}]" for name, index in parts)
    if not parts or rebuilt.lstrip(".") != field.lstrip("."):
        raise BagError(f"'{field}' is not a field; write it like position[0], data or twist.linear.x")
    return parts


def numbers(message: Any, path: str = "") -> Iterator[str]:
    """Fields of a message that are numbers, of a list the first entry."""
    for name in (field.name for field in dataclasses.fields(message)):
        value, place = getattr(message, name), f"{path}.{name}".lstrip(".")
        if isinstance(value, (list, np.ndarray)):
            value, place = next(iter(value), None), f"{place}[0]"
        if dataclasses.is_dataclass(value):
            yield from numbers(value, place)
        elif isinstance(value, (int, float, np.number)) and name != EMPTY:
            yield place


def labels(message: Any) -> list[str]:
    """Names of the entries of the lists in a message, [] if it has none."""
    dimensions = getattr(getattr(message, "layout", None), "dim", [])
    names = getattr(message, "names", getattr(message, "name", []))
    return [getattr(one, "label", "") for one in dimensions] or (names if isinstance(names, list) else [])


def number(message: Any, steps: Sequence[tuple[str, str]]) -> float:
    """The number in ``message`` to which ``steps`` lead. Raises BagError."""
    parent, value, path = message, message, ""
    for name, index in steps:
        if name:
            parent, value, path = value, getattr(value, name, None), f"{path}.{name}".lstrip(".")
            continue
        known = [] if index.isdigit() else labels(parent)
        if not isinstance(value, (list, np.ndarray)):
            raise BagError(f"there is no {path}[{index}]: {path} is no list")
        if not index.isdigit() and index not in known:
            has = f"its labels are {', '.join(known)}" if known else "it has no labels"
            raise BagError(f"there is no {path}[{index}]; {has}")
        at = known.index(index) if known else int(index)
        if at >= len(value):
            raise BagError(f"there is no {path}[{index}]: {path} has {len(value)} entries")
        value, path = value[at], f"{path}[{index}]"
    if isinstance(value, (list, np.ndarray)):
        raise BagError(f"{path} is a list; write {path}[0] for its first entry")
    if not isinstance(value, (int, float, np.number)):
        has = ", ".join([*numbers(message)][:LISTED]) or "none"
        raise BagError(f"there is no number '{path}'; there is {has}")
    return float(value)


@functools.cache
def jazzy() -> Typestore:
    """Message types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def deserialized(raw: bytes, kind: str, store: Typestore | None = None) -> Any:
    """The message of type ``kind`` of ``store`` (ROS 2 Jazzy), None if it cannot be decoded.

    What rclpy serializes may have bytes to spare at its end.
    """
    if len(raw) < HEADER or raw[0] != 0 or raw[1] > 1:
        return None
    store = store or jazzy()
    definition = store.get_msgdef(kind)
    decode = definition.deserialize_cdr_le if raw[1] else definition.deserialize_cdr_be
    try:
        return decode(raw[HEADER:], 0, definition.cls, store)[0]
    except UNDECODABLE:
        return None


def types_of(topic: Topic) -> Typestore:
    """Message types for the topic: the bag's own, completed by those of ROS 2 Jazzy.

    Where the bag's own are not complete even so, those of Jazzy alone. Raises BagError.
    """
    if topic.unreadable:
        raise BagError(topic.unreadable)
    known, own, store = jazzy(), _defined(topic), Typestore()
    store.fielddefs = {name: fields for name, fields in known.fielddefs.items() if name not in own}
    store.types = {name: known.types[name] for name in store.fielddefs}
    try:
        store.register(own)
        store.generate_msgdef(topic.type, ros_version=2)  # needs all types in it
        store.get_msgdef(topic.type)
    except (TypesysError, KeyError, RecursionError) as error:
        if topic.type in known.fielddefs:
            return known
        raise BagError(
            f"{topic.name} has the type {topic.type}, of which the bag has no definition that can be used: "
            f"{error}"
        ) from error
    return store


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


def _places(types: Any, kind: str, at: int = 0, path: str = "") -> Generator[tuple[str, int, str], None, int]:
    """Yield each number of the type ``kind``, its offset and kind of numpy; return the end.

    Raises KeyError if there are strings and lists in it, behind which there are no such places.
    """
    for field, (node, detail) in types[kind][1]:
        place, entries = f"{path}.{field}".lstrip("."), [""]
        if node == Nodetype.ARRAY:
            (node, detail), count = detail
            entries = [f"[{i}]" for i in range(count)]
        for entry in entries:
            if node == Nodetype.NAME:
                at = yield from _places(types, detail, at, place + entry)
                continue
            numpy_kind = KINDS[detail[0]]
            size = int(numpy_kind[1:])
            at = -(-at // size) * size
            yield place + entry, at, numpy_kind
            at += size
    return at


class Decoder:
    """Takes the numbers ``fields`` out of the messages of one topic.

    Raises BagError if one is no field, or the topic's type is unknown.
    """

    def __init__(self, topic: Topic, fields: Sequence[str]) -> None:
        self.undecodable = 0  # messages
        self.error = ""  # why
        self.absent: Counter[str] = Counter()  # sound messages without a field
        self._steps = {field: steps_of(field) for field in fields}
        self._kind, self._store = topic.type, types_of(topic)
        self._absences: dict[str, None] = {}  # why
        self._fixed: list[tuple[int, str]] = []  # places of the fields, [] if they depend on the message
        try:
            places = {path: (at, kind) for path, at, kind in _places(self._store.fielddefs, topic.type)}
            self._fixed = [places[field.lstrip(".")] for field in fields]
            self._size = max(at + int(kind[1:]) for at, kind in places.values())
        except (KeyError, ValueError):
            self._fixed = []

    @property
    def reason(self) -> str:
        """Why some messages do not have all fields, "" if all have them."""
        return "; ".join(self._absences) or self.error

    def decode(
        self, buffer: Bytes, offset: Integers, length: Integers
    ) -> tuple[Floats, npt.NDArray[np.bool_]]:
        """Fields (n×m) of the messages, NaN where they are not there, and a mask (n×m) of where they are."""
        values = np.full((len(offset), len(self._steps)), np.nan)
        present = np.zeros(values.shape, dtype=np.bool_)
        if self._fixed:
            long = np.flatnonzero(length >= HEADER + self._size)
            plain = buffer[offset[long]] == 0
            for order, sign in enumerate("><"):
                found = long[plain & (buffer[offset[long] + 1] == order)]
                for k, (at, kind) in enumerate(self._fixed):
                    where = offset[found][:, None] + np.arange(HEADER + at, HEADER + at + int(kind[1:]))
                    values[found, k] = buffer[where].view(sign + kind)[:, 0]
                present[found] = True
            self._count(len(offset) - int(np.count_nonzero(present[:, 0])))
            return values, present
        for i, (at, size) in enumerate(zip(offset.tolist(), length.tolist(), strict=True)):
            message = deserialized(buffer[at : at + size].tobytes(), self._kind, self._store)
            if message is None:
                self._count(1)
                continue
            for k, (field, steps) in enumerate(self._steps.items()):
                try:
                    values[i, k], present[i, k] = number(message, steps), True
                except BagError as error:
                    self.absent[field] += 1
                    self._absences[str(error)] = None
        return values, present

    def _count(self, damaged: int) -> None:
        self.undecodable += damaged
        if damaged:
            self.error = f"they are no plain CDR of {self._kind}, or cut"
