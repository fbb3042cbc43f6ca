# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lead-lag feedback: u = x_r/K + k·(e + T·ė) + ki·∫e, with e = x_r - y and the derivative filtered.

x_r is the command within limits of speed and acceleration (``reshaping``), y the reading, K the static gain.
"""

import sys
from typing import NamedTuple

from valve_control.control.laws import reshaping, velocity
from valve_control.control.laws.free import Free
from valve_control.control.laws.law import Law
from valve_control.control.laws.signals import Start
from valve_control.control.plant.saturation import saturate
from valve_control.parameter import Parameter, Table, Values, number


class Params(NamedTuple):
    """Gains."""

    gain: float
    lead: float
    integral: float
    static_gain: float
    u_max: float
    period: float
    reshaping: reshaping.Params
    velocity: velocity.Params


class State(NamedTuple):
    """Reference, derivative filter and integrator."""

    reference: reshaping.State
    velocity: velocity.State
    integral: float  # V


class Terms(NamedTuple):
    """What the law computed at this sample, for recordings; a law has at least these."""

    reference: float  # V
    z1: float  # V
    unsaturated_voltage: float  # V


def initial(p: Params, start: Start) -> State:
    """State with which the first step gives the voltage that ``start`` has."""
    reference = reshaping.State(start.reference, start.reference_rate)
    z1 = start.measurement - start.reference
    rate = start.velocity - start.reference_rate
    integral = start.voltage - start.reference / p.static_gain + p.gain * (z1 + p.lead * rate)
    return State(reference, velocity.State(start.measurement, start.velocity), integral)


def step(
    p: Params, s: State, command: float, measurement: float, offset: float
) -> tuple[float, State, Terms]:
    """One sample: returns voltage [V] within ±u_max, the next state and the terms.

    ``command``, ``measurement`` [V]; ``offset`` [V] is 0 except after a change of the law, when it fades out.
    """
    accel = reshaping.acceleration(p.reshaping, s.reference, command)
    filtered = velocity.step(p.velocity, s.velocity, measurement)
    z1 = measurement - s.reference.reference
    lead = p.lead * (filtered.velocity - s.reference.rate)
    unsaturated = s.reference.reference / p.static_gain - p.gain * (z1 + lead) + s.integral
    wanted = unsaturated + offset
    voltage = saturate(wanted, p.u_max)
    integral = s.integral - p.integral * z1 * p.period if voltage == wanted else s.integral
    state = State(reshaping.advance(p.reshaping, s.reference, accel), filtered, integral)
    return voltage, state, Terms(s.reference.reference, z1, unsaturated)


def hold(p: Params, s: State, command: float, measurement: float, voltage: float) -> State:
    """State after a sample at which no reading came; ``voltage`` [V] was held on."""
    return step(p, s, command, measurement, 0.0)[1]


PARAMETERS: Table = (
    Parameter("lead.gain", 2.0, "V/V", "proportional gain", 0.0, 1e3),
    Parameter("lead.lead", 0.02, "s", "time constant of the lead", 0.0, 1.0),
    Parameter("lead.integral", 30.0, "1/s", "integral gain", 0.0, 1e6),
    Parameter("lead.static_gain", 0.83, "V/V", "steady position over voltage", 1e-3, 1e3),
)


def build(values: Values) -> Params:
    """Params from the controller's values. Raises ParameterError."""
    period = number(values, "sample_period")
    return Params(
        gain=number(values, "lead.gain"),
        lead=number(values, "lead.lead"),
        integral=number(values, "lead.integral"),
        static_gain=number(values, "lead.static_gain"),
        u_max=number(values, "u_max"),
        period=period,
        reshaping=reshaping.build(values),
        velocity=velocity.design(150.0, period),  # Hz, s
    )


def model(p: Params) -> tuple[float, float, float]:
    """a1, a0, b0 of the valve b0/(s² + a1·s + a0): gains that are unstable on it cause a warning."""
    return 58.8, 1657.0, 1502.0


TUNABLE = (Free("lead.gain", 0.2, 50.0), Free("lead.lead", 0.001, 0.1), Free("lead.integral", 1.0, 3000.0))
LAW = Law("lead", "lead-lag feedback", sys.modules[__name__], PARAMETERS, build, model, free=TUNABLE)
