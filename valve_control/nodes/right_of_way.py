# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Decides which of several controllers of one valve controls: at most one goes on.

Who has answered readings for less than ``YOUNG`` and hears voltages of somebody else stops, since he would
disturb a valve that is controlled. If two controlled before they saw each other, the one whose publisher has
the larger GID stops: both know both GIDs, so they agree without a message. Who stopped begins again when
nobody else gives voltages. Then the one with the smallest GID is the first. Voltages count, not publishers:
an inactive controller has a publisher too, and that of a killed process stays in the graph for a while.
"""

import time
from typing import Any, NamedTuple

from valve_control.nodes.adapter import EVERYTHING, NumberSubscription

# s and sample periods of the windows in which the voltages of others are counted: the larger of both
WINDOW, WINDOW_PERIODS = 0.2, 10
NEVER = float("inf")
YOUNG = 2.0  # s, which middlewares need to show who else is there
BOTH = 5  # windows in a row with voltages of two after which one stops
QUIET = 3  # windows in a row without voltages after which one begins that does not have the smallest GID
MOST = 2  # voltages of a window by which a count may be wrong at its edges


class State(NamedTuple):
    """Whether a controller stands by, and whether there are voltages of others."""

    stands_by: bool
    row: int  # windows in a row with voltages of others, or while it stands by without


ACTIVE = State(False, 0)


def step(s: State, others: int, active: float, is_first: bool) -> State:
    """State after a window with ``others`` voltages of somebody else, ``active`` [s] after the first answer.

    ``is_first``: whether no publisher of voltages has a smaller GID.
    """
    row = s.row + 1 if (others > MOST) != s.stands_by else 0
    if s.stands_by:
        return ACTIVE if row >= (1 if is_first else QUIET) else State(True, row)
    stops = row > 0 and (active < YOUNG or (row >= BOTH and not is_first))
    return State(stops, 0 if stops else row)


class Rivals:
    """Counts the voltages that others give to the valve of ``node``, while somebody else may give any."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._state = ACTIVE
        self._active_since = NEVER  # s
        self._gid = b""  # of this controller's publisher
        self.given = 0  # voltages of this controller
        self._subscription: NumberSubscription | None = None
        self._end = 0.0  # s  of the window
        self._heard, self._given_before = 0, 0  # voltages in it, and of this controller before it

    @property
    def stands_by(self) -> bool:
        """Whether another one controls the valve."""
        return self._state.stands_by

    def publishers(self) -> set[bytes]:
        """GIDs of the publishers of voltages."""
        infos = self._node.get_publishers_info_by_topic("valve_voltage")
        return {bytes(info.endpoint_gid) for info in infos}

    def know_own(self, before: set[bytes]) -> None:
        """Take for its own the publisher that was not there ``before``."""
        self._gid = min(self.publishers() - before, default=b"")

    def begin(self) -> None:
        """The controller begins to control."""
        self._state, self._active_since = ACTIVE, NEVER

    def answered(self, now: float) -> None:
        """The controller has answered a reading at ``now`` [s]."""
        if self._active_since == NEVER:
            self._active_since = now

    def listen(self, wanted: bool, period: float) -> None:
        """Subscribe to the voltages on the topic, or do not; ``period`` [s] of the samples."""
        if wanted and self._subscription is None:
            self._subscription = NumberSubscription(self._node, "valve_voltage", EVERYTHING)
            self._begin_window(time.monotonic(), period)
        elif not wanted and self._subscription is not None:
            self._subscription.destroy()
            self._subscription = None

    def _begin_window(self, now: float, period: float) -> None:
        self._end = now + max(WINDOW, WINDOW_PERIODS * period)
        self._heard, self._given_before = 0, self.given

    def changed(self, period: float) -> bool:
        """Whether ``stands_by`` is another one than before, since others give voltages or do not."""
        if self._subscription is None:
            return False
        self._heard += sum(1 for _ in self._subscription.take())
        now = time.monotonic()
        if now < self._end:
            return False
        before, first = self.stands_by, min(self.publishers(), default=b"")
        others = self._heard - (self.given - self._given_before)
        self._state = step(self._state, others, now - self._active_since, self._gid <= first)
        self._begin_window(now, period)
        return self.stands_by != before
