# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A trajectory from the upper level: points with position, velocity and acceleration, and their times.

Between two points it goes on by the derivatives of the newest, and by the jerk of the accelerations before.
"""

import math
from typing import NamedTuple

from valve_control.control.plant.saturation import saturate
from valve_control.control.supervision.command_course import LONGEST, USUAL, Params, horizon
from valve_control.control.supervision.command_course import Motion as Motion

SMOOTHING = 0.005  # s  between points that are closer the jerk is smoothed over this time


class State(NamedTuple):
    """The newest point."""

    point: Motion
    sent: float  # s  on the clock of the samples
    stamp: float  # s  on that of its sender; without one as ``sent``
    interval: float  # s  usual time between two points, 0.0: not known
    jerk: float  # V/s³  by the accelerations before
    arrival: float  # s  of the sample for which it came


def refusal(positions: int, velocities: int, accelerations: int) -> str:
    """One sentence about a point that has not one entry of each."""
    return (
        f"trajectory point with {positions} positions, {velocities} velocities and {accelerations} "
        "accelerations refused, it must have one of each; the last one holds"
    )


def usable(point: Motion, backwards: float) -> bool:
    """Whether a point can be used; ``backwards`` as of ``fault``, which says why not."""
    return all(map(math.isfinite, point)) and not backwards > 0.0


def fault(point: Motion, backwards: float) -> str:
    """One sentence about a point that cannot be used.

    ``backwards`` [s]: by how much its time stamp is before that of the last one.
    """
    for name, value in point._asdict().items():
        if not math.isfinite(value):
            return f"trajectory point with {name} {value} refused, the last one holds"
    return (
        f"trajectory point refused, its time stamp is {backwards:.3g} s before that of the last one, "
        "which holds"
    )


def backwards(p: Params, s: State | None, stamp: float, arrival: float) -> float:
    """By how much [s] ``stamp`` [s] is before that of the last point; 0 where it is not, or no longer counts.

    A point that is two intervals old no longer holds up one with an earlier time: its sender's clock was set.
    """
    if s is None or (s.interval > 0.0 and arrival - s.arrival > 2.0 * max(s.interval, p.period)):
        return 0.0
    return max(0.0, s.stamp - stamp)


def taken(p: Params, s: State | None, point: Motion, sent: float, stamp: float, arrival: float) -> State:
    """A ``point`` has come for the sample at ``arrival`` [s], ``sent`` and stamped as of ``State``."""
    if s is None:
        return State(point, sent, stamp, 0.0, 0.0, arrival)
    elapsed = stamp - s.stamp
    if not 0.0 < elapsed <= LONGEST:
        return State(point, sent, stamp, s.interval, 0.0, arrival)
    usual = s.interval if s.interval > 0.0 else elapsed
    interval = usual + USUAL * (min(elapsed, 3.0 * usual) - usual)
    change = (point.acceleration - s.point.acceleration) / elapsed
    jerk = s.jerk + min(1.0, elapsed / SMOOTHING) * (change - s.jerk)
    return State(point, sent, stamp, interval, jerk, arrival)


def motion(p: Params, s: State, now: float) -> Motion:
    """What is wanted at ``now`` [s], within the limit; a point that was sent for this sample to the bit."""
    here, ahead = s.point, horizon(p.bridge, max(s.interval, p.period), now - p.lag - s.sent)
    if ahead.time != 0.0 or ahead.rate == 0.0:
        time = ahead.time
        rate = here.velocity + (here.acceleration + 0.5 * s.jerk * time) * time
        bend = here.acceleration + s.jerk * time
        way = (here.velocity + (0.5 * here.acceleration + s.jerk * time / 6.0) * time) * time
        here = Motion(
            here.position + way, rate * ahead.rate, bend * ahead.rate * ahead.rate + rate * ahead.bend
        )
    within = saturate(here.position, p.limit)
    return here if within == here.position else Motion(within, 0.0, 0.0)
