# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Keeps the last seconds of all recorded topics in memory, and writes a bag of them if something happens."""

import re
import shutil
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Parameter, ParameterEvent
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.interfaces import Qos

from valve_control import outputs
from valve_control.nodes.parameter_capture import EVENTS, applied
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.metadata import NAME
from valve_control.recordings.bags.writer import BagWriter

OVERHEAD = 250  # bytes that a message takes in memory beside its own
SILENT = 3.0  # s without a word of a controller that is still known, of which there is one a second
SLACK = 1.0  # s that are kept longer than they are needed
MB = 1e6  # bytes
STAMP = re.compile(r"_\d{8}_\d{6}(_\d+)?")  # behind the name of each bag


class Entry(NamedTuple):
    """A message in memory."""

    moment: float  # s, monotonic, when it came
    topic: str
    log_time: int  # ns
    publish_time: int  # ns
    number: int
    data: bytes


class BoxLimits(NamedTuple):
    """How much is kept, and for how long."""

    seconds: float  # before what happens
    after: float  # s after it
    keep: int  # bags
    max_bytes: int  # in memory


class _Happened(NamedTuple):
    """Something for which a bag is to be written."""

    folder: Path
    begin: float  # s, monotonic, of what it holds
    due: float  # s, monotonic
    latest: float  # s, monotonic, to which other events put it off
    reasons: list[str]


