# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Stores the newest samples of a signal, and draws any part of them from minima and maxima."""

from typing import NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.analysis.indices import Indices, indices

ROOM = 1 << 18  # samples; when they are full, the older half is forgotten
LONGEST = 120.0  # s that a plot may show


class Course(NamedTuple):
    """A signal to be drawn: at each time the least and the largest value, equal where it is one sample."""

    time: Floats  # s
    low: Floats
    high: Floats


EMPTY = Course(np.empty(0), np.empty(0), np.empty(0))


class History:
    """Samples (time [s], value) of one signal, oldest first; times must not fall."""

    def __init__(self) -> None:
        # The operating system takes memory for what has been written alone.
        self._time, self._value = np.empty(ROOM), np.empty(ROOM)
        self._end = 0

    def __len__(self) -> int:
        return self._end

    @property
    def newest(self) -> float:
        """Time [s] of the last sample, -inf if there is none."""
        return float(self._time[self._end - 1]) if self._end else -np.inf

    def append(self, time: Floats, value: Floats) -> None:
        """Add samples. Those older than the newest are left out: a publisher whose clock was set back."""
        later = np.maximum.accumulate(np.append(self.newest, time))
        sound = time >= later[:-1]
        time, value = time[sound][-ROOM // 2 :], value[sound][-ROOM // 2 :]
        if self._end + len(time) > ROOM:
            for numbers in (self._time, self._value):
                numbers[: ROOM // 2] = numbers[self._end - ROOM // 2 : self._end]
            self._end = ROOM // 2
        end = self._end + len(time)
        self._time[self._end : end], self._value[self._end : end] = time, value
        self._end = end

    def between(self, start: float, end: float) -> tuple[Floats, Floats]:
        """Times [s] and values from ``start`` to ``end`` [s]."""
        a, b = np.searchsorted(self._time[: self._end], (start, end))
        return self._time[a:b], self._value[a:b]

    def value_at(self, time: float) -> float:
        """Last value at or before ``time`` [s], NaN if there is none."""
        at = int(np.searchsorted(self._time[: self._end], time, side="right")) - 1
        return float(self._value[at]) if at >= 0 else float("nan")

    def course(self, start: float, end: float, columns: int) -> Course:
        """What is to be drawn from ``start`` to ``end`` [s] in ``columns`` columns: samples if they are few.

        No extreme is lost: each column has the least and the largest of its samples. Its borders are
        multiples of its width, so that a picture that moves on does not flicker. Values that are no numbers
        are left out.
        """
        width = (end - start) / columns
        if not (width > 0.0 and self._end):
            return EMPTY
        edges = np.floor(start / width) * width + width * np.arange(columns + 2)
        time, value = self._time[: self._end], self._value[: self._end]
        borders = np.searchsorted(time, edges)
        a, b = int(borders[0]), int(borders[-1])
        if b - a <= 2 * columns:
            # One sample beyond each end, so that the line reaches the edges of the picture.
            a, b = max(0, a - 1), min(self._end, b + 1)
            sound = np.isfinite(value[a:b])
            return Course(time[a:b][sound], value[a:b][sound], value[a:b][sound])
        filled = np.flatnonzero(borders[1:] > borders[:-1])
        stop, starts = int(borders[filled[-1] + 1]), borders[filled]
        lows, highs = (f.reduceat(value[:stop], starts) for f in (np.fmin, np.fmax))
        sound = np.isfinite(lows) & np.isfinite(highs)
        return Course((edges[filled] + 0.5 * width)[sound], lows[sound], highs[sound])


def recent_indices(
    error: History, voltage: History, seconds: float, period: float, now: float
) -> Indices | None:
    """I1 to I5 over the last ``seconds`` of ``error`` [V] and ``voltage`` [V], sampled every ``period`` [s].

    None while there are less than ten samples of both, or if the newest of one is more than a second older
    than that of the other or than ``now`` [s].
    """
    end = min(error.newest, voltage.newest)
    if not np.isfinite(end) or max(error.newest, voltage.newest, now) > end + 1.0:
        return None
    _, e = error.between(end - seconds, np.nextafter(end, np.inf))
    _, u = voltage.between(end - seconds, np.nextafter(end, np.inf))
    count = min(len(e), len(u))
    if count < 10 or not (np.isfinite(e).all() and np.isfinite(u).all()):
        return None
    return indices(e[-count:], u[-count:], period)
