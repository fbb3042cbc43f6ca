# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Analyses the axes in a bag: tracking error and pressures."""

from typing import NamedTuple

import numpy as np

from valve_control.arrays import Floats, Integers
from valve_control.recordings.bags.bag import Bag, Series
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.cleaning import unusable
from valve_control.recordings.report import Notes, Piece

GOAL, JOINTS, ROOMS = "axis_goal", "joint_states", ("pressure_a", "pressure_b")
NANO = 10**9


class Axis(NamedTuple):
    """What was recorded of one axis, as in JSON; NaN where nothing is known."""

    readings: int  # with a goal
    duration_s: float
    e_rms_m: float
    e_max_m: float
    e_end_m: float  # largest in the last second
    speed_max_m_s: float  # of the goal
    pressures_Pa: dict[str, tuple[float, float]]  # lowest and highest, by room
    left_out: list[str]


NOTHING = Axis(0, 0.0, np.nan, np.nan, np.nan, np.nan, {}, [])


def _stamps(seconds: Floats, nanoseconds: Floats) -> Integers:
    return seconds.astype(np.int64) * NANO + nanoseconds.astype(np.int64)


def _stamped(series: Series, field: str) -> tuple[Integers, Floats]:
    """Stamps [ns] and values of a topic with a header, each stamp once, in order."""
    series = series.having(field)
    stamps = _stamps(series.values["header.stamp.sec"], series.values["header.stamp.nanosec"])
    unique, first = np.unique(stamps, return_index=True)
    return unique, series.values[field][first]


def axes(bag: Bag, start: float = -np.inf, end: float = np.inf) -> dict[str, Axis]:
    """Axes by namespace ("" for none); ``start``, ``end`` [ns]: log times."""
    spaces = [name.removesuffix(GOAL).rstrip("/") for name in bag.topics if name.endswith(f"/{GOAL}")]
    found = {}
    for space in spaces:
        try:
            axis = _axis(bag, space, start, end)
        except BagError as reason:  # the valves are analysed all the same
            axis = NOTHING._replace(left_out=[str(reason)])
        found[space.lstrip("/")] = axis
    return found


def _axis(bag: Bag, space: str, start: float, end: float) -> Axis:
    stamp = ["header.stamp.sec", "header.stamp.nanosec"]
    goal_name, joint_name = f"{space}/{GOAL}", f"{space}/{JOINTS}"
    point = ["positions[0]", "velocities[0]", "time_from_start.sec", "time_from_start.nanosec"]
    wanted: dict[str, list[str]] = {goal_name: point}
    if joint_name in bag.topics:
        wanted[joint_name] = [*stamp, "position[0]"]
    rooms = [room for room in ROOMS if f"{space}/{room}" in bag.topics]
    wanted.update({f"{space}/{room}": [*stamp, "fluid_pressure"] for room in rooms})
    series = {
        name: one.pick((one.log_time >= start) & (one.log_time < end))
        for name, one in bag.read(wanted).items()
    }
    fields = {goal_name: point[0], joint_name: "position[0]"}
    left_out: list[str] = []
    for name, one in series.items():
        left_out += unusable(name, fields.get(name, "fluid_pressure"), one)
    goals = series[goal_name].values
    times = _stamps(goals["time_from_start.sec"], goals["time_from_start.nanosec"])
    at, first = np.unique(times, return_index=True)
    wanted_position, speed = goals["positions[0]"][first], goals["velocities[0]"][first]
    error, moment = np.empty(0), np.empty(0, dtype=np.int64)
    if joint_name in series:
        read, positions = _stamped(series[joint_name], "position[0]")
        moment, i, j = np.intersect1d(read, at, return_indices=True)
        error = wanted_position[j] - positions[i]
    else:
        left_out.append(f"there is no {joint_name}, so no tracking error")
    usable = np.isfinite(error)
    if not usable.all():
        left_out.append(f"{np.count_nonzero(~usable)} positions are not finite and left out")
        error, moment = error[usable], moment[usable]
    pressures = {room: _stamped(series[f"{space}/{room}"], "fluid_pressure") for room in rooms}
    last = moment >= (moment[-1] - NANO) if len(moment) else np.empty(0, dtype=bool)
    return Axis(
        readings=len(error),
        duration_s=float(moment[-1] - moment[0]) / NANO if len(moment) else 0.0,
        e_rms_m=float(np.sqrt(np.mean(error**2))) if len(error) else np.nan,
        e_max_m=float(np.max(np.abs(error), initial=0.0)) if len(error) else np.nan,
        e_end_m=float(np.max(np.abs(error[last]))) if len(error) else np.nan,
        speed_max_m_s=float(np.nanmax(np.abs(speed))) if np.isfinite(speed).any() else np.nan,
        pressures_Pa={
            room: (float(np.nanmin(values)), float(np.nanmax(values)))
            for room, (_, values) in pressures.items()
            if np.isfinite(values).any()
        },
        left_out=left_out,
    )


def pieces(axis: Axis) -> list[Piece]:
    """The results for a report."""
    return [
        f"{axis.readings} readings over {axis.duration_s:.3f} s, "
        f"e_rms {1e3 * axis.e_rms_m:.4f} mm, e_max {1e3 * axis.e_max_m:.4f} mm, "
        f"at the end {1e3 * axis.e_end_m:.4f} mm, up to {axis.speed_max_m_s:.3g} m/s",
        *(
            f"{room}: {1e-5 * low:.4g} to {1e-5 * high:.4g} bar"
            for room, (low, high) in axis.pressures_Pa.items()
        ),
        Notes(axis.left_out),
    ]
