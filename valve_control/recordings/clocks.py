# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Decides which clock a recording is read by, and leaves out messages with stamps far from all others."""

import datetime
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from valve_control.arrays import Integers
from valve_control.recordings.bags.bag import FAR, Series, edges, stretch
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.table import TableFile

Mask = npt.NDArray[np.bool_]
SMALL_DISORDER = 0.1  # s by which messages may be out of order
BACK = 2.0  # usual intervals by which time goes back, between messages in order, where the clock was set
SAME_CLOCK = 1e-3  # s, or half a period, by which delays to the recorder may differ between topics
MISSING = 0.02  # of the messages without a source time from which on that counts
SAME_SPEED = 0.01  # by which the speeds of two clocks may differ
PIECES = 20  # of a recording
PROMPT = 10.0  # % of them in which one message at least is recorded at once
MANY = 10  # messages of a topic from which on its own times tell which of them stand apart
SHARED = 0.05  # of the messages that have the stamp of the one before where the clock is coarse
FEW, FEW_SHARE = 3, 1e-3  # messages that may be strays; more are a part of the recording
SPIKE = 5  # messages in a row, of which two may stand apart


class Clock(NamedTuple):
    """The clock that all times of a recording are of."""

    name: str  # log_time, publish_time, header.stamp, /clock, or that of a table
    speed: float  # of publish_time over log_time, NaN where it is not known
    offset: float  # s  of publish_time from log_time, NaN where it is not known
    notes: tuple[str, ...]

    @property
    def source(self) -> bool:
        """Whether times are those at which messages were sent, not recorded."""
        return self.name == "publish_time"

    @property
    def apart(self) -> bool:
        """Whether the two clocks of the recording differ in speed, or by more than disorder."""
        return abs(self.speed - 1.0) > SAME_SPEED or abs(self.offset) > SMALL_DISORDER

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


def usual_step(time: Integers) -> float:
    """Usual time [s] between two stamps of ``time`` [ns] that differ, 0 if there are no two."""
    steps = np.diff(np.unique(time))
    return float(np.median(steps)) * 1e-9 if len(steps) else 0.0


def steps_back(time: Integers, sequence: Integers) -> Integers:
    """Where the clock of ``time`` [ns] was set back; by a little only where the numbers are in order."""
    intervals = np.diff(time)
    usual = float(np.median(intervals)) if in_order(sequence) else np.inf
    return np.flatnonzero(intervals < -min(SMALL_DISORDER * 1e9, BACK * max(usual, 0.0)))


def of_table(table: TableFile, wanted: str | None) -> Clock:
    """The clock of a table's rows. Raises BagError if another is ``wanted``."""
    if wanted is not None:
        raise BagError(f"--clock {wanted}: {table.path} is a table, whose rows have one time ({table.clock})")
    return Clock(table.clock, np.nan, np.nan, ())


def decide(
    series: Mapping[str, Series], groups: Iterable[Sequence[str]], wanted: str | None, path: object
) -> Clock:
    """The clock for a recording: ``wanted`` (log or publish), else publish_time if it is fit for all topics.

    ``groups``: topics of each valve, whose publishers must agree. Raises BagError if there is no such clock.
    """
    groups = [[name for name in dict.fromkeys(group) if len(series[name].log_time)] for group in groups]
    names = list(dict.fromkeys(name for group in groups for name in group))
    stamped = [name for name in names if np.any(series[name].publish_time != series[name].log_time)]
    without = [name for name in names if name not in stamped]
    partly = [name for name in stamped if _partly(series[name])]
    if wanted == "publish" and (without or not names):
        which = f" on {', '.join(without)}" if stamped else ""
        raise BagError(f"--clock publish: {path} has no publish_time of its own{which}; take --clock log")
    if not stamped:
        return Clock("log_time", np.nan, np.nan, ())
    longest = max((series[name] for name in stamped), key=lambda one: len(one.log_time))
    speed, offset = _speed(longest), float(np.median(longest.publish_time - longest.log_time)) * 1e-9
    backwards = [
        name
        for name in stamped
        if len(steps_back(series[name].publish_time, series[name].sequence))
        > len(steps_back(series[name].log_time, series[name].sequence))
    ]
    coarse = [
        name for name in stamped if shared(series[name].publish_time) and not shared(series[name].log_time)
    ]
    differ = "" if without else next(filter(None, (_differing(series, group) for group in groups)), "")
    reason = ""
    if without:
        reason = f"{', '.join(without)} has no source times"
    elif partly:
        reason = f"some messages of {', '.join(partly)} have no source times"
    elif backwards:
        reason = f"source times go backwards on {', '.join(backwards)}"
    elif abs(speed - 1.0) > SAME_SPEED:
        reason = (
            f"the clocks run at different speeds (publish_time goes on by {speed:.4g} s in each second of "
            "log_time)"
        )
    elif coarse:
        resolution = usual_step(series[coarse[0]].publish_time)
        reason = f"source times have a resolution of {1e3 * resolution:.4g} ms on {', '.join(coarse)}"
    else:
        reason = differ
    if wanted == "publish":
        return Clock("publish_time", speed, offset, (f"{reason}; publish_time is used",) if reason else ())
    if wanted == "log" or reason:
        note = f"{reason}; times of recording are used (log_time; --clock publish takes the others)"
        return Clock("log_time", speed, offset, (note,) if reason else ())
    return Clock("publish_time", speed, offset, ())


