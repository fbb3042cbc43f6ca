# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Topics of a controller about itself: samples on ~/state, journal and snapshots."""

import math
import time
from struct import pack
from typing import Any

from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout, String

from valve_control.control.supervision.journal import Journal
from valve_control.control.supervision.state_snapshot import snapshot
from valve_control.control.supervision.supervisor import Supervisor
from valve_control.nodes.adapter import SAMPLES, head

MOST_ROWS = 500  # of the journal at once
GREETING = 20  # parts of the journal with an account, since who comes does not hear everything at once


class Telemetry:
    """Publishes every n-th sample on ~/state."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._labels: tuple[str, ...] = ()
        self._head = b""  # of a serialized ~/state, before its numbers
        self._every = 0
        self._samples: list[list[float]] = []  # to be published

    def apply(self, labels: tuple[str, ...], every: int) -> None:
        """Numbers with the ``labels`` follow, of each ``every``-th sample; 0: of none."""
        self._every = every
        if self._labels != labels:
            self._labels = labels
            dim = [MultiArrayDimension(label=label, size=1, stride=1) for label in labels]
            self._head = head(Float64MultiArray(layout=MultiArrayLayout(dim=dim)), len(labels))

    def open(self) -> None:
        """Create the publisher."""
        self._states = self._node.create_publisher(Float64MultiArray, "~/state", SAMPLES)

    def note(self, supervisor: Supervisor) -> None:
        """Take in the sample that ``supervisor`` has answered, if it is one of those that are published."""
        if self._every > 0 and supervisor.memory.samples % self._every == 0:
            self._samples.append(supervisor.telemetry())

    def publish(self) -> None:
        """Publish what has been taken in."""
        for numbers in self._samples:
            self._states.publish(self._head + pack(f"<{len(numbers)}d", *numbers))
        self._samples.clear()


class JournalTopics:
    """Publishes the rows of a journal, and now and then a snapshot of all that the supervisor remembers."""

    def __init__(self, node: Any, journal: Journal, supervisor: Supervisor) -> None:
        self._node = node
        self._journal = journal
        self._supervisor = supervisor
        self._message = Float64MultiArray()
        self.period = 0.0  # s  of the snapshots; 0.0: nothing is published
        self._accounted = -math.inf  # s, last snapshot
        self._readers = 0
        self._greeting = 0  # parts of the journal that still bring a snapshot

    def open(self) -> None:
        """Create the publishers."""
        self._memories = self._node.create_publisher(String, "~/memory", SAMPLES)
        self.publisher = self._node.create_publisher(Float64MultiArray, "~/journal", SAMPLES)
        self._readers = self._greeting = 0

    def _count_readers(self) -> int:
        return int(self.publisher.get_subscription_count() + self._memories.get_subscription_count())

    def look(self) -> None:
        """Publish what waits, for a while with snapshots if a reader has come."""
        readers = self._count_readers()
        if readers > self._readers:
            self._greeting = GREETING
        self._readers = readers
        if self._greeting > 0:
            self._greeting -= 1
            self._accounted = -math.inf
        self.publish()

    def publish_many(self) -> None:
        """Publish if many rows wait."""
        if len(self._journal) >= MOST_ROWS:
            self.publish()

    def publish(self) -> None:
        """Publish the waiting rows, and a snapshot when its time has come."""
        if not self._node.configured:
            return
        rows = self._journal.take()
        if self.period == 0.0 or self._count_readers() == 0:
            return
        if rows:
            self._message.data = rows
            self.publisher.publish(self._message)
        now = time.monotonic()
        journal = self._journal
        if journal.owes_account or now - self._accounted >= self.period:
            self._accounted, journal.owes_account = now, False
            account = snapshot(self._supervisor, journal.run, journal.count)
            self._memories.publish(String(data=account))
