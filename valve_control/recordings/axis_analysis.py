# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Analyses the axes in a bag: tracking error and pressures."""

from typing import NamedTuple

import numpy as np

from valve_control.arrays import Floats, Integers
from valve_control.recordings.bags.bag import Bag
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.cleaning import unusable
from valve_control.recordings.report import Notes, Piece

GOAL, JOINTS, ROOMS = "axis_goal", "joint_states", ("pressure_a", "pressure_b")
NANO = 10**9


class Axis(NamedTuple):
    """What was recorded of one axis, as in JSON; NaN where nothing is known."""

    readings: int = 0  # with a goal
    duration_s: float = 0.0
    e_rms_m: float = np.nan
    e_max_m: float = np.nan
    e_end_m: float = np.nan  # largest in the last second
    speed_max_m_s: float = np.nan  # of the goal
    pressures_Pa: dict[str, tuple[float, float]] = {}  # lowest and highest, by room
    left_out: list[str] = []


def axes(bag: Bag, start: int | None = None, end: int | None = None) -> dict[str, Axis]:
    """Axes by namespace ("" for none); ``start``, ``end`` [ns]: log times."""
    found = {}
    for space in (name.removesuffix(f"/{GOAL}") for name in bag.topics if name.endswith(f"/{GOAL}")):
        try:
            found[space.lstrip("/")] = _axis(bag, space, start, end)
        except BagError as reason:  # the valves are analysed all the same
            found[space.lstrip("/")] = Axis(left_out=[str(reason)])
    return found


def _axis(bag: Bag, space: str, start: int | None, end: int | None) -> Axis:
    topics = {
        GOAL: ("time_from_start", "positions[0]", "velocities[0]"),
        JOINTS: ("header.stamp", "position[0]"),
        **dict.fromkeys(ROOMS, ("header.stamp", "fluid_pressure")),
    }  # each with its stamp and numbers
    topics = {name: entry for name, entry in topics.items() if f"{space}/{name}" in bag.topics}
    wanted = {
        f"{space}/{name}": [f"{stamp}.sec", f"{stamp}.nanosec", *fields]
        for name, (stamp, *fields) in topics.items()
    }
    read = bag.read(wanted, start=start, end=end)
    left_out: list[str] = []
    stamped: dict[str, tuple[Integers, list[Floats]]] = {}
    for name, (stamp, *fields) in topics.items():
        series = read[f"{space}/{name}"]
        left_out += unusable(f"{space}/{name}", fields[0], series)
        values = series.having(fields[0]).values
        sec, nanosec = (values[f"{stamp}.{part}"].astype(np.int64) for part in ("sec", "nanosec"))
        time, first = np.unique(sec * NANO + nanosec, return_index=True)
        stamped[name] = time, [values[field][first] for field in fields]
    at, (goal, speed) = stamped[GOAL]
    rooms = {name: entry[0] for name, (_, entry) in stamped.items() if name in ROOMS}
    axis = Axis(
        speed_max_m_s=float(np.nanmax(np.abs(speed))) if np.isfinite(speed).any() else np.nan,
        pressures_Pa={
            room: (float(np.nanmin(pressure)), float(np.nanmax(pressure)))
            for room, pressure in rooms.items()
            if np.isfinite(pressure).any()
        },
        left_out=left_out,
    )
    if JOINTS not in stamped:
        left_out.append(f"there is no {space}/{JOINTS}, so no tracking error")
        return axis
    read_at, (positions,) = stamped[JOINTS]
    moment, i, j = np.intersect1d(read_at, at, return_indices=True)
    error = goal[j] - positions[i]
    usable = np.isfinite(error)
    if not usable.all():
        left_out.append(f"{np.count_nonzero(~usable)} positions are not finite and left out")
        error, moment = error[usable], moment[usable]
    if not len(error):
        return axis
    return axis._replace(
        readings=len(error),
        duration_s=float(moment[-1] - moment[0]) / NANO,
        e_rms_m=float(np.sqrt(np.mean(error**2))),
        e_max_m=float(np.max(np.abs(error))),
        e_end_m=float(np.max(np.abs(error[moment >= moment[-1] - NANO]))),
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
