# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Measures how regularly the messages of a topic came: rate, jitter, gaps, order."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import minimum_filter1d

from valve_control.arrays import Floats, Integers
from valve_control.control.analysis.indices import PAUSE

LATE = 1.5  # periods between two messages from which on it is a gap
MOST_SENT = 1.5  # times as many messages as fit into the time at their usual interval can have been sent
APART = 100  # readings between the two whose distance in time is measured
LEAP = 5.0  # periods by which time leaps away from the readings' numbers where it is not jitter
SURE = 2000  # readings before and after it that must agree
LEAST = 200  # readings from which a period is measured
REGULAR = 0.3  # part of the mean by which the usual interval of messages that come regularly may differ
ON_GRID = 0.1  # of that interval by which its multiples may differ where messages are missing ...
MOSTLY = 0.95  # ... and share of the intervals that are such multiples
PART_DEVIATION = 0.1  # by which the period of a recorded test may differ from its own


class Spread(NamedTuple):
    """Percentiles of a duration."""

    p50: float  # s
    p99: float  # s
    max: float  # s


class Timing(NamedTuple):
    """How regularly the messages of one topic came."""

    messages: int
    rate_hz: float
    period_s: float  # median
    jitter_s: Spread  # distance of an interval from the median
    gaps: int | None  # intervals longer than LATE periods, None where the stamps are too coarse for it
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
    """Regularity of a topic from the times [ns], in order, and sequence numbers of its messages."""
    intervals = np.diff(time) * 1e-9
    if len(intervals) == 0:
        return Timing(len(time), np.nan, np.nan, spread(intervals), 0, np.nan, None)
    period = float(np.median(intervals))
    # A pause, or a clock that was set forward, is no slower rate; lost readings are.
    lost = lost_messages(sequence)
    numbers = np.ones(len(intervals)) if lost is None else np.diff(sequence)
    paused = (intervals > PAUSE * period) & (numbers * period < 0.5 * intervals)
    span = float(time[-1] - time[0]) * 1e-9 - float(np.sum(intervals[paused] - period))
    if lost is not None and (len(time) + lost - APART) * period > MOST_SENT * span:
        lost = None  # more than were sent: the numbers count something else too
    return Timing(
        messages=len(time),
        rate_hz=len(intervals) / span if span > 0.0 else np.nan,
        period_s=period,
        jitter_s=spread(np.abs(intervals - period)),
        gaps=int(np.count_nonzero(intervals > LATE * period)),
        longest_gap_s=float(np.max(intervals)),
        lost=lost,
    )


def without_intervals(timing: Timing) -> Timing:
    """``timing`` without what single intervals tell, for stamps that are coarser than these."""
    return timing._replace(jitter_s=spread(np.empty(0)), gaps=None, longest_gap_s=np.nan)


def _slopes(time: Integers, sequence: Integers, apart: int) -> Floats:
    """Time [s] per number from a reading to the one ``apart`` after it; NaN where the numbers begin anew."""
    steps = (sequence[apart:] - sequence[:-apart]).astype(np.float64)
    steps[steps <= 0.0] = np.nan
    return (time[apart:] - time[:-apart]) * 1e-9 / steps


def _slopes_without_gaps(time: Integers) -> Floats:
    """Time [s] per reading over readings without a gap between them, as many as there are such."""
    count = np.arange(len(time), dtype=np.int64)
    intervals = np.diff(time) * 1e-9
    usual = float(np.median(intervals))
    everywhere = _slopes(time, count, APART)
    middle = float(np.median(everywhere))
    if abs(usual - middle) > REGULAR * middle:
        # Whole multiples of the shortest interval are losses. Of messages that come in bursts no interval
        # tells whether one is missing in it.
        ratio = intervals / usual if usual > 0.0 else np.zeros(1)
        multiple = np.round(ratio)
        on_grid = (np.abs(ratio - multiple) < ON_GRID) & (multiple >= 1.0) & (multiple <= LEAP)
        if np.mean(on_grid) < MOSTLY:
            return everywhere
        return _slopes(time, np.concatenate([[0], np.cumsum(multiple.astype(np.int64))]), APART)
    gaps = np.concatenate([[0], np.cumsum(intervals > LATE * usual)])
    for apart in (APART, 30, 10, 3):
        whole = gaps[apart:] == gaps[:-apart]
        if np.count_nonzero(whole) >= max(50, 0.02 * len(time)):
            slopes: Floats = _slopes(time, count, apart)[whole]
            return slopes
    return everywhere


