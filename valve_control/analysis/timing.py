"""How regularly the messages of a topic came: rate, jitter, gaps, order."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
LATE = 1.5  # periods between two messages from which on it is a gap


class Spread(NamedTuple):
    """Percentiles of a duration."""

    p50: float  # s
    p99: float  # s
    max: float  # s


class Timing(NamedTuple):
    """Sample-rate quality of one topic."""

    messages: int
    rate_hz: float
    period_s: float  # median
    jitter_s: Spread  # distance of an interval from the median
    gaps: int  # intervals longer than LATE periods
    longest_gap_s: float
    lost: int | None  # by the publisher's sequence numbers, None where the bag has none


def spread(durations: Floats) -> Spread:
    """Percentiles of ``durations`` [s]; NaN if there are none."""
    if len(durations) == 0:
        return Spread(np.nan, np.nan, np.nan)
    p50, p99, most = np.percentile(durations, [50, 99, 100])
    return Spread(float(p50), float(p99), float(most))


def lost_messages(sequence: Integers) -> int | None:
    """Numbers missing from the sequence of one publisher, which may have restarted; None without numbers."""
    steps = np.diff(sequence)
    if len(sequence) == 0 or not np.any(sequence) or not np.any(steps):
        return None
    return int(np.sum(steps[steps > 1] - 1))


def timing(time: Integers, sequence: Integers) -> Timing:
    """Sample-rate quality from the times [ns], in order, and sequence numbers of a topic's messages."""
    intervals = np.diff(time) * 1e-9
    if len(intervals) == 0:
        return Timing(len(time), np.nan, np.nan, spread(intervals), 0, np.nan, None)
    span = float(time[-1] - time[0]) * 1e-9
    period = float(np.median(intervals))
    return Timing(
        messages=len(time),
        rate_hz=len(intervals) / span if span > 0.0 else np.nan,
        period_s=period,
        jitter_s=spread(np.abs(intervals - period)),
        gaps=int(np.count_nonzero(intervals > LATE * period)),
        longest_gap_s=float(np.max(intervals)),
        lost=lost_messages(sequence),
    )
