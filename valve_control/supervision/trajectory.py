"""A trajectory from the upper level: position, velocity and acceleration, of which the reference is made.

Between two points it goes on by the derivatives of the newest, for as long as two of their intervals; then it
stands. The time stamps of the points tell the intervals.
"""

import math
from typing import NamedTuple

from valve_control.plant.amplifier import saturate
from valve_control.supervision.command_course import LONGEST, joined


class Motion(NamedTuple):
    """Of one moment."""

    position: float  # V
    velocity: float  # V/s
    acceleration: float  # V/s²


class State(NamedTuple):
    """The newest point."""

    point: Motion
    due: float  # s  when it was due
    horizon: float  # s  how long its derivatives count
    arrival: float  # s  of the sample for which it came


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


def taken(s: State | None, point: Motion, interval: float, arrival: float, period: float) -> State:
    """A ``point`` has come for the sample at ``arrival`` [s], ``interval`` [s] after the one before."""
    if s is None or not 0.0 < interval <= LONGEST:
        return State(point, arrival, period, arrival)
    return State(point, joined(s.due, interval, arrival), 2.0 * max(interval, period), arrival)


def motion(s: State, now: float, limit: float) -> Motion:
    """What is wanted at ``now`` [s], within ±``limit`` [V]."""
    p, time = s.point, min(max(-s.horizon, now - s.due), s.horizon)
    position = p.position + (p.velocity + 0.5 * p.acceleration * time) * time
    within = saturate(position, limit)
    if within != position or now - s.due > s.horizon:
        return Motion(within, 0.0, 0.0)
    return Motion(within, p.velocity + p.acceleration * time, p.acceleration)
