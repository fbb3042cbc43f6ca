# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Plays a bag to running nodes: publishes the recorded topics at their times."""

import os
import signal
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from tqdm import tqdm

from valve_control.arrays import Integers
from valve_control.nodes.adapter import SAMPLES, encoded
from valve_control.nodes.definitions import message_class
from valve_control.nodes.transport import check_log_folder
from valve_control.recordings.bags.bag import Bag, Series
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.cleaning import FEW_STAMPS
from valve_control.recordings.clocks import decide, without_strays
from valve_control.recordings.mapping import PARTS, find_valves
from valve_control.recordings.pairing import Samples, paired
from valve_control.recordings.recording import load

PLAYED = ("spool_command", "spool_position")
MEET = 10.0  # s to wait for somebody who listens
SETTLE = 0.5  # s in which discovery becomes mutual
DRAIN = 0.2  # s at the end, for what is still on its way


class Played(NamedTuple):
    """What was published, and how late."""

    published: int
    elapsed: float  # s
    late: float  # s, p99 of the delay behind the recorded time


class Track(NamedTuple):
    """Messages that are published on one topic."""

    topic: str
    type: str
    time: Integers  # ns
    place: Integers  # among all messages of the recording
    messages: list[bytes]


def play(
    path: str,
    maps: Sequence[str],
    topics: Sequence[str] | None,
    rate: float,
    start: float | None = None,
    end: float | None = None,
    quiet: bool = False,
    clock: str | None = None,
) -> Played:
    """Publish a bag's topics at ``rate`` times the recorded speed.

    ``start``, ``end`` [s]: part of the bag. Raises BagError.
    """
    if not 0.001 <= rate <= 1000.0:
        raise BagError(f"--rate is {rate:g}; it must lie between 0.001 and 1000")
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    check_log_folder(os.environ)
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("player")
    try:
        return _timed(node, path, maps, topics, rate, start, end, quiet, clock)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def _meet(publishers: dict[str, Any]) -> None:
    limit = time.monotonic() + MEET
    while missing := [
        name for name, publisher in publishers.items() if publisher.get_subscription_count() == 0
    ]:
        if time.monotonic() > limit:
            raise BagError(
                f"nobody has listened to {', '.join(missing)} for {MEET:g} s; is the controller running?"
            )
        time.sleep(0.02)
    time.sleep(SETTLE)


def _timed(
    node: Node, path: str, maps: Sequence[str], topics: Sequence[str] | None, rate: float,
    start: float | None, end: float | None, quiet: bool, clock: str | None,
) -> Played:  # fmt: skip
    bag = Bag(path)
    if bag.table is not None:
        tracks = _columns(path, maps, topics, start, end, clock)
    else:
        tracks = tracks_of(node, bag, maps, topics, start, end, clock)
    try:
        publishers = {
            track.topic: node.create_publisher(message_class(track.type), track.topic, SAMPLES)
            for track in tracks
        }
    except LookupError as error:
        raise BagError(f"{path} cannot be played: {error}") from error
    if not any(len(track.messages) for track in tracks):
        raise BagError(f"{path} has no message on {', '.join(publishers)}")
    times, owner, number = in_turn(tracks)
    outputs = [(publishers[track.topic], track.messages) for track in tracks]
    _meet(publishers)
    due = ((times - times[0]) * 1e-9 / rate).tolist()
    delays = []
    began = time.monotonic()
    with tqdm(total=due[-1], unit="s", disable=quiet, ascii=not sys.stderr.isatty(), mininterval=1.0,
              bar_format="live {bar} {n:.1f}/{total:.1f} s") as progress:  # fmt: skip
        for moment, k, i in zip(due, owner.tolist(), number.tolist(), strict=True):
            pause = began + moment - time.monotonic()
            if pause > 0.0:
                time.sleep(pause)
            publisher, messages = outputs[k]
            publisher.publish(messages[i])
            delays.append(time.monotonic() - began - moment)
            if moment - progress.n >= 0.1:
                progress.update(moment - progress.n)
        progress.update(due[-1] - progress.n)
    elapsed = time.monotonic() - began
    time.sleep(DRAIN)
    return Played(len(due), elapsed, float(np.percentile(delays, 99)))


