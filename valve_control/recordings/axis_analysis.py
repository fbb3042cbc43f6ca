# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Analyses the axes in a bag: tracking error, pressures, and the energy that the motion took."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from valve_control.arrays import Floats, Integers
from valve_control.recordings.bags.bag import Bag, Series
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.cleaning import unusable
from valve_control.recordings.parameters import Node

GOAL, JOINTS, ROOMS = "axis_goal", "joint_states", ("pressure_a", "pressure_b")
# Parameters of axis_simulator that the energies need; it is known by the first.
MACHINE = ("cylinder.area_a", "cylinder.area_b", "supply.kind", "supply.pressure", "relief.pressure")
NANO = 10**9


class Axis(NamedTuple):
    """What was recorded of one axis; in m, Pa and J, NaN where nothing is known."""

    readings: int  # with a goal
    duration: float  # s
    e_rms: float
    e_max: float
    e_end: float  # largest in the last second
    speed_max: float  # m/s  of the goal
    pressures: dict[str, tuple[float, float]]  # lowest and highest, by room
    work: float  # of the pressures on the piston
    supplied: float  # swept volume times the supply's pressure
    left_out: list[str]


NOTHING = Axis(0, 0.0, np.nan, np.nan, np.nan, np.nan, {}, np.nan, np.nan, [])


def _stamps(seconds: Floats, nanoseconds: Floats) -> Integers:
    return seconds.astype(np.int64) * NANO + nanoseconds.astype(np.int64)


def _stamped(series: Series, field: str) -> tuple[Integers, Floats]:
    """Stamps [ns] and values of a topic with a header, each stamp once, in order."""
    series = series.having(field)
    stamps = _stamps(series.values["header.stamp.sec"], series.values["header.stamp.nanosec"])
    unique, first = np.unique(stamps, return_index=True)
    return unique, series.values[field][first]


def axes(
    bag: Bag, nodes: Mapping[str, Node], start: int | None = None, end: int | None = None
) -> dict[str, Axis]:
    """Axes by namespace ("" for none); ``start``, ``end`` [ns]: log times."""
    spaces = [name.removesuffix(GOAL).rstrip("/") for name in bag.topics if name.endswith(f"/{GOAL}")]
    found = {}
    for space in spaces:
        try:
            axis = _axis(bag, nodes, space, start, end)
        except BagError as reason:  # the valves are analysed all the same
            axis = NOTHING._replace(left_out=[str(reason)])
        found[space.lstrip("/")] = axis
    return found


def _axis(bag: Bag, nodes: Mapping[str, Node], space: str, start: int | None, end: int | None) -> Axis:
    stamp = ["header.stamp.sec", "header.stamp.nanosec"]
    goal_name, joint_name = f"{space}/{GOAL}", f"{space}/{JOINTS}"
    point = ["positions[0]", "velocities[0]", "time_from_start.sec", "time_from_start.nanosec"]
    wanted: dict[str, list[str]] = {goal_name: point}
    if joint_name in bag.topics:
        wanted[joint_name] = [*stamp, "position[0]"]
    rooms = [room for room in ROOMS if f"{space}/{room}" in bag.topics]
    wanted.update({f"{space}/{room}": [*stamp, "fluid_pressure"] for room in rooms})
    series = bag.read(wanted, start=start, end=end)
    fields = {goal_name: point[0], joint_name: "position[0]"}
    left_out: list[str] = []
    for name, one in series.items():
        left_out += unusable(name, fields.get(name, "fluid_pressure"), one)
    goals = series[goal_name].values
    times = _stamps(goals["time_from_start.sec"], goals["time_from_start.nanosec"])
    at, first = np.unique(times, return_index=True)
    wanted_position, speed = goals["positions[0]"][first], goals["velocities[0]"][first]
    error, moment, position = np.empty(0), np.empty(0, dtype=np.int64), np.empty(0)
    if joint_name in series:
        read, positions = _stamped(series[joint_name], "position[0]")
        moment, i, j = np.intersect1d(read, at, return_indices=True)
        position = positions[i]
        error = wanted_position[j] - position
    else:
        left_out.append(f"there is no {joint_name}, so no tracking error")
    usable = np.isfinite(error)
    if not usable.all():
        left_out.append(f"{np.count_nonzero(~usable)} positions are not finite and left out")
        error, moment, position = error[usable], moment[usable], position[usable]
    pressures = {room: _stamped(series[f"{space}/{room}"], "fluid_pressure") for room in rooms}
    work, supplied = _energies(moment, position, pressures, _machine(nodes, space, left_out))
    last = moment >= (moment[-1] - NANO) if len(moment) else np.empty(0, dtype=bool)
    return Axis(
        readings=len(error),
        duration=float(moment[-1] - moment[0]) / NANO if len(moment) else 0.0,
        e_rms=float(np.sqrt(np.mean(error**2))) if len(error) else np.nan,
        e_max=float(np.max(np.abs(error), initial=0.0)) if len(error) else np.nan,
        e_end=float(np.max(np.abs(error[last]))) if len(error) else np.nan,
        speed_max=float(np.nanmax(np.abs(speed))) if np.isfinite(speed).any() else np.nan,
        pressures={
            room: (float(np.nanmin(values)), float(np.nanmax(values)))
            for room, (_, values) in pressures.items()
            if np.isfinite(values).any()
        },
        work=work,
        supplied=supplied,
        left_out=left_out,
    )


