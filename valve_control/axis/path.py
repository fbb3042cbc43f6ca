# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Paths of an axis over time: of a trajectory's points, or to a goal as fast as the limits allow.

Between two points with velocities and accelerations a path is a quintic, with velocities alone a cubic;
without either the velocities are those of central differences, and 0 at both ends. At a point it is the
point, to the last bit.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import PPoly

from valve_control.arrays import Floats
from valve_control.axis.course import Goal, MotionLimits, planned
from valve_control.parameter import ParameterError

MOST = 100_000  # points
SLACK = 1e-9  # relative, of a limit
REST = 1e-6  # m/s  that counts as standstill at the end
NANO = 1e-9


class Range(NamedTuple):
    """What an axis can do."""

    low: float  # m
    high: float  # m
    speed_out: float  # m/s
    speed_in: float  # m/s
    start: float  # m  distance from the present goal at which a path may begin


class PathPoint(NamedTuple):
    """One point of a trajectory."""

    position: float  # m
    velocity: float | None  # m/s
    acceleration: float | None  # m/s²
    time: int  # ns  from the beginning


def nanoseconds(time: Any) -> int:
    """Time [ns] of a stamp or duration of ROS."""
    return int(time.sec * 10**9 + time.nanosec)


def points_of(joint: str, joints: Sequence[str], rows: Sequence[Any]) -> list[PathPoint]:
    """Points of a trajectory of ``joints``, as far as they are for ``joint``.

    Rows are those of JointTrajectory: positions [m], velocities [m/s], accelerations [m/s²] (or none) of all
    joints, and the time from the start. Raises ParameterError.
    """
    if joint not in joints:
        named = ", ".join(f"'{name}'" for name in joints) or "no joint"
        raise ParameterError(f"the trajectory is for {named}, not for '{joint}'")
    at = list(joints).index(joint)
    points = []
    for i, row in enumerate(rows):
        counts = len(row.positions), len(row.velocities), len(row.accelerations)
        if counts[0] != len(joints) or any(count not in (0, len(joints)) for count in counts[1:]):
            raise ParameterError(
                f"point {i} of the trajectory has {counts[0]} positions, {counts[1]} velocities and "
                f"{counts[2]} accelerations; it must have one of each for each joint, or no derivatives"
            )
        points.append(
            PathPoint(
                row.positions[at],
                row.velocities[at] if counts[1] else None,
                row.accelerations[at] if counts[2] else None,
                nanoseconds(row.time_from_start),
            )
        )
    return points


class Path(NamedTuple):
    """Where the axis is to be: ``at`` is asked with a time [ns] from the beginning, 0 to ``end``."""

    at: Callable[[int], Goal]
    end: int  # ns
    last: Goal


def goal_of(path: Path, time: int) -> Goal:
    """Goal at ``time`` [ns] from the beginning of the path; after its end the axis rests there."""
    if time >= path.end:
        return path.last
    return path.at(max(0, time))


def _velocities(points: Sequence[PathPoint], times: Floats) -> Floats:
    given = [p.velocity for p in points]
    x = np.array([p.position for p in points])
    slopes = np.zeros(len(points))
    if len(points) > 2:
        slopes[1:-1] = (x[2:] - x[:-2]) / (times[2:] - times[:-2])
    return np.array([slope if v is None else v for v, slope in zip(given, slopes, strict=True)])


def _pieces(points: Sequence[PathPoint], times: Floats) -> Floats:
    """Coefficients (n-1, 6), constant first, of the polynomials between the points."""
    x = np.array([p.position for p in points])
    v = _velocities(points, times)
    h = np.diff(times)
    pieces = np.zeros((len(h), 6))
    pieces[:, 0], pieces[:, 1] = x[:-1], v[:-1]
    dx = (x[1:] - x[:-1] - v[:-1] * h) / h
    dv = v[1:] - v[:-1]
    if any(p.acceleration is None for p in points):
        pieces[:, 2] = (3.0 * dx - dv) / h
        pieces[:, 3] = (dv - 2.0 * dx) / h**2
        return pieces
    a = np.array([p.acceleration for p in points], dtype=float)
    begin, end = a[:-1] * h, a[1:] * h
    pieces[:, 2] = 0.5 * a[:-1]
    # Solved for position, velocity and acceleration at the end.
    pieces[:, 3] = (10.0 * dx - 4.0 * dv - 1.5 * begin + 0.5 * end) / h**2
    pieces[:, 4] = (-15.0 * dx + 7.0 * dv + 1.5 * begin - end) / h**3
    pieces[:, 5] = (6.0 * dx - 3.0 * dv + 0.5 * (end - begin)) / h**4
    return pieces


