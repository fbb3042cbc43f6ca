# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Measures the period of the LVDT readings: it should be the sample period of the law.

The time between readings is averaged over windows. The first window, which is short, is judged before the
first voltage. Later the middle one of nine counts, so that a few standstills are no false alarm. Two right
windows in a row end an alarm. A small deviation must last: a sender that is held up for a while
makes good what it lacks.

A gap is no period. A window begins and ends at a reading that came in time after the one before, so that a
delay and the burst that makes it good are in the same window. After a silence both are left out.
"""

from typing import NamedTuple

WINDOW = 0.1  # s; a reading at its end that is late by 1 ms is 1 %
WINDOWS = 9  # the middle of them counts
RIGHT = 2  # windows in a row that end an alarm
WRONG = 3  # short windows in a row that are an alarm at the start
LEAST = 20  # readings in a window
REPORTED = 0.02  # relative deviation that is reported
LASTING = 20  # windows for which a deviation below the limit lasts before it is reported
QUICK = 0.4  # of the sample period; a reading that comes sooner after the one before is in a burst with it
LATE = 1.6  # times the window's mean; a reading that comes later after the one before does not end the window
BURST = 100  # readings that may come quickly after a silence; more are the sender's period
ANY = 1.0  # limit from which on no period is too short: it is set where readings have no clock
CALMED = 0.75  # of a limit, below which it counts as kept again


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
    passing: int = BURST + 1  # readings that may pass before a window is open, the first at any rate; 0: open


UNKNOWN = State(0.0, 0, (), 0, 0)


def step(p: Params, s: State, elapsed: float, periods: int) -> State:
    """State after one more reading, ``elapsed`` [s] after the one ``periods`` before it (0.0 s: unknown)."""
    if elapsed == 0.0:
        return s
    quickly = elapsed < QUICK * p.period
    if s.passing > 0:
        return s._replace(passing=s.passing - 1 if quickly or s.passing > BURST else 0)
    time, count = s.time + elapsed, s.periods + periods
    length = WINDOW if s.means else 0.0
    mean = time / count
    in_time = not quickly and elapsed <= LATE * mean * periods
    if count < LEAST or time < length or not (in_time or count >= 2 * LEAST and time >= 2.0 * length):
        return s._replace(time=time, periods=count)
    return _judged(p, State(0.0, 0, (*s.means[1 - WINDOWS :], mean), s.off, s.level, 0))


def _judged(p: Params, s: State) -> State:
    """State with the level that its means have after the last of them."""
    last = abs(s.means[-1] / p.period - 1.0)
    if len(s.means) == 1:  # at the start
        if last <= p.limit:
            return s._replace(off=0)
        return s._replace(level=2) if s.off + 1 == WRONG else s._replace(means=(), off=s.off + 1)
    if s.level == 2:
        right = s.means[-RIGHT:]
        if max(abs(mean / p.period - 1.0) for mean in right) > CALMED * p.limit:
            return s
        return s._replace(means=right, off=0, level=0)
    if 2 * len(s.means) <= WINDOWS:
        return s._replace(off=0)
    deviation = measured(s) / p.period - 1.0
    if abs(deviation) > p.limit:
        return s._replace(off=0, level=2)
    if abs(deviation) <= (CALMED * REPORTED if s.level > 0 else REPORTED):
        return s._replace(off=0, level=0)
    side = 1 if deviation > 0.0 else -1
    off = side * (min(abs(s.off), LASTING) + 1 if s.off * side > 0 else 1)
    return s._replace(off=off, level=1 if abs(off) > LASTING or s.level > 0 else 0)


def interrupted(s: State) -> State:
    """State after a silence, whose time says nothing of the period, nor do readings that make it good."""
    return s._replace(time=0.0, periods=0, passing=BURST + 1)


def is_right(p: Params, s: State) -> bool:
    """Whether a voltage may be given: the period is known and within the limit, or any is right."""
    return (s.level < 2 and len(s.means) > 0) or p.limit >= ANY


def measured(s: State) -> float:
    """Period of the readings [s]: the middle one of the last windows, 0.0 before the first."""
    return sorted(s.means)[len(s.means) // 2] if s.means else 0.0


def refusal(p: Params, s: State, period: float) -> str:
    """One sentence why ``period`` [s] cannot become the sample period, "" if it can."""
    now = measured(s)
    if now == 0.0 or abs(now / period - 1.0) <= p.limit:
        return ""
    return (
        f"sample_period cannot become {1e3 * period:.3g} ms while LVDT readings come every "
        f"{1e3 * now:.3g} ms; change the period of the readings first"
    )


def text(p: Params, s: State) -> str:
    """One sentence about a deviation of the period."""
    said = f"LVDT readings come every {1e3 * measured(s):.3g} ms, sample_period is {1e3 * p.period:.3g} ms"
    return said if s.level < 2 else f"{said}: more than {p.limit:.0%} off, not controlled"
