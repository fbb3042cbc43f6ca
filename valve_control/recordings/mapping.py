# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Finds out which topics of a bag are position, command and voltage of which valve."""

import re
from collections.abc import Sequence
from typing import NamedTuple

from valve_control.control.drivers.scaling import Scale
from valve_control.recordings.bags.bag import Bag
from valve_control.recordings.bags.cdr import Decoder
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.messages import absolute
from valve_control.recordings.bags.table import PART as TIME
from valve_control.recordings.bags.table import scaled, unit_of

PARTS = ("spool_command", "spool_position", "valve_voltage")
TRAJECTORY = "spool_trajectory"  # plays the part of the command where there are no others
POSITION = "positions[0]"
ONLY = "valve"  # name of a valve whose topics stand in no namespace
STATE_TYPE = "std_msgs/msg/Float64MultiArray"


class Source(NamedTuple):
    """A numeric field of a topic, with the scale that makes volts of it."""

    topic: str
    field: str
    scale: Scale = Scale(1.0)

    def __str__(self) -> str:
        return f"{self.topic}.{self.field}{self.scale if self.scale != Scale(1.0) else ''}"


class ValveTopics(NamedTuple):
    """Topics of one valve: its signals, state and journal."""

    name: str
    namespace: str
    sources: dict[str, Source]  # by part
    state: str  # topic of the controller's state, "" if none
    journal: str  # of its journal, likewise

    @property
    def memory(self) -> str:
        """Topic of the controller's state snapshots, beside its journal; "" without one."""
        return f"{self.journal.removesuffix('/journal')}/memory" if self.journal else ""

    @property
    def plain(self) -> bool:
        """Whether reading and voltage have the names that a controller uses; its command may be remapped."""
        own = {part: re.escape(f"{self.namespace}/{part}.data") for part in PARTS}
        own["spool_command"] = rf".*\.(data|{re.escape(POSITION)})"
        return all(re.fullmatch(own[part], str(source)) for part, source in self.sources.items())


def _mapped(bag: Bag, text: str) -> tuple[str, str, Source]:
    """Valve, part and source of the map ``[valve/]part=/topic[.field][*factor±offset or @word]``.

    Of a table a column stands in place of topic and field. Raises BagError.
    """
    left, equals, right = text.partition("=")
    valve, _, part = left.strip().rpartition("/")
    if not equals or part not in PARTS or not right.strip():
        raise BagError(
            "--map takes part=/topic.field with part spool_command, spool_position or valve_voltage, "
            f"not '{text}' (of a table: part=COLUMN, and time=COLUMN)"
        )
    valve = valve if valve.strip("/") == ONLY else valve.strip("/") or ONLY
    if bag.table is not None:
        at, scale = bag.table.source(text)
        if at is None:
            raise BagError(f"--map {text}: the number of a row is a time, no signal")
        return valve, part, Source(bag.table.topics[at].name, "data", scale)
    source, scale = scaled(text)
    topic, _, field = source.partition(".")
    return valve, part, Source(absolute(topic), field or "data", scale)