def through(points: Sequence[PathPoint], present: Goal, able: Range) -> Path:
    """Path through the points of a trajectory, from the ``present`` goal if the first is not at time 0.

    Raises ParameterError, one sentence, for points that are no trajectory, that leave the stroke, that ask
    for more speed than there is, that leap from the present goal, or that do not end at rest.
    """
    if not 1 <= len(points) <= MOST:
        raise ParameterError(f"the trajectory has {len(points)} points; it must have 1 to {MOST}")
    for i, p in enumerate(points):
        numbers = (p.position, p.velocity or 0.0, p.acceleration or 0.0)
        if not np.all(np.isfinite(numbers)):
            raise ParameterError(f"point {i} of the trajectory has numbers that are not finite")
        if not able.low <= p.position <= able.high:
            raise ParameterError(
                f"point {i} of the trajectory is at {p.position:g} m, outside the stroke from "
                f"{able.low:g} m to {able.high:g} m"
            )
    stamps = [p.time for p in points]
    if stamps[0] < 0 or any(later <= earlier for earlier, later in zip(stamps, stamps[1:], strict=False)):
        raise ParameterError("the times of the trajectory's points do not rise from one to the next")
    leap = points[0].position - present.position
    if stamps[0] == 0 and abs(leap) > able.start:
        raise ParameterError(
            f"the trajectory begins {abs(leap):.4g} m from the present goal at {present.position:.4g} m; "
            f"{able.start:g} m are allowed, or a first point at a later time"
        )
    all_points = list(points)
    if stamps[0] > 0:
        whole = points[0].acceleration is not None
        all_points.insert(0, PathPoint(*present[:2], present.acceleration if whole else None, 0))
    if abs(all_points[-1].velocity or 0.0) > REST:
        raise ParameterError(f"the trajectory ends with {all_points[-1].velocity:g} m/s; it must end at rest")
    last = Goal(all_points[-1].position, 0.0, 0.0)
    if len(all_points) == 1:
        return Path(lambda time: last, 0, last)
    nanoseconds = np.array([p.time for p in all_points], dtype=np.int64)
    times = nanoseconds.astype(np.float64) * NANO
    with np.errstate(over="ignore", invalid="ignore"):
        pieces = _pieces(all_points, times)
        _check_extremes(PPoly(pieces[:, ::-1].T, times), able)

    def at(time: int) -> Goal:
        i = int(np.searchsorted(nanoseconds, time, side="right")) - 1
        t = (time - int(nanoseconds[i])) * NANO
        c0, c1, c2, c3, c4, c5 = pieces[i].tolist()
        return Goal(
            c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))),
            c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5))),
            2.0 * c2 + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5)),
        )

    return Path(at, int(nanoseconds[-1]), last)


def _check_extremes(course: PPoly, able: Range) -> None:
    """Check position and velocity of a ``course`` at its points and at the extremes between them."""
    velocity, acceleration = course.derivative(), course.derivative(2)
    if not all(np.isfinite(one.c).all() for one in (course, velocity, acceleration)):
        raise ParameterError("the trajectory has numbers that are too large to calculate with")
    shown = []
    for value, rate in ((course, velocity), (velocity, acceleration)):
        between = rate.roots(discontinuity=False, extrapolate=False)
        shown.append(value(np.append(course.x, between[np.isfinite(between)])))
    x, v = shown
    _check(float(x.min()), float(x.max()), float(v.min()), float(v.max()), able, "the trajectory")


def _check(low: float, high: float, slowest: float, fastest: float, able: Range, what: str) -> None:
    slack = SLACK * (able.high - able.low)
    if low < able.low - slack or high > able.high + slack:
        beyond = low if low < able.low - slack else high
        raise ParameterError(
            f"{what} reaches {beyond:.6g} m, outside the stroke from {able.low:g} m to {able.high:g} m"
        )
    for speed, most, way in ((fastest, able.speed_out, "outwards"), (-slowest, able.speed_in, "inwards")):
        if speed > most * (1.0 + SLACK):
            raise ParameterError(f"{what} asks for {speed:.4g} m/s {way}; the axis has {most:.4g} m/s")


def towards(target: float, present: Goal, limits: MotionLimits, able: Range) -> Path:
    """Path from the ``present`` goal, also in motion, to rest at ``target`` [m] as fast as ``limits`` allow.

    Raises ParameterError for a target that cannot be reached.
    """
    if not np.isfinite(target):
        raise ParameterError(f"the goal is {target}; it must be finite")
    if not able.low <= target <= able.high:
        raise ParameterError(
            f"the goal {target:g} m is outside the stroke from {able.low:g} m to {able.high:g} m"
        )
    speed = min(limits.velocity, able.speed_out, able.speed_in)
    found = planned(present, target, limits._replace(velocity=speed))
    extremes = found.position_extrema[0]
    inside = able._replace(speed_out=np.inf, speed_in=np.inf)
    _check(extremes.min, extremes.max, 0.0, 0.0, inside, f"the motion to {target:g} m")

    def at(time: int) -> Goal:
        position, velocity, acceleration = found.at_time(time * NANO)
        return Goal(position[0], velocity[0], acceleration[0])

    return Path(at, int(np.ceil(found.duration / NANO)), Goal(target, 0.0, 0.0))
