# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Keeps the last ten minutes of signals, and draws any part of them from minima and maxima."""

from typing import NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.analysis.indices import Indices, indices

KEPT = 600.0  # s
BLOCK = 64  # samples whose minimum and maximum are kept ready
FIRST_ROOM = 1 << 14  # samples
MOST_ROOM = 1 << 21  # samples, of one signal; what is older than these is forgotten too


class Course(NamedTuple):
    """A signal to be drawn: at each time the least and the largest value, equal where it is one sample."""

    time: Floats  # s
    low: Floats
    high: Floats


EMPTY = Course(np.empty(0), np.empty(0), np.empty(0))


class History:
    """Samples (time [s], value) of one signal, oldest first; times must not fall."""

    def __init__(self) -> None:
        self._time = np.empty(FIRST_ROOM)
        self._value = np.empty(FIRST_ROOM)
        self._low = np.empty(FIRST_ROOM // BLOCK)
        self._high = np.empty(FIRST_ROOM // BLOCK)
        self._end = 0
        self._blocks = 0  # complete ones

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
        if not sound.all():
            time, value = time[sound], value[sound]
        for at in range(0, len(time), FIRST_ROOM // 2):
            self._append(time[at : at + FIRST_ROOM // 2], value[at : at + FIRST_ROOM // 2])

    def _append(self, time: Floats, value: Floats) -> None:
        end = self._end + len(time)
        if end > len(self._time):
            self._make_room(len(time))
            end = self._end + len(time)
        self._time[self._end : end] = time
        self._value[self._end : end] = value
        self._end = end
        blocks = end // BLOCK
        if blocks > self._blocks:
            rows = self._value[self._blocks * BLOCK : blocks * BLOCK].reshape(-1, BLOCK)
            self._low[self._blocks : blocks] = np.fmin.reduce(rows, axis=1)
            self._high[self._blocks : blocks] = np.fmax.reduce(rows, axis=1)
            self._blocks = blocks

    def _make_room(self, count: int) -> None:
        """Forget what is too old, whole blocks at a time; take more memory if that frees too little."""
        first = int(np.searchsorted(self._time[: self._end], self.newest - KEPT)) // BLOCK
        room = len(self._time)
        left = self._end - first * BLOCK
        if left + count > room - room // 4:
            if room < MOST_ROOM:
                room *= 2
            else:
                first = max(first, (room // 4) // BLOCK)
        kept = slice(first * BLOCK, self._end)
        blocks = slice(first, self._blocks)
        size = self._end - first * BLOCK
        for name, part, length in (
            ("_time", kept, room),
            ("_value", kept, room),
            ("_low", blocks, room // BLOCK),
            ("_high", blocks, room // BLOCK),
        ):
            before = getattr(self, name)
            rest = before[part].copy()
            after = before if len(before) == length else np.empty(length)
            after[: len(rest)] = rest
            setattr(self, name, after)
        self._end = size
        self._blocks -= first

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
        first = np.floor(start / width) * width
        edges = first + width * np.arange(columns + 2)
        time = self._time[: self._end]
        borders = np.searchsorted(time, edges)
        a, b = int(borders[0]), int(borders[-1])
        # One sample beyond each end, so that the line reaches the edges of the picture.
        if b - a <= 2 * columns:
            a, b = max(0, a - 1), min(self._end, b + 1)
            value = self._value[a:b]
            sound = np.isfinite(value)
            return Course(time[a:b][sound], value[sound], value[sound])
        if b - a > 8 * BLOCK * columns:
            # Whole blocks to the column in which they begin: at most an eighth of a column off.
            borders = -(-borders // BLOCK)
            low, high = self._low[: self._blocks], self._high[: self._blocks]
        else:
            low = high = self._value[: self._end]
        borders = np.minimum(borders, len(low))
        filled = np.flatnonzero(borders[1:] > borders[:-1])
        if len(filled) == 0:
            return EMPTY
        stop = int(borders[filled[-1] + 1])
        starts = borders[filled]
        lows = np.fmin.reduceat(low[:stop], starts)
        highs = np.fmax.reduceat(high[:stop], starts)
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
