# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""State feedback with an observer, for the valve x'' = b0·(u + d) - a1·x' - a0·x with a disturbance d.

u = (r'' + a1·r' + a0·r)/b0 - k1·(x - r) - k2·(x' - r') - d, with x, x' and d as the observer estimates them.
r is the command within limits of speed and acceleration (``reshaping``). ``build`` places all poles.
"""

import sys
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.signal import butter, place_poles

from valve_control.control.laws import reshaping
from valve_control.control.laws.free import Free
from valve_control.control.laws.law import Law
from valve_control.control.laws.signals import Start
from valve_control.control.plant.saturation import saturate
from valve_control.parameter import Parameter, Table, Values, number


class Row(NamedTuple):
    """Three numbers, which belong to the position [V], the speed [V/s] and the voltage or disturbance [V]."""

    position: float
    speed: float
    voltage: float


class Params(NamedTuple):
    """Model and gains."""

    a1: float
    a0: float
    b0: float
    next_position: Row  # factors of position, speed and u + d now
    next_speed: Row
    correction: Row  # factors of the reading minus the predicted position
    k1: float
    k2: float
    u_max: float
    period: float
    reshaping: reshaping.Params


class State(NamedTuple):
    """Reference and predicted state of the valve; its third number is the disturbance."""

    reference: reshaping.State
    valve: Row


class Terms(NamedTuple):
    """What the law computed at this sample, for recordings; a law has at least the first three."""

    reference: float  # V
    z1: float  # V
    unsaturated_voltage: float  # V
    disturbance: float  # V


def wanted(p: Params, r: reshaping.State, valve: Row, accel: float) -> float:
    """Voltage [V] before the limit, for the state ``valve``."""
    feedforward = (accel + p.a1 * r.rate + p.a0 * r.reference) / p.b0
    feedback = p.k1 * (valve.position - r.reference) + p.k2 * (valve.speed - r.rate)
    return feedforward - feedback - valve.voltage


def predicted(p: Params, s: State, command: float, voltage: float) -> State:
    """State after a sample in which ``voltage`` [V] is applied."""
    accel = reshaping.acceleration(p.reshaping, s.reference, command)
    x, v, d = s.valve
    a, b = p.next_position, p.next_speed
    position = a.position * x + a.speed * v + a.voltage * (voltage + d)
    speed = b.position * x + b.speed * v + b.voltage * (voltage + d)
    return State(reshaping.advance(p.reshaping, s.reference, accel), Row(position, speed, d))


def initial(p: Params, start: Start) -> State:
    """State with which the first step gives the voltage that ``start`` has."""
    reference = reshaping.State(start.reference, start.reference_rate)
    undisturbed = wanted(p, reference, Row(start.measurement, start.velocity, 0.0), 0.0)
    return State(reference, Row(start.measurement, start.velocity, undisturbed - start.voltage))


def step(
    p: Params, s: State, command: float, measurement: float, offset: float
) -> tuple[float, State, Terms]:
    """One sample: returns voltage [V] within ±u_max, the next state and the terms.

    ``command``, ``measurement`` [V]; ``offset`` [V] is 0 except after a change of the law, when it fades out.
    """
    error = measurement - s.valve.position
    l1, l2, l3 = p.correction
    x, v, d = s.valve
    valve = Row(x + l1 * error, v + l2 * error, d + l3 * error)
    accel = reshaping.acceleration(p.reshaping, s.reference, command)
    unsaturated = wanted(p, s.reference, valve, accel)
    voltage = saturate(unsaturated + offset, p.u_max)
    z1 = measurement - s.reference.reference
    terms = Terms(s.reference.reference, z1, unsaturated, valve.voltage)
    return voltage, predicted(p, State(s.reference, valve), command, voltage), terms


def hold(p: Params, s: State, command: float, measurement: float, voltage: float) -> State:
    """State after a sample without a reading: no correction; ``voltage`` [V] was held on."""
    return predicted(p, s, command, voltage)


PARAMETERS: Table = (
    Parameter("observer.a1", 58.8, "1/s", "damping of the valve", 0.0, 1e6),
    Parameter("observer.a0", 1657.0, "1/s²", "stiffness of the valve", 0.0, 1e9),
    Parameter("observer.b0", 1502.0, "1/s²", "gain of the valve", 1e-3, 1e9),
    Parameter("observer.loop", 60.0, "rad/s", "bandwidth of the loop", 1.0, 2000.0),
    Parameter("observer.estimation", 200.0, "rad/s", "bandwidth of the observer", 1.0, 2000.0),
)


def build(values: Values) -> Params:
    """Params from the controller's values: poles as those of Butterworth filters. Raises ParameterError."""
    a1, a0, b0, loop, estimation = (number(values, parameter.name) for parameter in PARAMETERS)
    period = number(values, "sample_period")
    a = expm(period * np.array([[0.0, 1.0, 0.0], [-a0, -a1, b0], [0.0, 0.0, 0.0]]))
    poles = [
        np.exp(period * butter(order, bandwidth, analog=True, output="zpk")[1])
        for order, bandwidth in ((2, loop), (3, estimation))
    ]
    k1, k2 = place_poles(a[:2, :2], a[:2, 2:], poles[0]).gain_matrix[0].tolist()
    correction = place_poles(a.T, a[:1].T, poles[1]).gain_matrix[0].tolist()
    x, v, _ = a.tolist()
    u_max, filtered = number(values, "u_max"), reshaping.build(values)
    return Params(a1, a0, b0, Row(*x), Row(*v), Row(*correction), k1, k2, u_max, period, filtered)


def model(p: Params) -> tuple[float, float, float]:
    """a1, a0, b0 of the valve b0/(s² + a1·s + a0): gains that are unstable on it cause a warning."""
    return p.a1, p.a0, p.b0


TUNABLE = (Free("observer.loop", 20.0, 1000.0), Free("observer.estimation", 50.0, 2000.0))
LAW = Law("observer", "state feedback", sys.modules[__name__], PARAMETERS, build, model, free=TUNABLE)
