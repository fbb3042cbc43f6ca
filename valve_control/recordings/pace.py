# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Checks whether LVDT readings came with the sample period that the controller was set to."""

from typing import NamedTuple

import numpy as np

from valve_control.control.analysis.timing import deviating, true_period
from valve_control.recordings.recording import Aligned, ValveRecording, at_time


class OtherRate(NamedTuple):
    """Stretch of time in which the readings' period differed from the controller's."""

    start: int  # ns
    end: int  # ns
    measured: float  # s
    wanted: float  # s
    whole: bool  # whether all readings did that had this period to keep


class Pace(NamedTuple):
    """Period of the readings, compared with the controller's."""

    measured: float  # s, NaN if there are too few readings, or in lockstep
    wanted: float | None  # s, sample_period at the beginning, None if it is not recorded
    others: list[OtherRate]

    def period(self, usual: float) -> float:
        """Period [s] for the analysis: ``usual``, the recorded one, unless all readings had another."""
        return self.others[0].measured if len(self.others) == 1 and self.others[0].whole else usual


def pace(valve: ValveRecording) -> Pace:
    """Measure the period of the LVDT readings, and where it differs from the sample_period of that time."""
    wanted = None
    changes: list[tuple[int, float]] = []
    if valve.controller is not None and "sample_period" in valve.controller.initial:
        wanted = float(valve.controller.initial["sample_period"])
        changes = [
            (change.time, float(change.values["sample_period"]))
            for change in valve.controller.changes
            if "sample_period" in change.values
        ]
    readings = valve.timed.get("spool_position")
    if valve.lockstep or readings is None:
        return Pace(np.nan, wanted, [])
    time, sequence = readings.time, readings.sequence
    edges = [0, *np.searchsorted(time, [moment for moment, _ in changes]).tolist(), len(time)]
    periods = [wanted, *(period for _, period in changes)]
    others = []
    for begin, end, period in zip(edges[:-1], edges[1:], periods, strict=True):
        if period is None:
            continue
        part = slice(begin, end)
        for found in deviating(time[part], sequence[part], period, parts=valve.clock.source):
            first, last = time[begin + found.start], time[begin + found.end - 1]
            whole = found.end - found.start == end - begin
            others.append(OtherRate(int(first), int(last), found.period, period, whole))
    first_part = slice(0, edges[1]) if edges[1] else slice(None)
    return Pace(
        true_period(time[first_part], sequence[first_part]),
        wanted,
        others,
    )


def sentence(other: OtherRate, signals: Aligned | None, alone: bool) -> str:
    """A deviation in words, without its time if it covers the whole and is ``alone``."""
    text = f"LVDT readings come every {1e3 * other.measured:.4g} ms"
    if signals is not None and not (other.whole and alone):
        text += f" from {at_time(signals, other.start):.3f} to {at_time(signals, other.end):.3f} s"
    return f"{text}, sample_period is {1e3 * other.wanted:.4g} ms"
