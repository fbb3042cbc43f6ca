# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Courses of an axis: where it is to be at each sample, with velocity and acceleration."""

from collections.abc import Sequence
from contextlib import suppress
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


def planned(begin: Goal, target: float, limits: MotionLimits) -> Any:
    """Trajectory of ruckig from ``begin`` to rest at ``target`` [m] (Berscheid and Kröger 2021).

    ruckig raises an error where a profile is the limit of two kinds, such as a distance in which the
    acceleration just reaches its limit. With a limit less by a millionth it is one of them. Raises
    ParameterError if there is no motion.
    """
    try:
        import ruckig
    except ImportError as error:
        raise ParameterError("goals need the package ruckig: pip install ruckig") from error
    wanted = ruckig.InputParameter(1)
    wanted.current_position, wanted.target_position = [begin.position], [target]
    wanted.current_velocity, wanted.current_acceleration = [begin.velocity], [begin.acceleration]
    wanted.max_velocity, wanted.max_jerk = [limits.velocity], [limits.jerk]
    for share in (1.0, 1.0 - 1e-6):
        wanted.max_acceleration = [share * limits.acceleration]
        path = ruckig.Trajectory(1)
        with suppress(ruckig.RuckigError):
            if ruckig.Ruckig(1).calculate(wanted, path) >= 0:
                return path
            break
    raise ParameterError(f"there is no motion from {begin.position:g} m to {target:g} m within the limits")


def point_to_point(
    start: float, goals: Sequence[float], pause: float, limits: MotionLimits, period: float, duration: float
) -> Floats:
    """Jerk-limited motions from ``start`` to one of ``goals`` [m] after the other, each as fast as it can.

    Before each there is a ``pause`` [s]. Returns rows of Goal, one a ``period`` [s] over ``duration`` [s].
    Raises ParameterError for motions that take longer than that.
    """
    n = max(1, round(duration / period))
    rows = np.zeros((n, 3))
    rows[:, 0] = start
    begun = 0.0
    at = start
    for goal in goals:
        begun += pause
        path = planned(Goal(at, 0.0, 0.0), goal, limits)
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
