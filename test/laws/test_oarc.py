"""OARC: K-filters, dα1c/dt and V2's derivative against independent derivations; Theorem 2 B."""

import math

import numpy as np
import pytest
import scipy.linalg
import sympy as sp

from valve_control.laws import guarantee, oarc, projection
from valve_control.laws.oarc import Pair
from valve_control.laws.projection import Theta
from valve_control.parameters import build
from valve_control.parameters.table import CONTROLLER, defaults, updated


def params(**changes):
    values = updated(CONTROLLER, defaults(CONTROLLER), {k.replace("__", "."): v for k, v in changes.items()})
    return build.oarc_params(values)


def random_point(p, rng):
    k1, k2 = p.k1, p.k2
    return (
        Theta(*rng.uniform(p.theta_min, p.theta_max)),
        Pair(*(rng.normal(size=2) * [3.0 / k2, 3.0 * k1 / k2])),
        Pair(*(rng.normal(size=2) * [5.0 / k2, 5.0 * k1 / k2])),
        Pair(*(rng.normal(size=2) * [1.0 / k2, k1 / k2])),
        *(float(v) for v in rng.normal(size=4) * [3.0, 3.0, 30.0, 500.0]),
    )


def test_filters_of_remark_1_solve_29():
    """ξ2 = -A0²η, ξ1 = A0η, ξ0 = η obey (29), symbolically."""
    k1, k2, y = sp.symbols("k1 k2 y")
    a0 = sp.Matrix([[-k1, 1], [-k2, 0]])
    eta = sp.Matrix(sp.symbols("eta1:3"))
    e1, e2 = sp.Matrix([1, 0]), sp.Matrix([0, 1])
    eta_dot = a0 * eta + e2 * y
    for xi, drive in ((-a0 * a0, sp.Matrix([k1, k2])), (a0, e1), (sp.eye(2), e2)):
        assert sp.simplify(xi * eta_dot - (a0 * xi * eta + drive * y)) == sp.zeros(2, 1)


def test_observer_error_decays_as_the_exponential_of_a0():
    """(31): with true θ and no disturbance, x - x̂ = exp(A0·t)·(x(0) - x̂(0)), whatever the voltage."""
    p = params()
    a1, a0_, b0, b0dn = 58.771, 1657.206, 1502.057, 300.0
    a0m = np.array([[-p.k1, 1.0], [-p.k2, 0.0]])
    rng = np.random.default_rng(3)
    # one linear system: plant x of (26), then η, v0, ψ; a piecewise constant voltage drives it exactly
    big = np.zeros((8, 8))
    big[:2, :2] = [[-a1, 1.0], [-a0_, 0.0]]
    for i in (2, 4, 6):
        big[i : i + 2, i : i + 2] = a0m
    big[3, 0] = 1.0
    drive = np.zeros((8, 2))  # voltage, constant 1
    drive[1] = [b0, b0dn]
    drive[5, 0] = 1.0
    drive[7, 1] = 1.0
    augmented = np.zeros((10, 10))
    augmented[:8, :8], augmented[:8, 8:] = big, drive
    h = 0.001
    m = scipy.linalg.expm(augmented * h)
    state = rng.normal(size=8) * [1.0, 30.0, *([1e-4, 1e-2] * 3)]

    def error(s):
        eta, v0, psi = s[2:4], s[4:6], s[6:8]
        estimate = -a0m @ a0m @ eta - a1 * (a0m @ eta) - a0_ * eta + b0 * v0 + b0dn * psi  # (30)
        return s[:2] - estimate

    start = error(state)
    for k in range(1, 40):
        state = m[:8, :8] @ state + m[:8, 8:] @ np.array([rng.uniform(-10, 10), 1.0])
        expected = scipy.linalg.expm(a0m * (k * h)) @ start
        assert np.allclose(error(state), expected, rtol=1e-6, atol=1e-9 * np.linalg.norm(start))


def test_discrete_filter_is_exact():
    p = params()
    a0m = np.array([[-p.k1, 1.0], [-p.k2, 0.0]])
    x, u, h = np.array([0.3, -0.7]), 2.5, p.period
    exact = scipy.linalg.expm(a0m * h) @ (x + np.linalg.solve(a0m, [0.0, u])) - np.linalg.solve(a0m, [0.0, u])
    assert np.allclose(oarc.advance_filter(p.filter, Pair(*x), u), exact, rtol=1e-10)


