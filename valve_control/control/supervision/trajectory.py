# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A trajectory from the upper level: position, velocity and acceleration, of which the reference is made.

Between two points it goes on by the derivatives of the newest. A point that is late is bridged by the jerk
of the points before (late_commands.py); without that it stands after two intervals. The time stamps of the
points tell the intervals.
"""

import math
from typing import NamedTuple

from valve_control.control.laws.projection import clip
from valve_control.control.plant.amplifier import saturate
from valve_control.control.supervision import late_commands
from valve_control.control.supervision.late_commands import LONGEST, NO_OFFSET, joined
from valve_control.control.supervision.late_commands import Motion as Motion


class State(NamedTuple):
    """The newest point."""

    point: Motion
    due: float  # s  when it was due
    horizon: float  # s  how long its derivatives count
    arrival: float  # s  of the sample for which it came
    jerk: float  # V/s³  by the points before
    interval: float  # s  usual time between two points
    offset: late_commands.Offset  # from them, after one that was late
    refused: float  # s  by which the time stamp of one refused since is after its own, below 0; 0: none was


def refusal(positions: int, velocities: int, accelerations: int) -> str:
    """One sentence about a point with so many entries, "" if there is one of each."""
    counts = (positions, velocities, accelerations)
    if counts == (1, 1, 1):
        return ""
    names = ("position", "velocity", "acceleration")
    plural = ("positions", "velocities", "accelerations")
    first, second, third = (
        f"{n} {one if n == 1 else more}" for n, one, more in zip(counts, names, plural, strict=True)
    )
    return (
        f"trajectory point with {first}, {second} and {third} refused, it must have one of each; "
        "the last one holds"
    )


def usable(point: Motion, backwards: float) -> bool:
    """Whether a point can be used; ``backwards`` as of ``fault``, which says why not."""
    return all(map(math.isfinite, point)) and not backwards > 0.0


def fault(point: Motion, backwards: float) -> str:
    """One sentence about a point that cannot be used, "" if it can.

    ``backwards`` [s]: by how much its time stamp is before that of the last one, above 0.
    """
    for name, value in point._asdict().items():
        if not math.isfinite(value):
            return f"trajectory point with {name} {value} refused, the last one holds"
    if backwards > 0.0:
        return (
            f"trajectory point refused, its time stamp is {backwards:.3g} s before that of the last one, "
            "which holds"
        )
    return ""


def refusing(s: State, interval: float) -> State:
    """State after a refused point, whose time stamp is ``interval`` [s] (below 0) after that of the last."""
    return s._replace(refused=interval)


def was_set_back(s: State, interval: float, arrival: float, period: float) -> bool:
    """Whether the clock of the sender was set back, so that a point ``interval`` [s] after the last counts.

    It then follows a refused one in time, and the last is so old at ``arrival`` [s] that its derivatives no
    longer count. After the first point of a sender that is not known, because its interval is not.
    """
    since = interval - s.refused
    overdue = s.horizon > period and arrival > s.due + s.horizon - 0.5 * period
    return overdue and s.refused < 0.0 and 0.0 < since <= LONGEST


def taken(
    p: late_commands.Params | None,
    s: State | None,
    point: Motion,
    interval: float,
    arrival: float,
    period: float,
) -> State:
    """A ``point`` has come for the sample at ``arrival`` [s], ``interval`` [s] after the one before.

    ``p``: how a late one is bridged, None: not at all.
    """
    if s is None or not 0.0 < interval <= LONGEST:
        return State(point, arrival, period, arrival, 0.0, 0.0, NO_OFFSET, 0.0)
    horizon = 2.0 * max(interval, period)
    if p is None:
        return State(point, joined(s.due, interval, arrival), horizon, arrival, 0.0, 0.0, NO_OFFSET, 0.0)
    typical = late_commands.usual(s.interval, interval) if s.interval > 0.0 else interval
    due = joined(s.due, interval, min(arrival, s.due + interval + max(typical, period)))
    share = min(1.0, interval / late_commands.NODE)
    change = (point.acceleration - s.point.acceleration) / interval
    most = p.max_accel / p.time
    jerk = clip(s.jerk + share * (change - s.jerk), -most, most)
    made = State(point, due, horizon, arrival, jerk, typical, s.offset, 0.0)
    again = s.arrival == arrival and s.offset.since == arrival
    missed = s.interval > 0.0 and arrival - s.due > late_commands.LATE * s.interval
    if p.every or again or missed:
        was = course(p, s, arrival)
        now = course(p, made, arrival)
        offset = late_commands.rejoined(p, was, s.offset, now, arrival - s.due, arrival)
        return made._replace(offset=offset)
    return made


def motion(p: late_commands.Params | None, s: State, now: float, limit: float) -> Motion:
    """What is wanted at ``now`` [s], within ±``limit`` [V]."""
    if p is not None and (p.every or s.interval > 0.0):
        wanted = late_commands.with_offset(p, course(p, s, now), s.offset, now)
        within = saturate(wanted.position, limit)
        return wanted if within == wanted.position else Motion(within, 0.0, 0.0)
    here, time = s.point, min(max(-s.horizon, now - s.due), s.horizon)
    position = here.position + (here.velocity + 0.5 * here.acceleration * time) * time
    within = saturate(position, limit)
    if within != position or now - s.due > s.horizon:
        return Motion(within, 0.0, 0.0)
    return Motion(within, here.velocity + here.acceleration * time, here.acceleration)


def course(p: late_commands.Params, s: State, now: float) -> Motion:
    """The motion at ``now`` [s], with the bridge over points that are late, without the offset."""
    here, time = s.point, now - s.due
    late = 0.0 if p.every else late_commands.LATE * s.interval
    if time <= late:
        wanted = late_commands.after(here, 0.0, max(-s.horizon, time))
    else:
        begin = late_commands.after(here, 0.0, late)
        until = p.time + s.interval - late
        wanted = late_commands.continued(p, begin, s.jerk, here.position, time - late, max(0.0, until))
    return wanted
