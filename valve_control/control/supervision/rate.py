# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Measures the period of the LVDT readings: it should be the sample period of the law.

The time between readings is averaged over windows; of the last windows the middle one counts, so that a few
standstills of sender or receiver, each of which falls into one window or two, are no false alarm. A small
deviation must last: a sender that is held up for a while makes good what it lacks.

Readings may keep their mean period and still come in bursts: a driver or a network collects several and hands
them on together. Each voltage but the last of a burst is then replaced before the spool can move.
"""

from typing import NamedTuple

from valve_control.control.supervision.conditions import ReportedCondition

WINDOW = 0.1  # s; a reading at its end that is late by 1 ms is 1 %
WINDOWS = 9  # the middle of them counts
LEAST = 20  # readings in a window
REPORTED = 0.02  # relative deviation that is reported
LASTING = 20  # windows for which a deviation below the limit lasts before it is reported
QUICK = 0.4  # of the sample period; a reading that comes sooner after the one before is in a burst with it
CROWDED = 0.4  # share of readings that come quickly, from which a window has bursts; two at a time make 0.5
CALMED = 0.75  # of a limit, below which it counts as kept again


CONDITIONS = (
    ReportedCondition(
        ("lvdt_rate", "lvdt_period"),
        "degraded beyond 2 %, safe beyond `lvdt.period_limit`",
        "LVDT readings come every … ms, sample_period is … ms",
        "the driver's rate differs from the design rate of the law; the median of nine windows of "
        "0.1 s counts; a deviation within the limit is reported after 2 s",
        "`sample_period`, or the driver's rate",
    ),
    ReportedCondition(
        ("lvdt_bursts",),
        "degraded",
        "LVDT readings come in bursts of about …, one burst in … ms",
        "for 2 s, more than 40 % of the readings come within 0.4 of `sample_period` after the reading before",
        "driver, gateway or network that collects readings; only the last voltage of a burst "
        "acts, so the loop has the dead time of a burst",
    ),
)


class Params(NamedTuple):
    """The expected sample period and the tolerated deviation."""

    period: float  # s  ΔT
    limit: float  # -  relative deviation beyond which nothing is controlled


class State(NamedTuple):
    """The open window and the means of those before it."""

    time: float  # s
    periods: int  # in it
    means: tuple[float, ...]  # s, oldest first
    off: int  # windows for which they have been off on the same side; negative: too short
    level: int  # 0: as expected, 1: reported, 2: beyond the limit
    quick: int = 0  # readings of the open window that came quickly
    share: float = 0.0  # of quick readings in the last window
    crowded: int = 0  # windows in a row with bursts, at most LASTING


UNKNOWN = State(0.0, 0, (), 0, 0)


def step(p: Params, s: State, elapsed: float, periods: int) -> State:
    """State after one more reading, ``elapsed`` [s] after the one ``periods`` before it (0.0 s: unknown)."""
    if elapsed == 0.0:
        return s
    time, count, means, off, level, quick, share, crowded = s
    time, count = time + elapsed, count + periods
    if elapsed < QUICK * p.period:
        quick += 1
    if count < LEAST or time < WINDOW:
        return State(time, count, means, off, level, quick, share, crowded)
    means = (*means[1 - WINDOWS :], time / count)
    share = quick / count
    crowded = min(crowded + 1, LASTING) if share > CROWDED else 0
    period = _middle(means)
    if period == 0.0:
        return State(0.0, 0, means, 0, level, 0, share, crowded)
    deviation = period / p.period - 1.0
    off = 0
    if abs(deviation) > (CALMED * REPORTED if level > 0 else REPORTED):
        side = 1 if deviation > 0.0 else -1
        off = side * (min(abs(s.off), LASTING) + 1 if s.off * side > 0 else 1)
    level = 0
    if abs(deviation) > (CALMED * p.limit if s.level == 2 else p.limit):
        level = 2
    elif off != 0 and (abs(off) > LASTING or s.level > 0):
        level = 1
    return State(0.0, 0, means, off, level, 0, share, crowded)


def interrupted(s: State) -> State:
    """State after a silence, whose time says nothing of the period."""
    return State(0.0, 0, s.means, s.off, s.level, 0, s.share, s.crowded)


def bursts(s: State) -> bool:
    """Whether readings have come in bursts for long enough to be reported."""
    return s.crowded >= LASTING


def bursts_text(p: Params, s: State) -> str:
    """One sentence about the bursts of the last window."""
    several, every = 1.0 / (1.0 - s.share), 1e3 * p.period / (1.0 - s.share)
    return f"LVDT readings come in bursts of about {several:.2g}, one burst in {every:.2g} ms"


def measured(s: State) -> float:
    """Period of the readings [s]: the middle one of the last windows, 0.0 if there were too few."""
    return _middle(s.means)


def _middle(means: tuple[float, ...]) -> float:
    return sorted(means)[len(means) // 2] if 2 * len(means) > WINDOWS else 0.0


def text(p: Params, s: State) -> str:
    """One sentence about a deviation of the period."""
    said = f"LVDT readings come every {1e3 * measured(s):.3g} ms, sample_period is {1e3 * p.period:.3g} ms"
    return said if s.level < 2 else f"{said}: more than {p.limit:.0%} off, not controlled"