@pytest.mark.parametrize("robust", ["none", "quadratic"])
def test_alpha_dot_is_the_sympy_total_derivative(robust):
    """(45) term by term as partial derivatives, by SymPy from α1 alone."""
    p = params(oarc__robust_term=robust, oarc__epsilon1=50.0)
    x1, xd, xd1, xd2, p1, p2, n1, n2 = sp.symbols("x1 xd xd1 xd2 p1 p2 n1 n2")
    t1, t2, t3, t4 = sp.symbols("t1:5")
    k1, k2, ks1, b0min = p.k1, p.k2, p.ks1, p.theta_min.b0
    a0m = sp.Matrix([[-k1, 1], [-k2, 0]])
    eta = sp.Matrix([n1, n2])
    xi2, xi1 = -a0m * a0m * eta, a0m * eta
    alpha_a = (-xi2[1] + t1 * (xi1[1] + x1) + t2 * n2 - t4 * p2 + xd1) / t3
    z1 = x1 - xd
    alpha = alpha_a - ks1 * z1 / b0min
    if robust == "quadratic":
        span = [hi - lo for lo, hi in zip(p.theta_min, p.theta_max, strict=True)]
        phi1 = [-(xi1[1] + x1), -n2, alpha_a, p2]
        total = sum((w * f) ** 2 for w, f in zip(span, phi1, strict=True)) + p.disturbance_bound**2
        alpha -= 5 * total * z1 / (4 * p.epsilon1 * b0min)
    v02, r1, r2, r3, r4 = sp.symbols("v02 r1:5")
    x1_dot = xi2[1] - t1 * (xi1[1] + x1) - t2 * n2 + t3 * v02 + t4 * p2
    eta_dot = a0m * eta + sp.Matrix([0, x1])
    partials = [
        (x1, x1_dot),
        (n1, eta_dot[0]),
        (n2, eta_dot[1]),
        (p2, -k2 * p1 + 1),
        (t1, r1),
        (t2, r2),
        (t3, r3),
        (t4, r4),
        (xd, xd1),
        (xd1, xd2),
    ]
    total_derivative = sum(sp.diff(alpha, v) * rate for v, rate in partials)
    symbols = (t1, t2, t3, t4, n1, n2, v02, p1, p2, x1, xd, xd1, xd2, r1, r2, r3, r4)
    evaluate = sp.lambdify(symbols, [alpha, sp.diff(alpha, x1), total_derivative])
    rng = np.random.default_rng(5)
    for _ in range(100):
        theta, eta_v, v0, psi, *signals = random_point(p, rng)
        terms, rate, _ = oarc.law(p, theta, guarantee.ANEW, eta_v, v0, psi, *signals)
        expected = evaluate(*theta, *eta_v, v0.second, *psi, *signals, *rate)
        assert math.isclose(terms.virtual_control, expected[0], rel_tol=1e-9)
        assert math.isclose(terms.virtual_control_rate, expected[2], rel_tol=1e-7, abs_tol=1e-7)


@pytest.mark.parametrize("rho", [1.0, 1.44e6])
def test_parametric_error_enters_v2_dot_only_through_tau(rho):
    """(49) with the corrected φ2 and any weight: dV2/dt + θ̃ᵀτ is free of θ̃ (it is -ks1.. -ρ·ks2·z2²)."""
    p = params(oarc__z2_weight=rho)
    p = p._replace(gamma=Theta(1.0, 1.0, 1.0, 1.0))
    wide = p._replace(theta_min=p.theta_min._replace(a1=-1e9, a0=-1e9, b0dn=-1e12))
    rng = np.random.default_rng(7)
    for _ in range(100):
        theta, eta, v0, psi, x1, xd, xd1, xd2 = random_point(p, rng)
        truth = np.array(rng.uniform(p.theta_min, p.theta_max))
        terms, rate, _ = oarc.law(wide, theta, guarantee.ANEW, eta, v0, psi, x1, xd, xd1, xd2)
        k1, k2 = p.k1, p.k2
        xi22 = -k1 * k2 * eta.first + k2 * eta.second
        xi12, xi02 = -k2 * eta.first, eta.second
        regressor = np.array([-(xi12 + x1), -xi02, v0.second, psi.second])
        z1_dot = xi22 + truth @ regressor - xd1  # (38) without ε
        slope = theta.a1 / theta.b0 - p.ks1 / p.theta_min.b0
        # dα1/dt of (44): calculable part plus ∂α1/∂x1·(true minus calculable dx1/dt)
        alpha_dot = terms.virtual_control_rate + slope * ((truth - np.array(theta)) @ regressor)
        z2_dot = terms.unsaturated_voltage - k2 * v0.first - alpha_dot  # (46)
        v2_dot = terms.z1 * z1_dot + rho * terms.z2 * z2_dot
        stable = -truth[2] / p.theta_min.b0 * p.ks1 * terms.z1**2 - rho * p.ks2 * terms.z2**2
        tau = np.array(rate)  # Γ = 1 and bounds wide enough that nothing is projected but b0
        inside = p.theta_min.b0 < theta.b0 < p.theta_max.b0
        assert inside
        error = np.array(theta) - truth
        scale = abs(v2_dot) + abs(stable) + np.sum(np.abs(error * tau))
        assert abs(v2_dot - (stable - error @ tau)) < 1e-8 * scale


