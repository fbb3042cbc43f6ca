# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Ticks of an absolute clock, for devices that have none: no tick depends on how late the last one was."""

import math
import time


class Ticks:
    """Ticks one ``period`` [s] apart, the first at once."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._next = time.monotonic()

    def due(self) -> float:
        """Seconds until the next tick, 0.0 if it is over."""
        return max(0.0, self._next - time.monotonic())

    def take(self) -> int:
        """Go on to the tick after now; returns how many ticks went by unused."""
        missed = max(0, math.floor((time.monotonic() - self._next) / self._period))
        self._next += (missed + 1) * self._period
        return missed

    def wait(self) -> int:
        """Sleep until the next tick and take it; returns how many went by unused."""
        time.sleep(self.due())
        return self.take()


class Lately:
    """Tells whether something happened within the last ``hold`` seconds, and how often since it began."""

    def __init__(self, hold: float = 1.0) -> None:
        self._hold = hold
        self._last = -math.inf
        self.count = 0

    def note(self, times: int = 1) -> None:
        """It happened now, ``times`` times."""
        if not self:
            self.count = 0
        self.count += times
        self._last = time.monotonic()

    def __bool__(self) -> bool:
        return time.monotonic() - self._last < self._hold
