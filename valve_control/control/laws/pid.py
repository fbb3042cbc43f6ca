# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes the PID with model feedforward (54)-(56), and the plain PID that most people would use instead.

Three forms, told apart by the two switches of ``Params``:

paper      (56) as printed: the model terms use the *measured* position and velocity, which cancels the
           valve's own damping and stiffness; the closed loop is s³ + kd·θ3·s² + kp·θ3·s + ki·θ3.
reference  the model terms use the *reference*; this, not (54), has the characteristic equation (55).
plain      static feedforward of the command and a filtered derivative of the error, as in
           ros2_controllers' pid_controller; no reshaping.
"""

import math
import sys
from typing import NamedTuple

from valve_control.control.laws import reshaping, velocity
from valve_control.control.laws.free import Free
from valve_control.control.laws.law import Law, reshaped_steady_command
from valve_control.control.laws.signals import Start
from valve_control.control.plant.saturation import saturate
from valve_control.parameter import Parameter, ParameterError, Table, Values, number, numbers, word


class Params(NamedTuple):
    """Gains of the PID law."""

    kp: float  # -    (V/V)
    ki: float  # 1/s
    kd: float  # s
    a1: float  # 1/s   θ1(0) of (56)
    a0: float  # 1/s²  θ2(0) of (56)
    b0: float  # 1/s²  θ3(0) of (56)
    measured_model_terms: float  # 1.0: paper's (56), 0.0: reference form
    plain: float  # 1.0: plain form
    static_feedforward: float  # V/V, plain form only
    u_max: float  # V
    period: float  # s  ΔT
    reshaping: reshaping.Params
    velocity: velocity.Params


class State(NamedTuple):
    """Reference, derivative filter and integrator."""

    reference: reshaping.State
    velocity: velocity.State  # of the measurement; of the error in the plain form
    integral: float  # V  ki·∫z1 dt, so that a new ki does not bump
    started: float  # 1.0 once the derivative filter has seen a sample


class Terms(NamedTuple):
    """What the law computed at this sample."""

    reference: float  # V
    reference_rate: float  # V/s
    reference_accel: float  # V/s²
    velocity: float  # V/s  filtered derivative of the measurement (of the error in the plain form)
    z1: float  # V
    feedforward_voltage: float  # V
    proportional_voltage: float  # V
    integral_voltage: float  # V
    derivative_voltage: float  # V
    unsaturated_voltage: float  # V


def place_poles(break_frequency: float, a1: float, a0: float, b0: float) -> tuple[float, float, float]:
    """Gains (kp [-], ki [1/s], kd [s]) that put all three roots of (55) at ``break_frequency`` [Hz]."""
    w = 2.0 * math.pi * break_frequency
    return (3.0 * w * w - a0) / b0, w * w * w / b0, (3.0 * w - a1) / b0


def initial(p: Params, start: Start) -> State:
    """State that starts at ``start``, with the integrator at the voltage that holds the spool there."""
    reference = reshaping.State(start.reference, start.reference_rate)
    if p.plain > 0.0:
        integral = start.voltage - p.static_feedforward * start.measurement
        return State(reference, velocity.State(0.0, 0.0), -integral, 0.0)
    z1 = start.measurement - start.reference
    if p.measured_model_terms > 0.0:
        model = (p.a1 * start.velocity + p.a0 * start.measurement) / p.b0
    else:
        model = (p.a1 * start.reference_rate + p.a0 * start.reference) / p.b0
    derivative = -p.kd * (start.velocity - start.reference_rate)
    integral = start.voltage - model + p.kp * z1 - derivative
    return State(reference, velocity.State(start.measurement, start.velocity), -integral, 1.0)


def step(
    p: Params, s: State, command: float, measurement: float, offset: float
) -> tuple[float, State, Terms]:
    """Compute one sample; returns the voltage [V] within ±u_max, the next state and the terms.

    Anti-windup: the integrator rests while the amplifier saturates and the error would drive it deeper.
    """
    accel = 0.0
    reference = s.reference
    filtered = s.velocity
    if p.plain > 0.0:
        reference = reshaping.State(command, 0.0)
        z1 = measurement - command
        if s.started == 0.0:
            filtered = velocity.State(z1, 0.0)
        filtered = velocity.step(p.velocity, filtered, z1)
        z1_dot = filtered.velocity
        feedforward = p.static_feedforward * command
    else:
        accel = reshaping.acceleration(p.reshaping, reference, command)
        filtered = velocity.step(p.velocity, filtered, measurement)
        z1 = measurement - reference.reference
        z1_dot = filtered.velocity - reference.rate
        if p.measured_model_terms > 0.0:
            feedforward = (accel + p.a1 * filtered.velocity + p.a0 * measurement) / p.b0  # (56)
        else:
            feedforward = (accel + p.a1 * reference.rate + p.a0 * reference.reference) / p.b0
    proportional = -p.kp * z1  # (56)
    integral = -s.integral  # (56)
    derivative = -p.kd * z1_dot  # (56)
    unsaturated = feedforward + proportional + integral + derivative
    wanted = unsaturated + offset
    voltage = saturate(wanted, p.u_max)
    accumulated = s.integral
    if voltage == wanted or (wanted > voltage and z1 > 0.0) or (wanted < voltage and z1 < 0.0):
        accumulated = s.integral + p.ki * z1 * p.period
    terms = Terms(
        reference.reference,
        reference.rate,
        accel,
        filtered.velocity,
        z1,
        feedforward,
        proportional,
        integral,
        derivative,
        unsaturated,
    )
    if p.plain == 0.0:
        reference = reshaping.advance(p.reshaping, reference, accel)
    return voltage, State(reference, filtered, accumulated, 1.0), terms


def hold(p: Params, s: State, command: float, measurement: float, voltage: float) -> State:
    """State after a sample without a reading: the amplifier holds ``voltage`` [V], the integral goes on.

    ``measurement`` [V]: what the reading may have been, interpolated.
    """
    if p.plain > 0.0:
        z1 = measurement - command
        filtered = velocity.step(p.velocity, s.velocity, z1)
        reference = reshaping.State(command, 0.0)
    else:
        z1 = measurement - s.reference.reference
        filtered = velocity.step(p.velocity, s.velocity, measurement)
        accel = reshaping.acceleration(p.reshaping, s.reference, command)
        reference = reshaping.advance(p.reshaping, s.reference, accel)
    integral = s.integral
    if abs(voltage) < p.u_max:
        integral = s.integral + p.ki * z1 * p.period
    return State(reference, filtered, integral, s.started)


PARAMETERS: Table = (
    Parameter(
        "pid.form",
        "paper",
        "",
        "paper: (56) as printed; reference: model terms from the reference, as in (55); plain: static "
        "feedforward, filtered derivative, no reshaping",
        choices=("paper", "reference", "plain"),
    ),
    Parameter("pid.kp", 3.837, "V/V", "proportional gain", 0.0, 1e6),
    Parameter("pid.ki", 70.901, "1/s", "integral gain", 0.0, 1e9),
    Parameter("pid.kd", 0.093, "s", "derivative gain", 0.0, 1e3),
    Parameter(
        "pid.break_frequency", 0.0, "Hz", "frequency of all poles of (55); 0: gains as given", 0.0, 1e4
    ),
    Parameter(
        "pid.theta", [20.0, 1200.0, 1200.0], "", "model terms θ1(0), θ2(0), θ3(0) of (56)", 0.0, 1e9, length=3
    ),
    Parameter(
        "pid.static_feedforward", 1.18, "V/V", "feedforward of the command in the plain form", 0.0, 1e3
    ),
    Parameter("pid.derivative_cutoff", 374.0, "Hz", "cut-off of the derivative's low-pass", 1.0, 1e5),
)


def build(values: Values) -> Params:
    """The PID's Params from the controller's values. Raises ParameterError."""
    period = number(values, "sample_period")
    a1, a0, b0 = numbers(values, "pid.theta")
    if b0 <= 0.0:
        raise ParameterError(f"pid.theta[2] (b0) is {b0:g}; it must be positive")
    kp, ki, kd = (number(values, f"pid.{gain}") for gain in ("kp", "ki", "kd"))
    frequency = number(values, "pid.break_frequency")
    if frequency > 0.0:
        kp, ki, kd = place_poles(frequency, a1, a0, b0)
        if min(kp, kd) < 0.0:
            raise ParameterError(
                f"pid.break_frequency is {frequency:g} Hz, which is slower than the valve itself and "
                f"would need negative gains (kp {kp:.3g}, kd {kd:.3g}); choose a higher one"
            )
    form = word(values, "pid.form")
    return Params(
        kp=kp,
        ki=ki,
        kd=kd,
        a1=a1,
        a0=a0,
        b0=b0,
        measured_model_terms=1.0 if form == "paper" else 0.0,
        plain=1.0 if form == "plain" else 0.0,
        static_feedforward=number(values, "pid.static_feedforward"),
        u_max=number(values, "u_max"),
        period=period,
        reshaping=reshaping.build(values),
        velocity=velocity.design(number(values, "pid.derivative_cutoff"), period),
    )


def model(p: Params) -> tuple[float, float, float]:
    """a1, a0 and b0 of the model terms."""
    return p.a1, p.a0, p.b0


def steady_command(p: Params, start: Start) -> float:
    """Command [V] under which the law goes on as at ``start``."""
    if p.plain > 0.0:
        return start.measurement
    return reshaped_steady_command(p, start)


def inverse(values: Values, terms: tuple[float, float, float], lag: float, cutoff: float) -> Values:
    """Gains of (c0 + c1·s + c2·s²)/(lag·s), not of the paper's form. Raises ParameterError."""
    if word(values, "pid.form") == "paper":
        raise ParameterError("pid.form is paper, whose gains follow from the break frequency")
    c0, c1, c2 = terms
    return {
        "pid.break_frequency": 0.0,
        "pid.kp": c1 / lag,
        "pid.ki": c0 / lag,
        "pid.kd": c2 / lag,
        "pid.derivative_cutoff": cutoff,
    }