def error_by_second(simulate, period, **changes):
    t = np.arange(round(40.0 / period)) * period
    run = simulate(
        "oarc",
        1.0 - np.cos(4.0 * math.pi * t),
        period,
        valve={"valve": "second_order", "disturbance.offset": 0.2, "u_max": 100.0},
        u_max=100.0,
        **changes,
    )
    return np.abs(run.terms["z1"]).reshape(40, -1).max(axis=1)


def test_theorem_2b_error_vanishes_as_far_as_sampling_allows(simulate):
    """Parametric error only: what is left in the end is of order ΔT, so that it vanishes with ΔT."""
    coarse = error_by_second(simulate, 1e-4)
    fine = error_by_second(simulate, 2e-5)
    assert coarse[-1] < 0.2 * coarse[0]
    assert fine[-1] < 0.04 * fine[0]
    assert 4.0 < coarse[-1] / fine[-1] < 6.0


def test_theorem_2b_with_the_papers_weight(simulate):
    """With ρ = 1 τ is tiny; Γ has to be 1e5 times the paper's to see the limit within 40 s."""
    gamma = [2e5, 2e7, 2e7, 5e8]
    errors = error_by_second(simulate, 1e-4, oarc__z2_weight=1.0, oarc__gamma=gamma)
    assert errors[-1] < 0.03 * errors[0]
    frozen = error_by_second(simulate, 1e-4, oarc__z2_weight=1.0, oarc__gamma=[0.0] * 4)
    assert frozen[-1] > 0.9 * frozen[0]


def test_start_is_a_steady_state():
    """At the voltage that holds the spool, with true θ, nothing moves at the first sample."""
    p = params(oarc__theta_initial=[58.771, 1657.206, 1502.057, 0.0])
    y = 1.5
    u = 1657.206 / 1502.057 * y
    s = oarc.initial(p, oarc.Start(y, u, y, 0.0, 0.0))
    voltage, after, terms = oarc.step(p, s, y, y, 0.0)
    assert math.isclose(voltage, u, rel_tol=1e-9)
    assert abs(terms.z2) < 1e-12 and abs(terms.velocity) < 1e-9
    assert np.allclose(after.eta, s.eta) and np.allclose(after.v0, s.v0)


def test_start_in_motion_knows_its_velocity():
    """A ramp with true θ: the estimate of dx1/dt is the spool's velocity, and stays it."""
    p = params(oarc__theta_initial=[58.771, 1657.206, 1502.057, 0.0])
    y, v = 0.7, 12.0
    u = (58.771 * v + 1657.206 * y) / 1502.057
    s = oarc.initial(p, oarc.Start(y, u, y, v, v))
    terms, _, _ = oarc.law(p, s.theta, guarantee.ANEW, s.eta, s.v0, s.psi, y, y, v, 0.0)
    assert math.isclose(terms.velocity, v, rel_tol=1e-9)
    assert math.isclose(terms.unsaturated_voltage, u, rel_tol=1e-9)


def test_projected_rate_is_used_in_alpha_dot():
    p = params()
    rng = np.random.default_rng(9)
    theta, eta, v0, psi, *signals = random_point(p, rng)
    theta = theta._replace(a1=p.theta_max.a1, a0=p.theta_min.a0)
    _, rate, _ = oarc.law(p, theta, guarantee.ANEW, eta, v0, psi, *signals)
    assert rate.a1 <= 0.0 and rate.a0 >= 0.0
    assert projection.projected_rate(theta.a1, 1.0, p.theta_min.a1, p.theta_max.a1) == 0.0