def find_valves(bag: Bag, maps: Sequence[str] = ()) -> dict[str, ValveTopics]:
    """Valves of a bag by name: each namespace with a topic of the cascade, and what is mapped.

    Raises BagError if there is none, a mapped topic or field does not exist, or one of their topics cannot be
    read at all.
    """
    timed = [text for text in maps if text.partition("=")[0].strip() == TIME]
    if bag.table is not None:
        maps = bag.table.take_times(maps, bag.problems)
        bag.topics = {topic.name: topic for topic in bag.table.topics}
    elif timed:
        raise BagError(f"--map {timed[0]}: {bag.path} has times of its own; only a table's are mapped")
    columns = [] if bag.table is None else zip(bag.table.topics, bag.table.columns, strict=True)
    units = {topic.name: unit_of(column) for topic, column in columns}
    sources: dict[str, dict[str, Source]] = {}
    left_out: list[str] = []
    for name in bag.topics:
        namespace, _, part = name.rpartition("/")
        if part in PARTS:
            source = Source(name, "data", units.get(name, Scale(1.0)))
            if wrong := _wrong_field(bag, source):
                left_out.append(f"{wrong}; it is left out")
            else:
                sources.setdefault(_name(namespace), {})[part] = source
    for name in bag.topics:
        namespace, _, part = name.rpartition("/")
        parts = sources.get(_name(namespace), {})
        if part == TRAJECTORY and parts and bag.table is None and _spoken(bag, name):
            command = parts.get("spool_command")
            silent = command is None or not _spoken(bag, command.topic)
            if silent and not _wrong_field(bag, Source(name, POSITION)):
                parts["spool_command"] = Source(name, POSITION)
    mapped: dict[tuple[str, str], str] = {}
    for text in maps:
        valve, part, source = _mapped(bag, text)
        if mapped.setdefault((valve, part), text) != text:
            before = mapped[valve, part]
            raise BagError(f"--map {text}: {part} of {valve} is mapped already, by --map {before}")
        if wrong := _wrong_field(bag, source):
            raise BagError(wrong)
        sources.setdefault(valve, {})[part] = source
    unreadable = {
        bag.topics[source.topic].unreadable for parts in sources.values() for source in parts.values()
    } - {""}
    if unreadable:
        raise BagError(f"{bag.path}: {'; '.join(sorted(unreadable))}")
    if not sources:
        raise BagError(_nothing(bag, left_out))
    bag.problems += left_out
    if bag.table is not None:
        used = {source.topic: source.scale for parts in sources.values() for source in parts.values()}
        bag.problems += bag.table.notes_on(used)
    return {
        valve: ValveTopics(valve, _namespace(valve), parts, *_own_topics(bag, _namespace(valve)))
        for valve, parts in sorted(sources.items())
    }


def _nothing(bag: Bag, left_out: Sequence[str]) -> str:
    """That no topic plays the part of a signal, and which could."""
    if left_out:
        return f"{bag.path} has no topic of a valve that can be read: {'; '.join(left_out)}"
    kind, has, example = "", ", ".join(f"{t.name} ({t.type})" for t in bag.topics.values()), "/topic.field"
    if bag.table is not None:
        kind, has, example = "column ", bag.table.listed, "COLUMN"
    return (
        f"{bag.path} has no {kind}spool_command, spool_position or valve_voltage; it has {has}; name what "
        f"plays their parts with --map spool_position={example}"
    )


def _namespace(valve: str) -> str:
    return "" if valve == ONLY else f"/{valve.strip('/')}"


def _name(namespace: str) -> str:
    plain = namespace.strip("/")
    return f"/{plain}" if plain == ONLY else plain or ONLY


def _own_topics(bag: Bag, namespace: str) -> list[str]:
    """State and journal of the controller in ``namespace``, "" for what is not there; both of one node."""
    found: dict[str, dict[str, str]] = {}  # by node
    for name, topic in bag.topics.items():
        own = re.fullmatch(rf"({re.escape(namespace)}/[^/]+)/(state|journal)", name)
        if own and topic.type == STATE_TYPE and not topic.unreadable:
            found.setdefault(own[1], {})[own[2]] = name
    node = max(found.values(), key=len, default={})
    return [node.get(kind, "") for kind in ("state", "journal")]


def _spoken(bag: Bag, topic: str) -> bool:
    """Whether there is a message on ``topic``."""
    return next(iter(bag.messages(topic)), None) is not None


def _wrong_field(bag: Bag, source: Source) -> str:
    """Why ``source`` is no number in its topic's messages; "" if it is one in any, or none can be read."""
    topic = bag.topic(source.topic)
    if topic.unreadable or bag.table is not None:
        return ""
    try:
        decoder = Decoder(topic, source.field)
    except BagError as reason:
        return f"{source.topic} ({topic.type}): {reason}"
    for _, block in bag.blocks([source.topic]):
        if decoder.decode(block.buffer, block.offset, block.length)[1].any():
            return ""
    return f"{source.topic} ({topic.type}): {decoder.reason}" if decoder.reason else ""
