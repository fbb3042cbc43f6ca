"""Measures the period of the LVDT readings: it should be the sample period of the law.

The time between readings is averaged over windows; of the last windows the middle one counts, so that a few
standstills of sender or receiver, each of which falls into one window or two, are no false alarm. A small
deviation must last: a sender that is held up for a while makes good what it lacks.
"""

from typing import NamedTuple

WINDOW = 0.1  # s; a reading at its end that is late by 1 ms is 1 %
WINDOWS = 9  # the middle of them counts
LEAST = 20  # readings in a window
REPORTED = 0.02  # relative deviation that is reported
LASTING = 20  # windows for which a deviation below the limit lasts before it is reported
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


UNKNOWN = State(0.0, 0, (), 0, 0)


def step(p: Params, s: State, elapsed: float, periods: int) -> State:
    """State after one more reading, ``elapsed`` [s] after the one ``periods`` before it (0.0 s: unknown)."""
    if elapsed == 0.0:
        return s
    time, count, means, off, level = s
    time, count = time + elapsed, count + periods
    if count < LEAST or time < WINDOW:
        return State(time, count, means, off, level)
    means = (*s.means[1 - WINDOWS :], time / count)
    period = _middle(means)
    if period == 0.0:
        return State(0.0, 0, means, 0, s.level)
    deviation = period / p.period - 1.0
    off = 0
    if abs(deviation) > (CALMED * REPORTED if s.level > 0 else REPORTED):
        side = 1 if deviation > 0.0 else -1
        off = side * (min(abs(s.off), LASTING) + 1 if s.off * side > 0 else 1)
    level = 0
    if abs(deviation) > (CALMED * p.limit if s.level == 2 else p.limit):
        level = 2
    elif off != 0 and (abs(off) > LASTING or s.level > 0):
        level = 1
    return State(0.0, 0, means, off, level)


def interrupted(s: State) -> State:
    """State after a silence, whose time says nothing of the period."""
    return State(0.0, 0, s.means, s.off, s.level)


def measured(s: State) -> float:
    """Period of the readings [s]: the middle one of the last windows, 0.0 if there were too few."""
    return _middle(s.means)


def _middle(means: tuple[float, ...]) -> float:
    return sorted(means)[len(means) // 2] if 2 * len(means) > WINDOWS else 0.0


def text(p: Params, s: State) -> str:
    """One sentence about a deviation of the period."""
    said = f"LVDT readings come every {1e3 * measured(s):.3g} ms, sample_period is {1e3 * p.period:.3g} ms"
    return said if s.level < 2 else f"{said}: more than {p.limit:.0%} off, not controlled"
