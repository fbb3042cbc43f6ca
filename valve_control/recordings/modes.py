# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Works out when the controller was in which mode (ok, degraded, safe), from /diagnostics and ~/state."""

from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from valve_control.arrays import Floats, Integers
from valve_control.recordings.bags.bag import Series
from valve_control.recordings.bags.cdr import deserialized

TYPE = "diagnostic_msgs/msg/DiagnosticArray"
SILENT = 3.0  # s without a word, of which there is at least one a second, after which the mode is not known
LEAD = 0.1  # s before its first word in which a controller counts as in that mode
GRACE = 0.005  # s after a word on /diagnostics in which ~/state may still tell of the sample before


class Mode(IntEnum):
    """Modes of the supervision, and two more: a node that is not active, and an unknown mode."""

    OK = 0
    DEGRADED = 1
    SAFE = 2
    INACTIVE = 3  # the node gives no voltage
    UNKNOWN = 4  # nothing was heard of the controller


class Word(NamedTuple):
    """What one diagnostics message of a controller says."""

    time: int  # ns
    mode: Mode
    reasons: tuple[str, ...]


class Interval(NamedTuple):
    """Stretch of time with one mode."""

    mode: Mode
    start: int  # ns
    end: int  # ns
    reasons: tuple[str, ...]  # those that the mode before did not have first; () if they are not recorded


def words(series: Sequence[Series], problems: list[str]) -> dict[str, list[Word]]:
    """What each controller said, by the node's full name."""
    said: dict[str, list[Word]] = {}
    unreadable = 0
    for messages in series:
        for time, raw in zip(messages.publish_time.tolist(), messages.raw, strict=True):
            # Every controller tells its mode; the words of other nodes are many.
            if b"mode\0" not in raw:
                continue
            message = deserialized(raw, TYPE)
            if message is None:
                unreadable += 1
                continue
            for status in message.status:
                mode = _mode(status)
                if mode is not None:
                    name = f"/{status.name.lstrip('/')}"
                    reasons = () if mode is Mode.OK else tuple(status.message.split("; "))
                    said.setdefault(name, []).append(Word(time, mode, reasons))
    if unreadable:
        problems.append(f"{unreadable} messages of /diagnostics could not be decoded and are left out")
    return said


def _mode(status: Any) -> Mode | None:
    """Mode that a status tells, None if it is not a controller's."""
    told = next((pair.value for pair in status.values if pair.key == "mode"), "")
    if told not in ("ok", "degraded", "safe"):
        return None
    return Mode.INACTIVE if status.message.startswith(("inactive", "unconfigured")) else Mode[told.upper()]


def of_controller(said: Mapping[str, list[Word]], namespace: str, state: str) -> list[Word]:
    """What the controller with the topic ``state``, or (if "") the one in ``namespace``, said."""
    if state:
        return said.get(state.rpartition("/")[0], [])
    near = [own for name, own in said.items() if name.rpartition("/")[0] == namespace]
    return max(near, key=len, default=[])


def history(
    told: Sequence[Word], state_time: Integers, state_mode: Floats, begin: int, end: int
) -> list[Interval]:
    """Modes from ``begin`` to ``end`` [ns] without a gap; [] if nothing is known.

    ``state_mode`` is that of ~/state at ``state_time``.
    """
    told = sorted(told, key=lambda word: word.time)
    said = np.array([word.time for word in told], dtype=np.int64)
    known = np.isin(state_mode, (Mode.OK, Mode.DEGRADED, Mode.SAFE))
    if len(said):
        newest = said[np.maximum(np.searchsorted(said, state_time, side="right") - 1, 0)]
        since = state_time - newest
        known &= (since < 0) | (since > round(GRACE * 1e9))
    times = np.concatenate([said, state_time[known]])
    modes = np.concatenate([np.array([w.mode for w in told]), state_mode[known]]).astype(np.int64)
    order = np.argsort(times, kind="stable")
    order = order[times[order] < end]
    times, modes = times[order], modes[order]
    if len(times) == 0:
        return []
    silent = np.diff(times) > round(SILENT * 1e9)
    changes = [0, *(np.flatnonzero((np.diff(modes) != 0) | silent) + 1).tolist()]
    found: list[Interval] = []
    if times[0] - begin > round(LEAD * 1e9):
        found.append(Interval(Mode.UNKNOWN, begin, int(times[0]), ()))
    for first, after in zip(changes, [*changes[1:], len(times)], strict=True):
        start, last = int(times[first]), int(times[after - 1])
        until = int(times[after]) if after < len(times) else end
        heard = range(*np.searchsorted(said, [start, last + 1]).tolist())
        reasons = dict.fromkeys(reason for i in heard for reason in told[i].reasons)
        # What was said in the mode before is not why it ended.
        before = found[-1].reasons if found else ()
        ordered = sorted(reasons, key=lambda reason: reason in before)
        gone = until - last > round(SILENT * 1e9)
        found.append(Interval(Mode(int(modes[first])), start, last if gone else until, tuple(ordered)))
        if gone:
            found.append(Interval(Mode.UNKNOWN, last, until, ()))
    if found[0].mode is not Mode.UNKNOWN:
        found[0] = found[0]._replace(start=min(begin, found[0].start))
    return [part._replace(start=max(part.start, begin)) for part in found if part.end > begin]


def of_samples(intervals: Sequence[Interval], stamp: Integers, period: float) -> Integers:
    """Index of the interval of each sample: what was said last before the next reading [ns]."""
    until = np.append(stamp[1:], stamp[-1] + round(period * 1e9))
    starts = np.array([part.start for part in intervals], dtype=np.int64)
    return np.maximum(np.searchsorted(starts, until, side="left") - 1, 0)