def _machine(nodes: Mapping[str, Node], space: str, left_out: list[str]) -> dict[str, Any]:
    for node in nodes.values():
        if node.namespace == space and MACHINE[0] in node.initial:
            missing = [name for name in MACHINE if name not in node.initial]
            if not missing:
                return node.initial
            left_out.append(f"the bag has no {', '.join(missing)} of {node.name}, so no energy")
            return {}
    left_out.append("the bag has no parameters of axis_simulator, so no energy")
    return {}


def _energies(
    moment: Integers,
    position: Floats,
    pressures: Mapping[str, tuple[Integers, Floats]],
    machine: Mapping[str, Any],
) -> tuple[float, float]:
    if not machine or len(moment) < 2:
        return np.nan, np.nan
    way = np.diff(position)
    out, into = float(np.sum(way[way > 0.0])), -float(np.sum(way[way < 0.0]))
    kind = "supply.pressure" if machine["supply.kind"] == "constant" else "relief.pressure"
    areas = [float(machine["cylinder.area_a"]), float(machine["cylinder.area_b"])]
    supplied = float(machine[kind]) * (areas[0] * out + areas[1] * into)
    if sum(bool(np.isfinite(values).any()) for _, values in pressures.values()) < len(ROOMS):
        return np.nan, supplied
    force = np.zeros(len(moment))
    for room, area in zip(ROOMS, (areas[0], -areas[1]), strict=True):
        times, values = pressures[room]
        known = np.isfinite(values)
        force += area * np.interp(moment.astype(float), times[known].astype(float), values[known])
    return float(np.sum(0.5 * (force[1:] + force[:-1]) * way)), supplied


def as_dict(axis: Axis) -> dict[str, Any]:
    """For JSON."""
    return {
        "readings": axis.readings,
        "duration_s": axis.duration,
        "e_rms_m": axis.e_rms,
        "e_max_m": axis.e_max,
        "e_end_m": axis.e_end,
        "speed_max_m_s": axis.speed_max,
        "pressures_Pa": {room: list(extremes) for room, extremes in axis.pressures.items()},
        "work_J": axis.work,
        "supplied_J": axis.supplied,
        "left_out": axis.left_out,
    }


def lines(name: str, axis: Axis) -> list[str]:
    """The same for a terminal."""
    told = [
        f"axis {name or '/'}: {axis.readings} readings over {axis.duration:.3f} s, "
        f"e_rms {1e3 * axis.e_rms:.4f} mm, e_max {1e3 * axis.e_max:.4f} mm, "
        f"at the end {1e3 * axis.e_end:.4f} mm, up to {axis.speed_max:.3g} m/s"
    ]
    for room, (low, high) in axis.pressures.items():
        told.append(f"    {room}: {1e-5 * low:.4g} to {1e-5 * high:.4g} bar")
    if np.isfinite(axis.supplied):
        work = f", {axis.work:.4g} J of them on the piston" if np.isfinite(axis.work) else ""
        told.append(f"    energy: {axis.supplied:.4g} J from the supply{work}")
    return told + [f"    note: {note}" for note in axis.left_out]