def true_period(time: Integers, sequence: Integers) -> float:
    """Period [s] with which a publisher sends, from times of sending [ns], in order, and its numbers.

    The median slope of time against number over APART readings: jitter is divided by that, lost readings
    count by their numbers (without numbers only stretches without a gap count), and a pause touches few
    slopes. NaN for less than LEAST readings, and where most of them share their stamps.
    """
    if len(time) < LEAST:
        return np.nan
    slopes = _slopes_without_gaps(time) if lost_messages(sequence) is None else _slopes(time, sequence, APART)
    slopes = slopes[np.isfinite(slopes)]
    period = float(np.median(slopes)) if len(slopes) else 0.0
    return period if period > 0.0 else np.nan


def leaps(time: Integers, number: Integers, period: float) -> Integers:
    """Where ``time`` [ns] leaps away from ``number`` times ``period`` [s] and stays away: index after it.

    A clock was set there, or nothing was sent or recorded for a while. A recorder that stands still and
    catches up makes none.
    """
    late = (time - time[0]) * 1e-9 - (number - number[0]) * period
    limit = LEAP * period
    steps = np.diff(late)
    back = np.flatnonzero(np.diff(time) < -round(limit * 1e9)) + 1
    bounds = np.concatenate([[0], back, [len(time)]])
    found = set(back.tolist())
    for at in (np.flatnonzero(np.abs(steps) > limit) + 1).tolist():
        k = int(np.searchsorted(bounds, at, side="right"))
        first, end = max(int(bounds[k - 1]), at - SURE), min(int(bounds[min(k, len(bounds) - 1)]), at + SURE)
        inside = at not in found and first < at < end
        if inside and abs(float(late[at:end].min() - late[first:at].min())) > limit:
            found.add(at)
    return np.array(sorted(found), dtype=np.int64)


def numbered_by_time(time: Integers, period: float) -> Integers:
    """Numbers from 0 for readings that have none: where some are missing in ``time`` [ns], up to LEAP.

    Later readings tell whether one was late or those before it are missing.
    """
    count = np.arange(len(time), dtype=np.int64)
    late = (time - time[0]) * 1e-9 / period - count
    missing = np.diff(np.round(np.minimum.accumulate(late[::-1])[::-1]), prepend=0.0)
    missing[0] = 0.0
    missing[missing > LEAP] = 0.0
    return count + np.cumsum(missing).astype(np.int64)


def placed(sent: Floats, numbers: Integers, period: float) -> tuple[Integers, npt.NDArray[np.bool_]]:
    """Sample of each reading by the time ``sent`` [s] at which it came, and which of them were late.

    While their sender stood still, time went on: the ``numbers`` do not show it. A reading is late if those
    that follow have made good what it missed.
    """
    measured = true_period(np.round(1e9 * sent).astype(np.int64), numbers)
    if not abs(measured / period - 1.0) <= PART_DEVIATION:
        measured = period
    behind = sent / measured - numbers
    soonest = minimum_filter1d(behind, 2 * APART + 1, origin=-APART, mode="nearest")
    missing = np.round(np.maximum.accumulate(soonest) - soonest[0]).astype(np.int64)
    return numbers + missing, behind - soonest > LATE - 1.0


def means(edges: Floats, sent: Floats, values: Floats) -> Floats:
    """Mean of ``values`` between two ``edges`` [s] each; one holds from its time ``sent`` [s] to the next.

    Between edges of the same time, the value there.
    """
    begin, end = min(edges[0], sent[0]) - 1.0, max(edges[-1], sent[-1]) + 1.0
    times, held = np.concatenate([[begin], sent, [end]]), np.concatenate([values[:1], values])
    integral = np.interp(edges, times, np.concatenate([[0.0], np.cumsum(held * np.diff(times))]))
    lengths, there = np.diff(edges), held[np.searchsorted(times, edges[:-1], side="right") - 1]
    mean: Floats = np.divide(np.diff(integral), lengths, out=there, where=lengths > 0.0)
    return mean


def latencies(sent: Floats, answers: Floats) -> Floats:
    """Time [s] from each reading ``sent`` [s] to the first of the ``answers`` [s] before the next reading."""
    if len(answers) == 0:
        return np.empty(0)
    after = np.searchsorted(answers, sent, side="right")
    answer = answers[np.minimum(after, len(answers) - 1)]
    answered = (answer > sent) & (answer <= np.append(sent[1:], np.inf))
    waited: Floats = (answer - sent)[answered]
    return waited
