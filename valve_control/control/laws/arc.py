# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes full state feedback adaptive robust control (ARC), (17)-(25)."""

import math
import sys
from typing import NamedTuple

from valve_control.control.laws import estimates, lyapunov_bound, projection, reshaping, velocity
from valve_control.control.laws.free import Free
from valve_control.control.laws.law import Law
from valve_control.control.laws.projection import Theta
from valve_control.control.laws.signals import Start
from valve_control.control.plant.saturation import saturate
from valve_control.parameter import Parameter, Table, Values, number


class Params(NamedTuple):
    """Gains and bounds of the ARC law."""

    k1: float  # 1/s      (18)
    k2: float  # 1/s      (20)
    gamma: Theta  # diagonal of Γ, (15)
    theta_initial: Theta  # θ̂(0)
    theta_min: Theta  # (5)
    theta_max: Theta  # (5)
    robust: float  # -        1.0: quadratic u_s2, 0.0: none
    epsilon: float  # V²/s³    ε2 of (23)
    disturbance_bound: float  # V/s²     δ_d of (5)
    u_max: float  # V
    period: float  # s        ΔT
    reshaping: reshaping.Params
    velocity: velocity.Params
    lyapunov_bound: lyapunov_bound.Params


class State(NamedTuple):
    """Reference, velocity filter, estimates and the bound on V2."""

    reference: reshaping.State
    velocity: velocity.State
    theta: Theta  # θ̂
    bound: float  # V²/s²  guaranteed bound on V_2


class Terms(NamedTuple):
    """What the law computed at this sample."""

    reference: float  # V     x_vd
    reference_rate: float  # V/s
    reference_accel: float  # V/s²
    velocity: float  # V/s   x_2
    z1: float  # V     tracking error
    z2: float  # V/s   (18)
    lyapunov: float  # V²/s² V_2 of (24)
    lyapunov_bound: float  # V²/s² guaranteed bound on V_2, (25)
    model_voltage: float  # V     u_a of (20)
    feedback_voltage: float  # V     u_s1 of (20)
    robust_voltage: float  # V     u_s2 of (23)
    unsaturated_voltage: float  # V
    a1: float  # 1/s   θ̂1 used at this sample
    a0: float  # 1/s²  θ̂2
    b0: float  # 1/s²  θ̂3
    b0dn: float  # V/s²  θ̂4


def initial(p: Params, start: Start) -> State:
    """State that starts at ``start`` with the initial estimates."""
    return State(
        reshaping.State(start.reference, start.reference_rate),
        velocity.State(start.measurement, start.velocity),
        p.theta_initial,
        lyapunov_bound.ANEW,
    )


def law(p: Params, s: State, x1: float, x2: float, accel: float) -> tuple[Terms, Theta, float]:
    """Compute the continuous law at one instant: terms (voltage before saturation), τ of (21), growth of V2.

    ``x1`` [V], ``x2`` [V/s]: spool position and velocity; ``accel`` [V/s²]: of the reference, whose value
    and rate are in ``s``.
    """
    theta = s.theta
    reference, rate = s.reference.reference, s.reference.rate
    z1 = x1 - reference
    x2eq = rate - p.k1 * z1  # (18)
    z2 = x2 - x2eq  # (18)
    x2eq_dot = accel - p.k1 * (x2 - rate)  # (19)
    u_a = (theta.a1 * x2 + theta.a0 * x1 - theta.b0dn + x2eq_dot - z1) / theta.b0  # (20)
    u_s1 = -p.k2 * z2 / p.theta_min.b0  # (20)
    phi2 = Theta(-x2, -x1, u_a, 1.0)  # (21)
    span = projection.span(p.theta_min, p.theta_max)
    h = projection.uncertainty(span, phi2, p.disturbance_bound)
    u_s2 = 0.0
    growth = h * h / (2.0 * p.k2)
    if p.robust > 0.0:
        growth = p.epsilon
        u_s2 = -h * h * z2 / (4.0 * p.epsilon * p.theta_min.b0)  # (23), completing the square
    tau = Theta(phi2.a1 * z2, phi2.a0 * z2, phi2.b0 * z2, phi2.b0dn * z2)  # (21)
    lyapunov = 0.5 * z1 * z1 + 0.5 * z2 * z2  # (24)
    terms = Terms(
        reference,
        rate,
        accel,
        x2,
        z1,
        z2,
        lyapunov,
        lyapunov_bound.begin(s.bound, lyapunov),
        u_a,
        u_s1,
        u_s2,
        u_a + u_s1 + u_s2,  # (20)
        theta.a1,
        theta.a0,
        theta.b0,
        theta.b0dn,
    )
    return terms, tau, growth


