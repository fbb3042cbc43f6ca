# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Statistics of the times of a loop, for /diagnostics.

They are made in the loop, between two readings. numpy, called once a second, takes 4 to 10 ms for them on two
virtual cores, and 0.1 ms when it is called again at once; a list takes 1.5 ms.
"""

from collections import deque
from collections.abc import Iterable, Sequence
from itertools import pairwise

WINDOW = 1000  # samples


class Timing:
    """When readings were answered, how long that took, and how long their voltages were on the way."""

    def __init__(self) -> None:
        self.arrivals: deque[float] = deque(maxlen=WINDOW)  # s
        self._latencies: deque[float] = deque(maxlen=WINDOW)  # s
        self._durations: deque[float] = deque(maxlen=WINDOW)  # s
        self.overruns = 0  # steps that took longer than a period

    def clear(self) -> None:
        """Forget the samples, but not the number of overruns."""
        for figures in (self.arrivals, self._latencies, self._durations):
            figures.clear()

    def note(self, began: float, ended: float, latency: float, period: float) -> None:
        """Take in a sample that ``began`` and ``ended`` [s], with its ``latency`` and ``period`` [s]."""
        self.arrivals.append(began)
        self._latencies.append(latency)
        self._durations.append(ended - began)
        self.overruns += ended - began > period

    def figures(self, period: float) -> dict[str, str]:
        """Mean period, and spreads of its deviation from ``period`` [s], of latencies and durations."""
        spreads = spread("latency_ms", self._latencies) | spread("step_ms", self._durations)
        return of_periods(self.arrivals, period) | spreads if len(self.arrivals) > 1 else {}


def of_periods(arrivals: Sequence[float], period: float) -> dict[str, str]:
    """Mean time between ``arrivals`` [s], and spread of its deviation from ``period`` [s]."""
    if len(arrivals) < 2:
        return {}
    mean = (arrivals[-1] - arrivals[0]) / (len(arrivals) - 1)
    deviations = (abs(after - before - period) for before, after in pairwise(arrivals))
    return {"period_ms": f"{1e3 * mean:.4f}", **spread("jitter_ms", deviations)}


def spread(name: str, times: Iterable[float]) -> dict[str, str]:
    """Median, 99th percentile and largest of ``times`` [s] in ms, under ``name``; nothing of none."""
    ordered = sorted(times)
    if not ordered:
        return {}
    shares = (("p50", 0.5), ("p99", 0.99), ("max", 1.0))
    return {
        f"{name}_{label}": f"{1e3 * ordered[int(share * (len(ordered) - 1))]:.4f}" for label, share in shares
    }
