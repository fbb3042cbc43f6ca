# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Courses of an axis: where it is to be at each sample, with velocity and acceleration."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.parameter import ParameterError


class Goal(NamedTuple):
    """Where the axis is to be at a sample."""

    position: float  # m
    velocity: float  # m/s
    acceleration: float  # m/s²


class MotionLimits(NamedTuple):
    """What a motion may not exceed."""

    velocity: float  # m/s
    acceleration: float  # m/s²
    jerk: float  # m/s³


def planned(wanted: Any) -> Any:
    """Trajectory of ruckig for its input ``wanted``, None if there is none.

    ruckig raises an error where a profile is the limit of two kinds, such as a distance in which the
    acceleration just reaches its limit. With a limit less by a millionth it is one of them.
    """
    import ruckig

    for share in (1.0, 1.0 - 1e-6):
        wanted.max_acceleration = [share * limit for limit in wanted.max_acceleration]
        path = ruckig.Trajectory(1)
        try:
            return path if ruckig.Ruckig(1).calculate(wanted, path) >= 0 else None
        except ruckig.RuckigError:
            continue
    return None


def point_to_point(
    start: float, goals: Sequence[float], pause: float, limits: MotionLimits, period: float, duration: float
) -> Floats:
    """Jerk-limited motions from ``start`` to one of ``goals`` [m] after the other, each as fast as it can.

    Before each there is a ``pause`` [s]. Returns rows of Goal, one a ``period`` [s] over ``duration`` [s]; by
    ruckig (Berscheid and Kröger 2021). Raises ParameterError for motions that take longer than that.
    """
    import ruckig

    n = max(1, round(duration / period))
    rows = np.zeros((n, 3))
    rows[:, 0] = start
    begun = 0.0
    at = start
    for goal in goals:
        begun += pause
        wanted = ruckig.InputParameter(1)
        wanted.current_position, wanted.target_position = [at], [goal]
        wanted.max_velocity, wanted.max_acceleration = [limits.velocity], [limits.acceleration]
        wanted.max_jerk = [limits.jerk]
        path = planned(wanted)
        if path is None:
            raise ParameterError(f"there is no motion from {at:g} m to {goal:g} m within the limits")
        first = int(np.ceil(begun / period - 1e-9))
        last = int(np.floor((begun + path.duration) / period + 1e-9))
        if last >= n:
            raise ParameterError(
                f"duration is {duration:g} s; the motion to {goal:g} m ends at {begun + path.duration:.4g} s"
            )
        for k in range(first, last + 1):
            position, velocity, acceleration = path.at_time(min(path.duration, k * period - begun))
            rows[k] = position[0], velocity[0], acceleration[0]
        rows[last + 1 :, 0] = goal
        begun += path.duration
        at = goal
    return rows


def sine(centre: float, amplitude: float, frequency: float, period: float, duration: float) -> Floats:
    """A sine [m] that begins at rest: its amplitude rises over the first two cycles (at most 0.5 s each)."""
    t = np.arange(max(1, round(duration / period))) * period
    w = 2.0 * np.pi * frequency
    rise = 2.0 * min(0.5, 1.0 / frequency)
    s = np.minimum(1.0, t / rise)
    shape = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    first = np.where(t < rise, 30.0 * s**2 * (1.0 - s) ** 2 / rise, 0.0)
    second = np.where(t < rise, 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / rise**2, 0.0)
    wave, slope = np.sin(w * t), w * np.cos(w * t)
    return np.column_stack(
        [
            centre + amplitude * shape * wave,
            amplitude * (first * wave + shape * slope),
            amplitude * (second * wave + 2.0 * first * slope - w * w * shape * wave),
        ]
    )