def step(
    p: Params, s: State, command: float, measurement: float, offset: float
) -> tuple[float, State, Terms]:
    """Compute one sample; returns the voltage [V] within ±u_max, the next state and the terms.

    The estimates rest while the amplifier saturates: (22), from which τ follows, holds only when the
    voltage of (20) is the one applied.
    """
    accel = reshaping.acceleration(p.reshaping, s.reference, command)
    estimate = velocity.step(p.velocity, s.velocity, measurement)
    terms, tau, growth = law(p, s, measurement, estimate.velocity, accel)
    wanted = terms.unsaturated_voltage + offset
    voltage = saturate(wanted, p.u_max)
    theta = s.theta
    if voltage == wanted:
        rate = projection.rates(theta, p.gamma, tau, p.theta_min, p.theta_max)  # (15)
        theta = projection.advance(theta, rate, p.period, p.theta_min, p.theta_max)
    reference = reshaping.advance(p.reshaping, s.reference, accel)
    own = voltage == terms.unsaturated_voltage
    bound = lyapunov_bound.wait(p.lyapunov_bound, s.bound, terms.lyapunov_bound, growth, own)
    return voltage, State(reference, estimate, theta, bound), terms


def hold(p: Params, s: State, command: float, measurement: float, voltage: float) -> State:
    """State after a sample without a reading: the amplifier holds ``voltage`` [V], the estimates rest.

    ``measurement`` [V]: what the reading may have been, interpolated.
    """
    accel = reshaping.acceleration(p.reshaping, s.reference, command)
    return State(
        reshaping.advance(p.reshaping, s.reference, accel),
        velocity.step(p.velocity, s.velocity, measurement),
        s.theta,
        p.lyapunov_bound.anew,
    )


PARAMETERS: Table = (
    Parameter("arc.k1", 120.0, "1/s", "gain k1 of (18)", 1e-3, 1e5),
    Parameter("arc.k2", 120.0, "1/s", "gain k2 of (20)", 1e-3, 1e5),
    *estimates.parameters("arc", [2.0, 110.0, 120.0, 500.0]),
    Parameter("arc.epsilon", 1e6, "V²/s³", "ε2 of (23) for the quadratic robust term", 1e-9, 1e12),
    Parameter("arc.disturbance_bound", 1000.0, "V/s²", "bound δ_d of (5)", 0.0, 1e9),
    Parameter("arc.velocity_cutoff", 150.0, "Hz", "cut-off of the velocity estimate's low-pass", 1.0, 1e5),
)


def build(values: Values) -> Params:
    """ARC's Params from the controller's values. Raises ParameterError."""
    shared = estimates.params(values, "arc")
    k1, k2 = number(values, "arc.k1"), number(values, "arc.k2")
    cutoff, period = number(values, "arc.velocity_cutoff"), number(values, "sample_period")
    decay = 2.0 * min(k1, k2) if shared["robust"] > 0.0 else min(2.0 * k1, k2)
    return Params(
        k1=k1,
        k2=k2,
        epsilon=number(values, "arc.epsilon"),
        velocity=velocity.design(cutoff, period),
        lyapunov_bound=lyapunov_bound.design(decay, period, 0.5 / (math.pi * cutoff)),
        **shared,
    )


LAW = Law(
    name="arc",
    text="full state feedback adaptive robust control (17)-(25)",
    module=sys.modules[__name__],
    parameters=PARAMETERS,
    build=build,
    model=estimates.model,
    linear=estimates.at_rest,
    free=(
        Free("arc.k1", 10.0, 600.0, powers=(1, 0)),
        Free("arc.k2", 10.0, 600.0, powers=(1, 0)),
        *estimates.free("arc"),
        Free("arc.velocity_cutoff", 20.0, 500.0, powers=(1, 0)),
    ),
)