def feedforward(values: Values, terms: tuple[float, float, float], part: float) -> Values:
    """Voltage for a motion, c0·x + c1·dx/dt + c2·d²x/dt²; the plain form has a ``part`` of c0 alone."""
    c0, c1, c2 = terms
    if word(values, "pid.form") == "plain":
        return {"pid.static_feedforward": part * c0}
    return {"pid.theta": [c1 / c2, c0 / c2, 1.0 / c2]}


def proportional(values: Values) -> float:
    """Proportional gain, in which the other two are counted when they are chosen."""
    return number(values, "pid.kp")


LAW = Law(
    name="pid",
    text="PID with model feedforward (54)-(56), or plain",
    module=sys.modules[__name__],
    parameters=PARAMETERS,
    build=build,
    model=model,
    reshapes=lambda params: params.plain == 0.0,  # the plain form follows the command as it comes
    steady_command=steady_command,
    form=("pid.form",),
    free=(
        Free("pid.kp", 0.3, 60.0, powers=(0, -1)),
        Free("pid.ki", 3.0, 1000.0, unit=proportional, powers=(1, 0)),  # 1/s  1/T_i
        Free("pid.kd", 3e-4, 0.03, unit=proportional, powers=(-1, 0)),  # s  T_d
        Free("pid.derivative_cutoff", 20.0, 500.0, powers=(1, 0)),
        Free("pid.static_feedforward", 0.3, 3.0, only=("pid.form", "plain"), powers=(0, -1)),
        Free("pid.theta[0]", 5.0, 200.0, only=("pid.form", "reference", "paper"), powers=(1, 0)),
        Free("pid.theta[1]", 300.0, 5000.0, only=("pid.form", "reference", "paper"), powers=(2, 0)),
        Free("pid.theta[2]", 300.0, 5000.0, only=("pid.form", "reference", "paper"), powers=(2, 1)),
    ),
    variants=(
        {"pid.form": "plain", "pid.break_frequency": 0.0},
        {"pid.form": "reference", "pid.break_frequency": 0.0},
    ),
    inverse=inverse,
    feedforward=feedforward,
)
