# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Counts the times from reading to voltage in a histogram of even steps in logarithm."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats

KEPT = 10_000  # voltages
LEAST, MOST, BINS = 0.02, 50.0, 34  # ms; a tenth of a decade each


class Histogram(NamedTuple):
    """Counts of latencies between the borders [ms]; what lies beyond the ends is counted in the last bins."""

    borders: Floats  # ms, one more than counts
    counts: npt.NDArray[np.int64]
    p50: float  # ms
    p99: float  # ms
    largest: float  # ms


class Latencies:
    """Times from each reading to its voltage, of the last ones."""

    def __init__(self) -> None:
        self._values = np.empty(KEPT)
        self._count = 0

    def pair(self, readings: Floats, voltages: Floats) -> None:
        """Add the time from the last reading to each voltage; both are times of sending [s] in order.

        A voltage more than a second after it answers no reading.
        """
        if len(readings) == 0 or len(voltages) == 0:
            return
        at = np.searchsorted(readings, voltages, side="right") - 1
        late = 1e3 * (voltages - readings[np.maximum(at, 0)])
        late = late[(at >= 0) & (late < 1000.0)][-KEPT:]
        places = (self._count + np.arange(len(late))) % KEPT
        self._values[places] = late
        self._count += len(late)

    def histogram(self) -> Histogram | None:
        """Histogram of the last ones, None if there are none."""
        values = self._values[: min(self._count, KEPT)]
        if len(values) == 0:
            return None
        borders = np.geomspace(LEAST, MOST, BINS + 1)
        counts, _ = np.histogram(np.clip(values, LEAST, MOST), borders)
        p50, p99 = np.percentile(values, (50.0, 99.0))
        return Histogram(borders, counts, float(p50), float(p99), float(values.max()))