def _partly(series: Series) -> bool:
    """Whether some messages have no time of publication, so that theirs is that of recording."""
    same = series.publish_time == series.log_time
    share = float(np.mean(same)) if len(same) else 0.0
    return MISSING < share < 1.0 - MISSING and not (shared(series.publish_time) or shared(series.log_time))


def _differing(series: Mapping[str, Series], group: Sequence[str]) -> str:
    """How the clocks of the publishers of one valve differ, "" if they do not."""
    if not group:
        return ""
    delays = {name: _delay(series[name]) for name in group}
    times = [series[name].publish_time for name in group]
    intervals = [float(np.median(np.diff(time))) * 1e-9 for time in times if len(time) > 1]
    least = min(delays.values())
    if max(delays.values()) - least <= max(SAME_CLOCK, 0.5 * max(intervals, default=0.0)):
        return ""
    told = ", ".join(f"{name} {1e3 * (delay - least):+.3f} ms" for name, delay in delays.items())
    return f"the publishers' clocks differ (time until recorded, over the shortest: {told})"


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
    """``series`` without the few messages of which one stamp lies far from all others; they are named."""
    log = [one.log_time for one in series.values()]
    together = _far(np.concatenate([np.empty(0, dtype=np.int64), *log]))
    by_log = np.split(together, np.cumsum([len(times) for times in log])[:-1]) if log else []
    large = [one.publish_time for one in series.values() if len(one.publish_time) >= MANY]
    hulls = [stretch(time) for time in large]
    kept = {}
    for (name, one), far in zip(series.items(), by_log, strict=True):
        far = far | _spikes(one.log_time, far)
        publish = _far_published(one.publish_time, hulls)
        publish |= _spikes(one.publish_time, publish)
        for kind, mask, time in (
            ("log_time", far, one.log_time),
            ("publish_time", publish, one.publish_time),
        ):
            mask = mask & ~far if kind == "publish_time" else mask
            if mask.any():
                count = int(np.count_nonzero(mask))
                has = "messages of" if count > 1 else "message of"
                stamps = ", ".join(_date(stamp) for stamp in time[mask][:3].tolist())
                verb = "have stamps" if count > 1 else "has a stamp"
                problems.append(
                    f"{count} {has} {name} {verb} far from all others ({kind} {stamps}) and "
                    f"{'are' if count > 1 else 'is'} left out"
                )
        bad = far | publish
        kept[name] = one.pick(~bad) if bad.any() else one
    return kept


def _date(stamp: int) -> str:
    moment = datetime.datetime(1970, 1, 1) + datetime.timedelta(microseconds=stamp // 1000)
    return moment.isoformat(timespec="seconds")


def _far(time: Integers) -> Mask:
    """The few of ``time`` [ns] that lie hours from most."""
    if len(time) == 0:
        return np.zeros(0, dtype=np.bool_)
    stretches = np.searchsorted(edges(time), time.astype(np.float64), side="right")
    counts = np.bincount(stretches)
    few = counts <= max(FEW, FEW_SHARE * len(time))
    first = float(stretch(time)[0])
    few[int(np.searchsorted(edges(time), first, side="right"))] = False
    return np.asarray(few[stretches], dtype=np.bool_)


def _far_published(time: Integers, hulls: Sequence[tuple[int, int]]) -> Mask:
    """Likewise of times of publication; a topic of a few messages is compared with the others' ``hulls``."""
    if len(time) >= MANY or not hulls:
        return _far(time) if len(time) >= MANY else np.zeros(len(time), dtype=np.bool_)
    floats = time.astype(np.float64)
    near = np.any([(floats > a - FAR * 1e9) & (floats < b + FAR * 1e9) for a, b in hulls], axis=0)
    return np.asarray(~near if near.any() else (time <= 0) | (time > 2**62), dtype=np.bool_)


def _spikes(time: Integers, left_out: Mask) -> Mask:
    """The few messages whose stamps leap away from their neighbours' and back."""
    found = np.zeros(len(time), dtype=np.bool_)
    rest = np.flatnonzero(~left_out)
    if len(rest) < MANY:
        return found
    times = (time[rest] - time[rest[0]]) * 1e-9
    away = np.abs(times - median_filter(times, SPIKE, mode="nearest")) > SMALL_DISORDER
    if np.count_nonzero(away) <= max(FEW, FEW_SHARE * len(time)):
        found[rest[away]] = True
    return found
