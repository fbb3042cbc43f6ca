# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Hears whether somebody else gives voltages to the valve of a controller, which then has to stop.

In its first 2 s of voltages a controller stops after two windows, since the valve may be controlled already.
Two of the same age both stop: neither knows which is right. Voltages count, not publishers: an inactive
controller has a publisher too, and that of a killed process stays in the graph for a while.
"""

import time
from typing import Any

from valve_control.nodes.adapter import EVERYTHING, NumberSubscription

# s and sample periods of the windows in which the voltages of others are counted: the larger of both
WINDOW, WINDOW_PERIODS = 0.2, 10
YOUNG = 2.0  # s of voltages, which middlewares need to show who else is there
SURE = 2  # windows in a row with voltages of others after which a young one stops: a count may be wrong
BOTH = 10  # likewise of an old one; a young one has stopped by then
MOST = 2  # voltages of a window by which a count may be wrong at its edges


class Rivals:
    """Counts the voltages that others give to the valve of ``node``, while somebody else may give any."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self.given = 0  # voltages of this controller since it began to control
        self._subscription: NumberSubscription | None = None
        self._row = 0  # windows in a row with voltages of others
        self._end = 0.0  # s  of the window
        self._heard, self._given_before = 0, 0  # voltages in it, and of this controller before it

    def listen(self, wanted: bool, period: float) -> None:
        """Subscribe to the voltages on the topic, or do not; ``period`` [s] of the samples."""
        if wanted and self._subscription is None:
            self._subscription = NumberSubscription(self._node, "valve_voltage", EVERYTHING)
            self._row = 0
            self._begin_window(period)
        elif not wanted and self._subscription is not None:
            self._subscription.destroy()
            self._subscription = None

    def _begin_window(self, period: float) -> None:
        self._end = time.monotonic() + max(WINDOW, WINDOW_PERIODS * period)
        self._heard, self._given_before = 0, self.given

    def control(self, period: float) -> bool:
        """Whether others have given so many voltages that this controller has to stop."""
        if self._subscription is None:
            return False
        self._heard += sum(1 for _ in self._subscription.take())
        if time.monotonic() < self._end:
            return False
        own = self.given - self._given_before
        self._row = self._row + 1 if self._heard > own + MOST else 0
        self._begin_window(period)
        return self._row >= (SURE if self.given * period < YOUNG else BOTH)
