"""Output feedback adaptive robust control (OARC), (26)-(53), with the corrections of the README.

The weight ρ (``z2_weight``) puts z2 [V·s] on the scale of V/s in V2 = z1²/2 + ρ·z2²/2; ρ = 1 is the
paper. It changes the cross term to -θ̂3·z1/ρ, φ2's third entry likewise, and τ to φ1·z1 + ρ·φ2·z2.
"""

from typing import NamedTuple

from valve_control.laws import guarantee, projection, reshaping
from valve_control.laws.projection import Theta
from valve_control.laws.signals import Start, saturate


class Pair(NamedTuple):
    """A filter state of dimension two."""

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
    guarantee: guarantee.Params


class State(NamedTuple):
    """Reference, K-filters, estimates and the bound on V2."""

    reference: reshaping.State
    eta: Pair  # η of (35)
    v0: Pair  # v_0 of (29)
    psi: Pair  # ψ_1 of (29)
    theta: Theta  # θ̂
    bound: float  # V²  guaranteed bound on V_2


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
        guarantee.ANEW,
    )


def advance_filter(f: Filter, x: Pair, value: float) -> Pair:
    """Filter state one period later, with its input held at ``value``."""
    return Pair(
        f.a11 * x.first + f.a12 * x.second + f.b1 * value,
        f.a21 * x.first + f.a22 * x.second + f.b2 * value,
    )


def law(
    p: Params,
    theta: Theta,
    bound: float,
    eta: Pair,
    v0: Pair,
    psi: Pair,
    x1: float,
    reference: float,
    rate: float,
    accel: float,
) -> tuple[Terms, Theta, float]:
    """The continuous law for one instant: terms with the voltage before saturation, θ̂'s rate, growth of V2.

    ``bound`` [V²]: of V2, from the sample before; ``eta``, ``v0``, ``psi``: K-filter states;
    ``x1`` [V]: reading; ``reference`` [V], ``rate`` [V/s]
    and ``accel`` [V/s²]: x_vd and its derivatives.
    """
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
    growth = h1 * h1 / (2.0 * p.ks1) + rho * h2 * h2 / (2.0 * p.ks2)
    if p.robust > 0.0:
        growth = p.epsilon1 + p.epsilon2
        u_s2 = -rho * h2 * h2 * z2 / (4.0 * p.epsilon2)  # (50), completing the square
    lyapunov = 0.5 * z1 * z1 + 0.5 * rho * z2 * z2
    terms = Terms(
        reference,
        rate,
        accel,
        x1_dot,
        z1,
        z2,
        lyapunov,
        guarantee.begin(bound, lyapunov),
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
    return terms, theta_rate, growth


def step(
    p: Params, s: State, command: float, measurement: float, offset: float
) -> tuple[float, State, Terms]:
    """One sample: returns voltage [V] within ±u_max, the next state and the terms.

    The K-filters take the voltage after saturation, so that (30) stays true; the estimates rest while
    the amplifier saturates, because (47), from which τ follows, does not hold then.
    """
    accel = reshaping.acceleration(p.reshaping, s.reference, command)
    terms, theta_rate, growth = law(
        p,
        s.theta,
        s.bound,
        s.eta,
        s.v0,
        s.psi,
        measurement,
        s.reference.reference,
        s.reference.rate,
        accel,
    )
    wanted = terms.unsaturated_voltage + offset
    voltage = saturate(wanted, p.u_max)
    theta = s.theta
    if voltage == wanted:
        theta = projection.advance(theta, theta_rate, p.period, p.theta_min, p.theta_max)
    state = State(
        reshaping.advance(p.reshaping, s.reference, accel),
        advance_filter(p.filter, s.eta, measurement),
        advance_filter(p.filter, s.v0, voltage),
        advance_filter(p.filter, s.psi, 1.0),
        theta,
        guarantee.advance(p.guarantee, terms.lyapunov_bound, growth, voltage == terms.unsaturated_voltage),
    )
    return voltage, state, terms


def hold(p: Params, s: State, command: float, measurement: float, voltage: float) -> State:
    """State after a sample at which nothing was read: ``voltage`` [V] held on, the estimates rest.

    ``measurement`` [V]: what the reading may have been, interpolated.
    """
    accel = reshaping.acceleration(p.reshaping, s.reference, command)
    return State(
        reshaping.advance(p.reshaping, s.reference, accel),
        advance_filter(p.filter, s.eta, measurement),
        advance_filter(p.filter, s.v0, voltage),
        advance_filter(p.filter, s.psi, 1.0),
        s.theta,
        guarantee.ANEW,
    )