def in_turn(tracks: Sequence[Track]) -> tuple[Integers, Integers, Integers]:
    """Time [ns] of each message, index of its track, and its number there, in the order of publication.

    Messages with the same time stand in the order of the recording.
    """
    times = np.concatenate([track.time for track in tracks])
    owner = np.repeat(np.arange(len(tracks)), [len(track.messages) for track in tracks])
    number = np.concatenate([np.arange(len(track.messages)) for track in tracks])
    order = np.lexsort((np.concatenate([track.place for track in tracks]), times))
    return times[order], owner[order], number[order]


def tracks_of(
    node: Node, bag: Bag, maps: Sequence[str], topics: Sequence[str] | None, start: float | None,
    end: float | None, clock: str | None,
) -> list[Track]:  # fmt: skip
    """Messages of ``topics`` of a bag, of the valves' commands and positions if none are named."""
    valves: dict[str, dict[str, str]] = {}
    if topics is None:
        for valve, found in find_valves(bag, maps).items():
            valves[valve] = {part: source.topic for part, source in found.sources.items() if part in PLAYED}
        topics = sorted({name for parts in valves.values() for name in parts.values()})
    else:
        for name in topics:
            space, _, part = name.rpartition("/")
            if part in PARTS:
                valves.setdefault(space, {})[part] = name
    for name in topics:
        if bag.topic(name).unreadable:
            raise BagError(f"{bag.path} cannot be played: {bag.topic(name).unreadable}")
    begin = bag.begin
    first = None if start is None else begin + round(start * 1e9)
    last = None if end is None else begin + round(end * 1e9)
    notes: list[str] = []
    series = without_strays(bag.read({}, raw=topics, start=first, end=last), notes)
    ruling = decide(series, [topics], clock, bag.path)
    for note in (*notes, *ruling.notes):
        node.get_logger().warning(note)
    read = one_by_one(ruling.read(series), valves.values())
    return [
        Track(name, bag.topic(name).type, read[name].publish_time, read[name].place, read[name].raw)
        for name in topics
    ]


def one_by_one(read: Mapping[str, Series], valves: Iterable[Mapping[str, str]]) -> dict[str, Series]:
    """``read``, with a time for each message of a valve's signals whose clock is coarser than the messages.

    ``valves``: topics by part. Otherwise all messages of a stamp would be published at once.
    """
    found = dict(read)
    for topics in valves:
        series = {
            part: read[name].pick(np.argsort(read[name].publish_time, kind="stable"))
            for part, name in topics.items()
            if len(np.unique(read[name].publish_time)) >= FEW_STAMPS
        }
        signals = {
            part: Samples(
                topics[part], s.publish_time, s.log_time, s.sequence, s.place, np.empty(len(s.place))
            )
            for part, s in series.items()
        }
        ties = paired(signals)
        if ties is not None and ties.several:
            # Parts may be fields of one topic: then the position's time counts.
            for part, one in sorted(series.items(), key=lambda item: item[0] == "spool_position"):
                found[topics[part]] = one._replace(publish_time=ties.times[part])
    return found


def _columns(
    path: str, maps: Sequence[str], topics: Sequence[str] | None, start: float | None, end: float | None,
    clock: str | None,
) -> list[Track]:  # fmt: skip
    """Commands and positions [V] of a table's valves, for the topics of these signals."""
    if topics is not None:
        raise BagError(f"{path} is a table, which has no topics; --map tells its command and its position")
    return [
        Track(
            f"{valve.topics.namespace}/{part}",
            "std_msgs/msg/Float64",
            valve.signals[part].time,
            valve.signals[part].place,
            [encoded(value) for value in valve.signals[part].value.tolist()],
        )
        for valve in load(path, maps, start, end, clock=clock).valves.values()
        for part in ("spool_command", "spool_position")
        if part in valve.signals
    ]
