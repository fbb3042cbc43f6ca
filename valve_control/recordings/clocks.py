# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Decides which clock all times of a recording are of.

One rule: the times of sending (publish_time) count if all messages of a valve's signals have one, if they
never go back nor repeat where those of recording do not, run as fast as these, and if the clocks of the
publishers agree. Otherwise the times of recording (log_time) count, and a note says why.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from valve_control.arrays import Integers
from valve_control.recordings.bags.bag import FAR, Series, stretch
from valve_control.recordings.bags.errors import BagError

SMALL_DISORDER = 0.1  # s by which messages may be out of order
BACK = 2.0  # usual intervals by which time goes back, between messages in order, where the clock was set
SAME_CLOCK = 1e-3  # s, or half a period, by which delays to the recorder may differ between topics
MISSING = 0.02  # of the messages without a source time from which on that counts
SAME_SPEED = 0.01  # by which the speeds of two clocks may differ
PIECES = 20  # of a recording
PROMPT = 10.0  # % of them in which one message at least is recorded at once
MANY = 10  # messages of a topic from which on its own times tell of its clock
SHARED = 0.05  # of the messages that have the stamp of the one before where the clock is coarse


class Clock(NamedTuple):
    """The clock that all times of a recording are of."""

    name: str  # log_time, publish_time, or that of a table
    notes: tuple[str, ...] = ()

    def read(self, series: Mapping[str, Series]) -> dict[str, Series]:
        """``series`` whose publish_time is of this clock, so that nothing is taken from the other."""
        if self.name != "log_time":
            return dict(series)
        return {name: one._replace(publish_time=one.log_time) for name, one in series.items()}


def in_order(sequence: Integers) -> bool:
    """Whether messages have the numbers of one publisher, each larger than the one before."""
    return len(sequence) > 1 and bool(np.all(np.diff(sequence) > 0))


def shared(time: Integers) -> bool:
    """Whether messages of a topic share their stamps ``time`` [ns], as those of a coarse clock."""
    steps = np.diff(time)
    return len(time) >= MANY and int(np.count_nonzero(steps == 0)) > SHARED * len(steps)


def leaps(time: Integers, sequence: Integers) -> Integers:
    """Where the clock of ``time`` [ns] was set: by FAR, or back; by a little where numbers are in order."""
    intervals = np.diff(time)
    usual = float(np.median(intervals)) if in_order(sequence) else np.inf
    back = -min(SMALL_DISORDER * 1e9, BACK * max(usual, 0.0))
    return np.flatnonzero((intervals < back) | (intervals > FAR * 1e9))


def decide(
    series: Mapping[str, Series], groups: Iterable[Sequence[str]], wanted: str | None, path: object
) -> Clock:
    """The clock for a recording: ``wanted`` (log or publish), else the one of the rule above.

    ``groups``: topics of each valve, whose publishers must agree. Raises BagError if there is no such clock.
    """
    groups = [[name for name in dict.fromkeys(group) if len(series[name].log_time)] for group in groups]
    names = list(dict.fromkeys(name for group in groups for name in group))
    same = {name: float(np.mean(series[name].publish_time == series[name].log_time)) for name in names}
    without = [name for name in names if same[name] == 1.0]
    if wanted == "publish" and (without or not names):
        which = f" on {', '.join(without)}" if len(without) < len(names) else ""
        raise BagError(f"--clock publish: {path} has no publish_time of its own{which}; take --clock log")
    if len(without) == len(names):
        return Clock("log_time")
    longest = max((series[n] for n in names if n not in without), key=lambda one: len(one.log_time))
    speed = _speed(longest)
    # Both of the times of recording and of those of sending.
    coarse = {n: [shared(time) for time in series[n][:2]] for n in names}
    back = {n: [len(leaps(time, series[n].sequence)) for time in series[n][:2]] for n in names}
    faults = {
        "messages of {} have no source times": [
            n for n in names if same[n] == 1.0 or (same[n] > MISSING and not coarse[n][0])
        ],
        "source times go backwards on {}": [n for n in names if back[n][1] > back[n][0]],
        "the clocks run at different speeds (publish_time goes on by {} s in each second of log_time)": (
            [f"{speed:.4g}"] if abs(speed - 1.0) > SAME_SPEED else []
        ),
        "source times are shared by messages of {}": [n for n in names if coarse[n] == [False, True]],
        "the publishers' clocks differ (time until recorded, over the shortest: {})": [
            text for group in groups for text in _differing(series, group)
        ],
    }
    reason = next((text.format(", ".join(which)) for text, which in faults.items() if which), "")
    if wanted == "log" or (reason and wanted != "publish"):
        note = f"{reason}; times of recording are used (log_time; --clock publish takes the others)"
        return Clock("log_time", (note,) if reason else ())
    return Clock("publish_time", (f"{reason}; publish_time is used",) if reason else ())


def _differing(series: Mapping[str, Series], group: Sequence[str]) -> list[str]:
    """How the clocks of the publishers of one valve differ, [] if they do not."""
    delays = {name: _delay(series[name]) for name in group}
    times = [series[name].publish_time for name in group]
    intervals = [float(np.median(np.diff(time))) * 1e-9 for time in times if len(time) > 1]
    least = min(delays.values(), default=0.0)
    if max(delays.values(), default=0.0) - least <= max(SAME_CLOCK, 0.5 * max(intervals, default=0.0)):
        return []
    return [f"{name} {1e3 * (delay - least):+.3f} ms" for name, delay in delays.items()]


def _delay(series: Series) -> float:
    """Time [s] from publisher to recorder, with the difference of their clocks.

    The shortest of pieces in which messages were recorded at once; what waits for a busy recorder says
    nothing of clocks.
    """
    delays = (series.log_time - series.publish_time) * 1e-9
    shortest = [piece.min() for piece in np.array_split(delays, min(PIECES, len(delays)))]
    return float(np.percentile(shortest, PROMPT))


def _speed(series: Series) -> float:
    """Speed of publish_time over that of log_time, by the median over half the recording; NaN if unknown."""
    half = len(series.log_time) // 2
    if half < MANY:
        return np.nan
    log, publish = (time[half:] - time[:-half] for time in (series.log_time, series.publish_time))
    usable = log > 0
    return float(np.median(publish[usable] / log[usable])) if usable.any() else np.nan


def without_strays(series: Mapping[str, Series], problems: list[str]) -> dict[str, Series]:
    """``series`` without messages that were recorded an hour or more away from most, which are named.

    Likewise without those that were sent an hour or more earlier or later than usual before recording.
    """
    log = [one.log_time for one in series.values() if len(one.log_time)]
    first, last = stretch(np.concatenate(log)) if log else (0, 0)
    found = {}
    for name, one in series.items():
        far = (one.log_time < first) | (one.log_time > last)
        if not far.all():
            delay = (one.log_time - one.publish_time).astype(np.float64)
            far |= np.abs(delay - np.median(delay[~far])) > FAR * 1e9
        count = int(np.count_nonzero(far))
        if count:
            problems.append(
                f"{count} of {len(far)} messages of {name} have a stamp far from all others, by an hour or "
                "more, and are left out"
            )
        found[name] = one.pick(~far) if count else one
    return found
