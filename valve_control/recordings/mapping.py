# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Finds out which topics of a bag are position, command and voltage of which valve."""

import re
from collections.abc import Sequence
from typing import NamedTuple

from valve_control.control.drivers.scaling import Scale, ScaleError, parse
from valve_control.recordings.bags.bag import Bag
from valve_control.recordings.bags.cdr import Decoder, normal
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.tables import empty_notes, take_times, topic_of

PARTS = ("spool_command", "spool_position", "valve_voltage")
TRAJECTORY = "spool_trajectory"  # plays the part of the command where there are no others
POSITION = "positions[0]"
ONLY = "valve"  # name of a valve whose topics stand in no namespace
STATE_TYPE = "std_msgs/msg/Float64MultiArray"
SCALED = re.compile(r"(?P<source>[^*@]+)(?:@(?P<word>.+)|(?P<formula>\*.+))?")


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
        """Whether all signals come from the topics that a controller itself uses."""
        own = {part: {f"{self.namespace}/{part}.data"} for part in PARTS}
        own["spool_command"].add(f"{self.namespace}/{TRAJECTORY}.{POSITION}")
        return all(str(source) in own[part] for part, source in self.sources.items())


def parse_map(text: str) -> tuple[str, str, Source]:
    """``[valve/]part=/topic[.field][*factor±offset or @word]`` as valve, part and source. Raises BagError."""
    valve, part, right = _role(text)
    scaled = SCALED.fullmatch(right)
    try:
        if scaled is None:
            raise ScaleError("a scale follows its topic, as in /topic.field*1.25-15 or /topic.field@4..20mA")
        scale = parse(scaled["word"] or scaled["formula"] or "*1")
    except ScaleError as error:
        raise BagError(f"--map {text}: {error}") from None
    source = scaled["source"].strip()
    topic, _, field = source.partition(".")
    topic = topic if topic.startswith("/") else f"/{topic}"
    normal(field or "data")
    return valve, part, Source(topic, field or "data", scale)


def _role(text: str) -> tuple[str, str, str]:
    """Valve and part that the map ``text`` names, and what it gives them. Raises BagError."""
    left, equals, right = text.partition("=")
    valve, _, part = left.strip().rpartition("/")
    if not equals or part not in PARTS or not right.strip():
        raise BagError(
            "--map takes part=/topic.field with part spool_command, spool_position or valve_voltage, "
            f"not '{text}' (of a table: part=COLUMN, and time=COLUMN)"
        )
    return valve if valve.strip("/") == ONLY else valve.strip("/") or ONLY, part, right.strip()


def _mapped(bag: Bag, text: str) -> tuple[str, str, Source]:
    """Valve, part and source in ``bag`` that the map ``text`` names. Raises BagError."""
    valve, part, right = _role(text)
    if bag.table is not None:
        topic, scale = topic_of(bag.table, text)
        return valve, part, Source(topic, "data", scale)
    return parse_map(text)


def find_valves(bag: Bag, maps: Sequence[str] = ()) -> dict[str, ValveTopics]:
    """Valves of a bag by name: each namespace with a topic of the cascade, and what is mapped.

    Raises BagError if there is none, a mapped topic or field does not exist, or one of their topics cannot be
    read at all.
    """
    maps = take_times(bag, maps)
    sources: dict[str, dict[str, Source]] = {}
    left_out: list[str] = []
    for name in bag.topics:
        namespace, _, part = name.rpartition("/")
        if part in PARTS:
            found = Source(name, "data")
            wrong = "" if bag.topics[name].unreadable else _wrong_field(bag, found)
            if wrong:
                left_out.append(f"{wrong}; it is left out")
            else:
                sources.setdefault(_name(namespace), {})[part] = found
    for name in bag.topics:
        namespace, _, part = name.rpartition("/")
        parts = sources.get(_name(namespace), {})
        commands = parts.get("spool_command")
        if part != TRAJECTORY or not parts or not _spoken(bag, name):
            continue
        if (commands is None or not _spoken(bag, commands.topic)) and (
            bag.topics[name].unreadable or not _wrong_field(bag, Source(name, POSITION))
        ):
            parts["spool_command"] = Source(name, POSITION)
    mapped: dict[tuple[str, str], str] = {}
    for text in maps:
        valve, part, source = _mapped(bag, text)
        if mapped.setdefault((valve, part), text) != text:
            before = mapped[valve, part]
            raise BagError(f"--map {text}: {part} of {valve} is mapped already, by --map {before}")
        wrong = "" if bag.topic(source.topic).unreadable else _wrong_field(bag, source)
        if wrong:
            raise BagError(wrong)
        sources.setdefault(valve, {})[part] = source
    unreadable = {
        bag.topics[source.topic].unreadable for parts in sources.values() for source in parts.values()
    } - {""}
    if unreadable:
        raise BagError(f"{bag.path}: {'; '.join(sorted(unreadable))}")
    if left_out and not sources:
        raise BagError(f"{bag.path} has no topic of a valve that can be read: {'; '.join(left_out)}")
    bag.problems += left_out
    if not sources:
        raise BagError(_nothing(bag))
    if bag.table is not None:
        used = [source.topic for parts in sources.values() for source in parts.values()]
        bag.problems += empty_notes(bag.table, used)
    return {
        valve: ValveTopics(valve, _namespace(valve), parts, *_own_topics(bag, _namespace(valve)))
        for valve, parts in sorted(sources.items())
    }


def _nothing(bag: Bag) -> str:
    """That no topic plays the part of a signal, and which could."""
    if bag.table is not None:
        return (
            f"{bag.path} has no column spool_command, spool_position or valve_voltage; it has "
            f"{bag.table.listed}; name the columns that play their parts with --map spool_position=COLUMN"
        )
    topics = ", ".join(f"{t.name} ({t.type})" for t in bag.topics.values())
    return (
        f"{bag.path} has no spool_command, spool_position or valve_voltage; it has {topics}; name what "
        "plays their parts with --map spool_position=/topic.field"
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
    """Why ``source`` is no number in its topic's messages, "" if it is one in any of them."""
    topic = bag.topic(source.topic)
    try:
        decoder = Decoder(topic, [source.field])
    except BagError as reason:
        return f"{source.topic} ({topic.type}): {reason}"
    for _, block in bag.blocks([source.topic]):
        if decoder.decode(block.buffer, block.offset, block.length)[1].any():
            return ""
    error = str(decoder.absence or decoder.error)
    return f"{source.topic} ({topic.type}): {error}" if error else ""
