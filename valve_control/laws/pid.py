"""PID with model feedforward (54)-(56), and the plain PID that most people would use instead.

Three forms, told apart by the two switches of ``Params``:

paper      (56) as printed: the model terms use the *measured* position and velocity, which cancels the
           valve's own damping and stiffness; the closed loop is s³ + kd·θ3·s² + kp·θ3·s + ki·θ3.
reference  the model terms use the *reference*; this, not (54), has the characteristic equation (55).
plain      static feedforward of the command and a filtered derivative of the error, as in
           ros2_controllers' pid_controller; no reshaping.
"""

import math
from typing import NamedTuple

from valve_control.laws import reshaping, velocity
from valve_control.laws.signals import Start, saturate


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
    """One sample: returns voltage [V] within ±u_max, the next state and the terms.

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
    """State after a sample at which nothing was read: ``voltage`` [V] held on, the integral goes on.

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
