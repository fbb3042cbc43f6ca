# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Ticks of an absolute clock, for devices that have none: no tick depends on how late the last one was.

They are whole multiples of the period on the monotonic clock: devices of one period tick together.
"""

import math
import time


class Ticks:
    """Ticks one ``period`` [s] apart; the first one is at most a period away."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._count = math.ceil(time.monotonic() / period)  # of the next tick

    def at(self) -> float:
        """Time [s] of the next tick, by `time.monotonic`."""
        return self._count * self._period

    def due(self) -> float:
        """Seconds until the next tick, 0.0 if it is over."""
        return max(0.0, self.at() - time.monotonic())

    def take(self, patience: float = 0.0) -> int:
        """Go on to the tick after the next one; returns how many ticks went by unused.

        Those are left out that lie more than ``patience`` [s] and more than a period back.
        """
        late = time.monotonic() - self.at()
        missed = math.floor(late / self._period) if late > max(patience, self._period) else 0
        self._count += missed + 1
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