class BlackBox:
    """A ring of messages; takes them like a BagWriter, and writes one bag for each thing that happens.

    ``name``: of the bags, with a date behind it; ``tell``: says a sentence, with whether it is an error.
    """

    def __init__(
        self,
        name: Path,
        storage: str,
        compression: str,
        limits: BoxLimits,
        tell: Callable[[str, bool], None],
    ) -> None:
        self._name = name
        self._storage, self._compression = storage, compression
        self._limits = limits
        self._tell = tell
        self._topics: dict[str, tuple[str, str, str, Sequence[Qos]]] = {}
        self._ring: deque[Entry] = deque()
        self._parameters: dict[str, dict[str, Parameter]] = {}  # by node, before what the ring has
        self._heard: dict[str, tuple[float, frozenset[str]]] = {}  # last word of each node, its conditions
        self._told: dict[str, float] = {}  # s, monotonic, when a condition was last a reason
        self._waiting: _Happened | None = None
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="black_box")
        self._writing: list[tuple[_Happened, Future[int]]] = []
        self._began = time.monotonic()
        self.total_bytes = 0  # in memory, about
        self.counts: Counter[str] = Counter()  # messages so far
        self.bags: list[Path] = []  # written so far
        self.error = ""  # why the newest bag could not be written

    # Messages

    def add_topic(
        self, name: str, type_name: str, definition: str = "", type_hash: str = "", qos: Sequence[Qos] = ()
    ) -> None:
        """Add a topic, as to a BagWriter."""
        self._topics[name] = (type_name, definition, type_hash, qos)

    def write(self, topic: str, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        """Take a message into memory; the oldest are dropped while there is no room for it."""
        self._ring.append(Entry(time.monotonic(), topic, log_time, publish_time, sequence, data))
        self.total_bytes += len(data) + OVERHEAD
        self.counts[topic] += 1
        while self.total_bytes > self._limits.max_bytes:
            self._drop()

    def _drop(self) -> None:
        entry = self._ring.popleft()
        self.total_bytes -= len(entry.data) + OVERHEAD
        if entry.topic == EVENTS:
            _fold(self._parameters, entry.data)

    @property
    def message_count(self) -> int:
        """Number of messages so far."""
        return self.counts.total()

    @property
    def text(self) -> str:
        """What became of this recording, in words."""
        return f"{len(self.bags)} bags written of {self.message_count} messages that came"

    @property
    def held(self) -> float:
        """Time [s] over which there are messages."""
        return self._ring[-1].moment - self._ring[0].moment if self._ring else 0.0

    @property
    def doubt(self) -> str:
        """Why the next bag may not hold what it should, "" without a reason."""
        if self.error:
            return self.error
        wanted = min(self._limits.seconds, time.monotonic() - self._began - SLACK)
        if self.total_bytes > 0.9 * self._limits.max_bytes and self.held < wanted:
            return (
                f"the black box holds the last {self.held:.1f} s only: box.max_size is "
                f"{self._limits.max_bytes / MB:g} MB"
            )
        return ""

    def figures(self) -> dict[str, Any]:
        """What it holds and has written, for diagnostics."""
        return {
            "box_s": f"{self.held:.1f}",
            "box_MB": f"{self.total_bytes / MB:.2f}",
            "bags": len(self.bags),
            "newest_bag": outputs.shown(self.bags[-1]) if self.bags else "",
        }

    # What happens

    def observe(self, data: bytes) -> None:
        """Take in diagnostics: a condition that was not there in the word before of its node is a reason."""
        try:
            message = deserialize_message(data, DiagnosticArray)
        except Exception:  # rclpy has no public type for bytes that are no message
            return
        now = time.monotonic()
        for status in message.status:
            told = next((pair.value for pair in status.values if pair.key == "conditions"), None)
            if told is None:
                continue
            conditions = frozenset(name for name in told.split(", ") if name)
            # What the first word of a node tells began before it.
            _, before = self._heard.get(status.name, (now, conditions))
            self._heard[status.name] = (now, conditions)
            for name in sorted(conditions - before):
                self._condition(f"{name} of /{status.name}", now, now)

    def look(self, alive: Collection[str]) -> None:
        """Notice nodes that have fallen silent without leaving, as those in ``alive`` have not."""
        now = time.monotonic()
        for name, (moment, _) in list(self._heard.items()):
            if now - moment > SILENT:
                del self._heard[name]
                if f"/{name}" in alive:
                    self._condition(f"silence of /{name}", now, moment)

    def _condition(self, reason: str, now: float, since: float) -> None:
        """Write for ``reason``, unless it was one a short while ago: what flickers fills no disk."""
        last = self._told.get(reason)
        self._told[reason] = now
        if last is None or now - last > self._limits.seconds:
            self.save(reason, since)

    def save(self, reason: str, since: float | None = None) -> Path:
        """Have a bag written that begins before ``since`` [s, monotonic; now]; its folder.

        What happens while one waits for its end is in that one, which then ends later by ``after`` at most.
        """
        now = time.monotonic()
        begin = (now if since is None else since) - self._limits.seconds
        if self._waiting is not None:
            self._waiting.reasons.append(reason)
            due = min(now + self._limits.after, self._waiting.latest)
            self._waiting = self._waiting._replace(due=due, begin=min(begin, self._waiting.begin))
            return self._waiting.folder
        due = now + self._limits.after
        self._waiting = _Happened(self._unused(), begin, due, due + self._limits.after, [reason])
        self._tell(f"{reason}: {outputs.shown(self._waiting.folder)} is written", False)
        return self._waiting.folder

    def _unused(self) -> Path:
        stamp = time.strftime("_%Y%m%d_%H%M%S")
        taken = {happened.folder for happened, _ in self._writing}
        number = 1
        while True:
            folder = self._name.with_name(f"{self._name.name}{stamp}{f'_{number}' if number > 1 else ''}")
            if not folder.exists() and folder not in taken:
                return folder
            number += 1

    # Bags

    def flush(self) -> None:
        """Forget what is too old, begin to write what is due, and say what was written."""
        now = time.monotonic()
        oldest = now - (self._limits.seconds + 2.0 * self._limits.after + SILENT + SLACK)
        while self._ring and self._ring[0].moment < oldest:
            self._drop()
        if self._waiting is not None and now >= self._waiting.due:
            self._begin()
        while self._writing and self._writing[0][1].done():
            self._finish(*self._writing.pop(0))

    def _begin(self) -> None:
        happened, self._waiting = self._waiting, None
        assert happened is not None
        kept = [entry for entry in self._ring if entry.moment >= happened.begin]
        parameters = {name: dict(values) for name, values in self._parameters.items()}
        for entry in self._ring:
            if entry.topic == EVENTS and entry.moment < happened.begin:
                _fold(parameters, entry.data)
        work = self._pool.submit(self._write_bag, happened.folder, dict(self._topics), kept, parameters)
        self._writing.append((happened, work))

    def _write_bag(
        self,
        folder: Path,
        topics: dict[str, tuple[str, str, str, Sequence[Qos]]],
        entries: Sequence[Entry],
        parameters: dict[str, dict[str, Parameter]],
    ) -> int:
        """Write a bag beside its place and move it there once it is whole; number of its messages."""
        beside = folder.with_name(f".{folder.name}.part")
        try:
            return self._write_beside(beside, folder, topics, entries, parameters)
        finally:
            shutil.rmtree(beside, ignore_errors=True)

    def _write_beside(
        self,
        beside: Path,
        folder: Path,
        topics: dict[str, tuple[str, str, str, Sequence[Qos]]],
        entries: Sequence[Entry],
        parameters: dict[str, dict[str, Parameter]],
    ) -> int:
        shutil.rmtree(beside, ignore_errors=True)
        with BagWriter(beside / folder.name, self._storage, compression=self._compression) as writer:
            for name, about in topics.items():
                writer.add_topic(name, *about)
            for data in _snapshots(parameters) if entries else ():
                writer.write(EVENTS, entries[0].log_time, entries[0].log_time, 0, data)
            for entry in entries:
                writer.write(*entry[1:])
            count = writer.message_count
        (beside / folder.name).rename(folder)
        return count

    def _finish(self, happened: _Happened, work: "Future[int]") -> None:
        try:
            count = work.result()
        except (BagError, OSError) as error:
            self.error = outputs.printable(f"{happened.folder} could not be written: {error}")
            self._tell(self.error, True)
            return
        self.error = ""
        self.bags.append(happened.folder)
        reasons = "; ".join(happened.reasons)
        self._tell(f"wrote {count} messages to {outputs.shown(happened.folder)} ({reasons})", False)
        for old in self._older()[: -self._limits.keep]:
            shutil.rmtree(old, ignore_errors=True)
            self._tell(f"removed {outputs.shown(old)}: box.keep is {self._limits.keep}", False)

    def _older(self) -> list[Path]:
        """All bags of this name, the newest last."""
        found = [
            path
            for path in self._name.absolute().parent.iterdir()
            if path.name.startswith(self._name.name)
            and STAMP.fullmatch(path.name[len(self._name.name) :])
            and (path / NAME).exists()
        ]
        return sorted(found, key=lambda path: (path.stat().st_mtime, path.name))

    def missing(self) -> list[str]:
        """Nothing: no file is being written for long."""
        return []

    def close(self) -> None:
        """Write at once what waits for its end, and wait until all is written."""
        if self._waiting is not None:
            self._begin()
        self._pool.shutdown(wait=True)
        self.flush()


def _fold(parameters: dict[str, dict[str, Parameter]], data: bytes) -> None:
    """Take a serialized ParameterEvent into the values of its node."""
    try:
        event = deserialize_message(data, ParameterEvent)
    except Exception:  # rclpy has no public type for bytes that are no message
        return
    applied(parameters.setdefault(event.node, {}), event)


def _snapshots(parameters: dict[str, dict[str, Parameter]]) -> Iterator[bytes]:
    for name, values in parameters.items():
        message: Any = ParameterEvent(node=name, new_parameters=list(values.values()))
        yield serialize_message(message)
