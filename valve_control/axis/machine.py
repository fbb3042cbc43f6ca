# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Simulates one sample of a machine: an axis, the valve that feeds it and its sensors.

The voltage moves the spool of the valve (``control/plant/valve.py``), the spool's edges feed the axis
(``axis/axis.py``). The valve has its own LVDT.
"""

from typing import NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.axis import axis
from valve_control.control.plant import valve
from valve_control.control.plant.sensor import Lvdt, reading

NOISES = 4  # numbers of noise a sample: LVDT, position, two pressures


class Sensors(NamedTuple):
    """Sensors of the axis, each like an LVDT in its own unit."""

    position: Lvdt  # m
    pressure: Lvdt  # Pa, both


class Params(NamedTuple):
    """One machine at one sample period."""

    valve: valve.Params
    axis: axis.Params
    sensors: Sensors


class State(NamedTuple):
    """State of a machine. ``history`` is a ring of past samples and is overwritten in place.

    Each of its rows holds a position [m], where a third of a period at the velocity of then leads to [m], and
    both pressures [Pa].
    """

    valve: valve.State
    axis: axis.State
    history: Floats
    newest: int


class Reading(NamedTuple):
    """What the sensors show."""

    spool: float  # V
    position: float  # m
    pressure_a: float  # Pa
    pressure_b: float  # Pa


def _remember(p: Params, s: axis.State, history: Floats, newest: int) -> None:
    now = axis.pressures(p.axis, s)
    valve.remember(history, newest, valve.Row(s.x, s.v, 0.0, 0.0), p.axis.period)
    history[newest, 2] = now.a
    history[newest, 3] = now.b


def begin(p: Params, at: axis.State) -> State:
    """Machine with its spool in the centre and the axis in the state ``at``, which it has had for long."""
    length = int(max(p.sensors.position.delay, p.sensors.pressure.delay)) + 2
    history = np.zeros((length, 4))
    for i in range(length):
        _remember(p, at._replace(v=0.0), history, i)
    return State(valve.initial(p.valve), at, history, 0)


def copied(s: State) -> State:
    """``s`` with histories of its own, so that a run from it leaves ``s`` as it is."""
    return s._replace(valve=s.valve._replace(history=s.valve.history.copy()), history=s.history.copy())


def _delayed(delay: float, history: Floats, newest: int, column: int) -> float:
    """Entry of ``column`` ``delay`` periods ago, on a straight line between two samples."""
    whole = int(delay)
    part = delay - whole
    n = len(history)
    later = float(history[(newest - whole) % n, column])
    earlier = float(history[(newest - whole - 1) % n, column])
    return later + part * (earlier - later)


def read(p: Params, s: State, noise: Floats) -> Reading:
    """Readings of all sensors; ``noise``: NOISES standard normal numbers."""
    return sensed(p, s, noise[0], noise[1], noise[2], noise[3])


def sensed(
    p: Params, s: State, spool: float, position: float, pressure_a: float, pressure_b: float
) -> Reading:
    """Readings of all sensors from a standard normal number for each."""
    pressure = p.sensors.pressure
    x = valve.delayed(p.sensors.position.delay, s.history, s.newest)
    return Reading(
        valve.read(p.valve, s.valve, spool),
        reading(p.sensors.position, x, position),
        reading(pressure, _delayed(pressure.delay, s.history, s.newest, 2), pressure_a),
        reading(pressure, _delayed(pressure.delay, s.history, s.newest, 3), pressure_b),
    )


def step(p: Params, s: State, voltage: float) -> State:
    """State one period later, with ``voltage`` [V] on the valve over it."""
    return followed(p, s, valve.step(p.valve, s.valve, voltage))


def followed(p: Params, s: State, moved: valve.State) -> State:
    """State one period later, over which the valve has come into the state ``moved``."""
    following = axis.step(p.axis, s.axis, s.valve.x.x0, s.valve.x.x1, moved.x.x0, moved.x.x1)
    newest = (s.newest + 1) % len(s.history)
    _remember(p, following, s.history, newest)
    return State(moved, following, s.history, newest)
