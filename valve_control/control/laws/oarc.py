# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes output feedback adaptive robust control (OARC), (26)-(53).

The equations have the corrections of docs/reference/errata.md.

The weight ρ (``z2_weight``) puts z2 [V·s] on the scale of V/s in V2 = z1²/2 + ρ·z2²/2; ρ = 1 is the
paper. It changes the cross term to -θ̂3·z1/ρ, φ2's third entry likewise, and τ to φ1·z1 + ρ·φ2·z2.
"""

import sys
from typing import NamedTuple

from valve_control.control.laws import estimates, lyapunov_bound, projection, reshaping
from valve_control.control.laws.free import Free
from valve_control.control.laws.law import Law
from valve_control.control.laws.projection import Theta
from valve_control.control.laws.signals import Start
from valve_control.control.plant.saturation import saturate
from valve_control.parameter import Parameter, Table, Values, number


class Pair(NamedTuple):
    """State of a second-order filter."""

    first: float
    second: float


class Filter(NamedTuple):
    """Exact zero-order-hold discretisation of ẋ = A0·x + e2·input, A0 of (28)."""

    a11: float
    a12: float
    a21: float
    a22: float
    b1: float
    b2: float


class Params(NamedTuple):
    """Gains and bounds of the OARC law."""

    k1: float  # 1/s    observer, (28)
    k2: float  # 1/s²   observer, (28)
    ks1: float  # 1/s    (39)
    ks2: float  # 1/s    (48)
    z2_weight: float  # 1/s²   ρ
    gamma: Theta  # diagonal of Γ, (15)
    theta_initial: Theta  # θ̂(0)
    theta_min: Theta  # (5)
    theta_max: Theta  # (5)
    robust: float  # -      1.0: quadratic α_1s2 and u_s2, 0.0: none
    epsilon1: float  # V²/s   ε11 of (42)
    epsilon2: float  # V²/s   ε21 of (50)
    disturbance_bound: float  # V/s    bound on |ε_u,2| of (34)
    u_max: float  # V
    period: float  # s      ΔT
    filter: Filter
    reshaping: reshaping.Params
    lyapunov_bound: lyapunov_bound.Params


class State(NamedTuple):
    """Reference, K-filters, estimates and the bound on V2."""

    reference: reshaping.State
    eta: Pair  # η of (35)
    v0: Pair  # v_0 of (29)
    psi: Pair  # ψ_1 of (29)
    theta: Theta  # θ̂
    bound: lyapunov_bound.Sample  # of which the bound on V_2 goes on


class Terms(NamedTuple):
    """What the law computed at this sample."""

    reference: float  # V     x_vd
    reference_rate: float  # V/s
    reference_accel: float  # V/s²
    velocity: float  # V/s   estimate of dx_1/dt, (38)
    z1: float  # V     tracking error
    z2: float  # V·s   input discrepancy v_0,2 - α_1
    lyapunov: float  # V²    V_2
    lyapunov_bound: float  # V²    guaranteed bound on V_2, (52)
    virtual_control: float  # V·s   α_1 of (39)
    virtual_control_rate: float  # V     dα_1c/dt of (45)
    model_voltage: float  # V     u_a of (48)
    feedback_voltage: float  # V     u_s1 of (48)
    robust_voltage: float  # V     u_s2 of (50)
    unsaturated_voltage: float  # V
    a1: float  # 1/s   θ̂1 used at this sample
    a0: float  # 1/s²  θ̂2
    b0: float  # 1/s²  θ̂3
    b0dn: float  # V/s²  θ̂4


def ramp_filter(p: Params, value: float, rate: float) -> Pair:
    """Filter state that an input ``value`` + ``rate``·t leads to: -A0⁻¹·e2·value - A0⁻²·e2·rate."""
    k1, k2 = p.k1, p.k2
    return Pair(
        value / k2 - rate * k1 / (k2 * k2),
        k1 * value / k2 - rate * (k1 * k1 / k2 - 1.0) / k2,
    )


def initial(p: Params, start: Start) -> State:
    """State that starts at ``start`` with the initial estimates.

    The K-filters are where a steady motion at ``start.velocity`` would have brought them, with the
    voltage rising as the spool's stiffness asks; at rest this is their steady state.
    """
    voltage_rate = p.theta_initial.a0 / p.theta_initial.b0 * start.velocity
    return State(
        reshaping.State(start.reference, start.reference_rate),
        ramp_filter(p, start.measurement, start.velocity),
        ramp_filter(p, start.voltage, voltage_rate),
        ramp_filter(p, 1.0, 0.0),
        p.theta_initial,
        lyapunov_bound.FIRST,
    )


def advance_filter(f: Filter, x: Pair, value: float) -> Pair:
    """Filter state one period later, with its input held at ``value``."""
    return Pair(
        f.a11 * x.first + f.a12 * x.second + f.b1 * value,
        f.a21 * x.first + f.a22 * x.second + f.b2 * value,
    )


def law(p: Params, s: State, x1: float, accel: float) -> tuple[Terms, Theta, lyapunov_bound.Sample, float]:
    """Compute the law at one instant: terms, θ̂'s rate, sample of the bound, share of θ̂'s rate in the voltage.

    ``x1`` [V]: reading; ``accel`` [V/s²]: of the reference, whose value and rate are in ``s``. The voltage of
    the terms is that before saturation, for estimates that move.
    """
    theta, eta, v0, psi = s.theta, s.eta, s.v0, s.psi
    reference, rate = s.reference.reference, s.reference.rate
    k1, k2, rho = p.k1, p.k2, p.z2_weight
    b0_min = p.theta_min.b0
    inverse_b0 = 1.0 / theta.b0
    stiffness = p.ks1 / b0_min
    span = projection.span(p.theta_min, p.theta_max)

    xi22 = -k1 * k2 * eta.first + k2 * eta.second  # (35)
    xi12 = -k2 * eta.first  # (35)
    xi02 = eta.second  # (35)
    v02 = v0.second
    psi2 = psi.second
    xi22_dot = -k1 * k2 * (-k1 * eta.first + eta.second) + k2 * (-k2 * eta.first + x1)
    xi12_dot = -k2 * (-k1 * eta.first + eta.second)
    xi02_dot = -k2 * eta.first + x1
    psi2_dot = -k2 * psi.first + 1.0  # (29)

    z1 = x1 - reference  # (36)
    alpha_a = (
        -xi22 + theta.a1 * (xi12 + x1) + theta.a0 * xi02 - theta.b0dn * psi2 + rate
    ) * inverse_b0  # (39)
    alpha_s1 = -stiffness * z1  # (39)
    phi1 = Theta(-(xi12 + x1), -xi02, alpha_a, psi2)  # (40)

    w1 = span.a1 * span.a1
    w2 = span.a0 * span.a0
    w3 = span.b0 * span.b0
    w4 = span.b0dn * span.b0dn
    scale = 0.0  # of the smooth bound 5*(Σ wi*φi² + δ²) >= (Σ |θimax - θimin|*|φi| + δ)²
    if p.robust > 0.0:
        scale = 5.0 / (4.0 * p.epsilon1 * b0_min)
    gain = scale * (
        w1 * phi1.a1 * phi1.a1
        + w2 * phi1.a0 * phi1.a0
        + w3 * phi1.b0 * phi1.b0
        + w4 * phi1.b0dn * phi1.b0dn
        + p.disturbance_bound * p.disturbance_bound
    )
    alpha_s2 = -gain * z1  # (42)
    alpha = alpha_a + alpha_s1 + alpha_s2  # (39)
    z2 = v02 - alpha

    gain_slope = 2.0 * scale * (w3 * phi1.b0 * theta.a1 * inverse_b0 - w1 * phi1.a1)
    slope = theta.a1 * inverse_b0 - stiffness - gain - gain_slope * z1  # ∂α1/∂x1
    phi2 = Theta(slope * (xi12 + x1), slope * xi02, z1 / rho - slope * v02, -slope * psi2)  # (49), corrected
    tau = Theta(
        phi1.a1 * z1 + rho * phi2.a1 * z2,
        phi1.a0 * z1 + rho * phi2.a0 * z2,
        phi1.b0 * z1 + rho * phi2.b0 * z2,
        phi1.b0dn * z1 + rho * phi2.b0dn * z2,
    )  # (51)
    theta_rate = projection.rates(theta, p.gamma, tau, p.theta_min, p.theta_max)  # (15)

    x1_dot = (
        xi22 - theta.a1 * (xi12 + x1) - theta.a0 * xi02 + theta.b0 * v02 + theta.b0dn * psi2
    )  # (38), calculable part
    alpha_a_dot = (
        -xi22_dot
        + theta_rate.a1 * (xi12 + x1)
        + theta.a1 * (xi12_dot + x1_dot)
        + theta_rate.a0 * xi02
        + theta.a0 * xi02_dot
        - theta_rate.b0dn * psi2
        - theta.b0dn * psi2_dot
        + accel
        - theta_rate.b0 * alpha_a
    ) * inverse_b0
    gain_dot = (
        2.0
        * scale
        * (
            w1 * phi1.a1 * -(xi12_dot + x1_dot)
            + w2 * phi1.a0 * -xi02_dot
            + w3 * phi1.b0 * alpha_a_dot
            + w4 * phi1.b0dn * psi2_dot
        )
    )
    alpha_dot = alpha_a_dot - (stiffness + gain) * (x1_dot - rate) - gain_dot * z1  # (45), whole

    u_a = k2 * v0.first - theta.b0 * z1 / rho + alpha_dot  # (48), corrected
    u_s1 = -p.ks2 * z2  # (48)
    h1 = projection.uncertainty(span, phi1, p.disturbance_bound)
    h2 = projection.uncertainty(span, phi2, abs(slope) * p.disturbance_bound)
    u_s2 = 0.0
    growth = (h1 * h1 * p.ks2 + rho * h2 * h2 * p.ks1) / (2.0 * p.ks1 * p.ks2)
    if p.robust > 0.0:
        growth = p.epsilon1 + p.epsilon2
        u_s2 = -rho * h2 * h2 * z2 / (4.0 * p.epsilon2)  # (50), completing the square
    lyapunov = 0.5 * z1 * z1 + 0.5 * rho * z2 * z2
    known = u_s1 + u_s2 - theta.b0 * z1 / rho  # of dz2/dt, (47)
    now = lyapunov_bound.Sample(lyapunov, growth, z1, z2, rate, x1, x1_dot, known)
    now = lyapunov_bound.output_feedback(p.lyapunov_bound, s.bound, now, rho, slope)
    terms = Terms(
        reference,
        rate,
        accel,
        x1_dot,
        z1,
        z2,
        lyapunov,
        now.bound,
        alpha,
        alpha_dot,
        u_a,
        u_s1,
        u_s2,
        u_a + u_s1 + u_s2,  # (48)
        theta.a1,
        theta.a0,
        theta.b0,
        theta.b0dn,
    )
    share = (
        (
            theta_rate.a1 * (xi12 + x1)
            + theta_rate.a0 * xi02
            - theta_rate.b0dn * psi2
            - theta_rate.b0 * alpha_a
        )
        * inverse_b0
        * (1.0 - 2.0 * scale * w3 * phi1.b0 * z1)
    )
    return terms, theta_rate, now, share


def step(
    p: Params, s: State, command: float, measurement: float, offset: float
) -> tuple[float, State, Terms]:
    """Compute one sample; returns the voltage [V] within ±u_max, the next state and the terms.

    The K-filters take the voltage after saturation, so that (30) stays true; the estimates rest while
    the amplifier saturates, because (47), from which τ follows, does not hold then. The voltage is then that
    of resting estimates: with α̇1 of (45) for moving ones it can stay at its limit for ever, away from the
    command.
    """
    accel = reshaping.acceleration(p.reshaping, s.reference, command)
    terms, theta_rate, now, share = law(p, s, measurement, accel)
    wanted = terms.unsaturated_voltage + offset
    voltage = saturate(wanted, p.u_max)
    theta, bound = s.theta, lyapunov_bound.FIRST
    if voltage != wanted:
        voltage = saturate(wanted - share, p.u_max)
    else:
        theta = projection.advance(theta, theta_rate, p.period, p.theta_min, p.theta_max)
        if voltage == terms.unsaturated_voltage:
            bound = now
    return voltage, advanced(p, s, accel, measurement, voltage, theta, bound), terms


def advanced(
    p: Params, s: State, accel: float, x1: float, voltage: float, theta: Theta, bound: lyapunov_bound.Sample
) -> State:
    """State at the next sample, with the reading ``x1`` [V] and the ``voltage`` [V] that is applied."""
    return State(
        reshaping.advance(p.reshaping, s.reference, accel),
        advance_filter(p.filter, s.eta, x1),
        advance_filter(p.filter, s.v0, voltage),
        advance_filter(p.filter, s.psi, 1.0),
        theta,
        bound,
    )


def hold(p: Params, s: State, command: float, measurement: float, voltage: float) -> State:
    """State after a sample without a reading: the amplifier holds ``voltage`` [V], the estimates rest.

    ``measurement`` [V]: what the reading may have been, interpolated.
    """
    accel = reshaping.acceleration(p.reshaping, s.reference, command)
    return advanced(p, s, accel, measurement, voltage, s.theta, lyapunov_bound.FIRST)


PARAMETERS: Table = (
    Parameter("oarc.k1", 308.0, "1/s", "observer gain k1 of (28)", 1e-3, 1e6),
    Parameter("oarc.k2", 48400.0, "1/s²", "observer gain k2 of (28)", 1e-3, 1e12),
    Parameter("oarc.ks1", 120.0, "1/s", "gain ks1 of (39)", 1e-3, 1e5),
    Parameter("oarc.ks2", 120.0, "1/s", "gain ks2 of (48)", 1e-3, 1e5),
    Parameter("oarc.z2_weight", 1.44e6, "1/s²", "weight ρ of z2² in V2; the paper has 1.0", 1e-3, 1e12),
    *estimates.parameters("oarc", [2.0, 110.0, 120.0, 4000.0]),
    Parameter("oarc.epsilon1", 1e3, "V²/s", "ε11 of (42) for the quadratic robust term", 1e-9, 1e12),
    Parameter("oarc.epsilon2", 1e3, "V²/s", "ε21 of (50) for the quadratic robust term", 1e-9, 1e12),
    Parameter("oarc.disturbance_bound", 5.0, "V/s", "bound on |ε_u,2| of (34)", 0.0, 1e9),
)


def k_filter(k1: float, k2: float, period: float) -> Filter:
    """Exact zero-order-hold discretisation of ẋ = A0·x + e2·input, A0 of (28).

    ``k1`` [1/s] and ``k2`` [1/s²]: observer gains; ``period`` [s].
    """
    import numpy as np
    import scipy.linalg  # takes a while, which a command that builds no law need not wait

    both = np.array([[-k1, 1.0, 0.0], [-k2, 0.0, 1.0], [0.0, 0.0, 0.0]])
    a00, a01, b0, a10, a11, b1 = map(float, scipy.linalg.expm(period * both)[:2].ravel())
    return Filter(a00, a01, a10, a11, b0, b1)


def build(values: Values) -> Params:
    """OARC's Params from the controller's values. Raises ParameterError."""
    shared = estimates.params(values, "oarc")
    k1, k2 = number(values, "oarc.k1"), number(values, "oarc.k2")
    ks1, ks2 = number(values, "oarc.ks1"), number(values, "oarc.ks2")
    period = number(values, "sample_period")
    decay = (2.0 if shared["robust"] > 0.0 else 1.0) * min(ks1, ks2)
    return Params(
        k1=k1,
        k2=k2,
        ks1=ks1,
        ks2=ks2,
        z2_weight=number(values, "oarc.z2_weight"),
        epsilon1=number(values, "oarc.epsilon1"),
        epsilon2=number(values, "oarc.epsilon2"),
        filter=k_filter(k1, k2, period),
        lyapunov_bound=lyapunov_bound.design(decay, period),
        **shared,
    )


LAW = Law(
    name="oarc",
    text="output feedback adaptive robust control (26)-(53)",
    module=sys.modules[__name__],
    parameters=PARAMETERS,
    build=build,
    model=estimates.model,
    form=("oarc.k1", "oarc.k2"),
    linear=estimates.at_rest,
    free=(
        Free("oarc.k1", 50.0, 3000.0, powers=(1, 0)),
        Free("oarc.k2", 1e3, 3e6, powers=(2, 0)),
        Free("oarc.ks1", 10.0, 600.0, powers=(1, 0)),
        Free("oarc.ks2", 10.0, 600.0, powers=(1, 0)),
        Free("oarc.z2_weight", 1e4, 1e8, powers=(4, 2)),
        *estimates.free("oarc"),
    ),
    remedy="shorten sample_period, raise oarc.z2_weight or lower the gains",
)
