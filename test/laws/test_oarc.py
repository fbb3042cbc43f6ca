# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""OARC: K-filters, dα1c/dt and V2's derivative against independent derivations; Theorem 2 B."""

import math

import changed
import numpy as np
import pytest
import scipy.linalg
import sympy as sp

from valve_control.control.laws import lyapunov_bound, oarc, reshaping
from valve_control.control.laws.oarc import Pair
from valve_control.control.laws.projection import Theta


def params(**changes):
    return oarc.build(changed.controller(**changes))


def random_point(p, rng):
    k1, k2 = p.k1, p.k2
    return (
        Theta(*rng.uniform(p.theta_min, p.theta_max)),
        Pair(*(rng.normal(size=2) * [3.0 / k2, 3.0 * k1 / k2])),
        Pair(*(rng.normal(size=2) * [5.0 / k2, 5.0 * k1 / k2])),
        Pair(*(rng.normal(size=2) * [1.0 / k2, k1 / k2])),
        *(float(v) for v in rng.normal(size=4) * [3.0, 3.0, 30.0, 500.0]),
    )


def law(p, theta, eta, v0, psi, x1, xd, xd1, xd2):
    """The law at one instant: reading [V], x_vd and its derivatives."""
    state = oarc.State(reshaping.State(xd, xd1), eta, v0, psi, theta, lyapunov_bound.FIRST)
    return oarc.law(p, state, x1, xd2)[:3]


def matrix(p):
    """A0 of (28)."""
    return np.array([[-p.k1, 1.0], [-p.k2, 0.0]])


def held(a, drive, period):
    """Exact transition and input of x' = a·x + drive·u over one period with u held."""
    n = len(a)
    augmented = np.zeros((n + 1, n + 1))
    augmented[:n, :n], augmented[:n, n] = a, drive
    whole = scipy.linalg.expm(augmented * period)
    return whole[:n, :n], whole[:n, n]


def test_the_laws_filters_solve_29():
    """Remark 1: from η alone the law has ξ2, ξ1 and ξ0 of (29), each of them solved on its own here.

    Driven by the voltage that was applied: it saturates at most of these samples.
    """
    p = params(oarc__gamma=[0.0] * 4)
    k = np.array([p.k1, p.k2])
    e1, e2 = np.array([1.0, 0.0]), np.array([0.0, 1.0])
    drives = {"xi2": k, "xi1": e1, "xi0": e2, "v0": e2, "psi": e2}
    exact = {name: held(matrix(p), drive, p.period) for name, drive in drives.items()}
    s = oarc.initial(p, oarc.Start(0.0, 0.0, 0.0, 0.0, 0.0))
    filters = dict.fromkeys(drives, np.zeros(2)) | {"psi": -np.linalg.solve(matrix(p), e2)}
    rng = np.random.default_rng(4)
    for y, offset in rng.normal(size=(300, 2)):
        theta = Theta(*(float(v) for v in rng.uniform(p.theta_min, p.theta_max)))
        voltage, after, terms = oarc.step(p, s._replace(theta=theta), 0.0, float(y), float(offset))
        expected = (
            filters["xi2"][1]
            - theta.a1 * (filters["xi1"][1] + y)
            - theta.a0 * filters["xi0"][1]
            + theta.b0 * filters["v0"][1]
            + theta.b0dn * filters["psi"][1]
        )  # (38)
        assert terms.velocity == pytest.approx(expected, rel=1e-8, abs=1e-8)
        inputs = {"xi2": y, "xi1": y, "xi0": y, "v0": voltage, "psi": 1.0}
        filters = {n: exact[n][0] @ x + exact[n][1] * inputs[n] for n, x in filters.items()}
        s = after


def velocity_error(period, duration=0.04):
    """Error of the law's dx1/dt with true θ on a valve that starts elsewhere, and what (31) says of it."""
    p = params(sample_period=period)
    a1, a0, b0, b0dn = truth = Theta(58.771, 1657.206, 1502.057, 300.0)
    plant = np.array([[-a1, 1.0], [-a0, 0.0]])  # (26)
    transition, drive = held(plant, [0.0, 1.0], period)
    x = np.array([0.8, 40.0])
    s = oarc.initial(p._replace(theta_initial=truth), oarc.Start(0.0, 0.5, 0.0, 0.0, 0.0))
    m = matrix(p)
    estimate = -m @ m @ s.eta - a1 * (m @ s.eta) - a0 * np.array(s.eta) + b0 * np.array(s.v0)
    start = x - (estimate + b0dn * np.array(s.psi))  # (30)
    found, expected = [], []
    for k in range(round(duration / period)):
        y = float(x[0])
        terms = oarc.law(p, s._replace(theta=truth), y, 0.0)[0]
        found.append(float((plant @ x)[0]) - terms.velocity)
        expected.append(float((scipy.linalg.expm(m * k * period) @ start)[1]))
        voltage = 8.0 * math.copysign(1.0, math.sin(900.0 * k * period))
        s = oarc.hold(p, s, 0.0, y, voltage)
        x = transition @ x + drive * (b0 * voltage + b0dn)
    return np.array(found), np.array(expected)


def test_observer_error_decays_as_the_exponential_of_a0():
    """(31): with true θ the error of x is exp(A0·t) times the first, whatever the voltage.

    The law's filters hold the reading over a period, so that this is so but for a rest of order ΔT.
    """
    rests = []
    for period in (1e-4, 5e-5, 2.5e-5):
        found, expected = velocity_error(period)
        rests.append(np.max(np.abs(found - expected)) / np.max(np.abs(expected)))
    assert rests[0] < 0.02
    assert rests[0] / rests[1] == pytest.approx(2.0, rel=0.1)
    assert rests[1] / rests[2] == pytest.approx(2.0, rel=0.1)


def alpha_and_its_rate(p):
    """α1 and (45) as functions of θ̂, η, v0, ψ, signals and dθ̂/dt: term by term, by SymPy from α1 alone."""
    x1, xd, xd1, xd2, p1, p2, n1, n2 = sp.symbols("x1 xd xd1 xd2 p1 p2 n1 n2")
    t1, t2, t3, t4 = sp.symbols("t1:5")
    k1, k2, ks1, b0min = p.k1, p.k2, p.ks1, p.theta_min.b0
    a0m = sp.Matrix([[-k1, 1], [-k2, 0]])
    eta = sp.Matrix([n1, n2])
    xi2, xi1 = -a0m * a0m * eta, a0m * eta
    alpha_a = (-xi2[1] + t1 * (xi1[1] + x1) + t2 * n2 - t4 * p2 + xd1) / t3
    z1 = x1 - xd
    alpha = alpha_a - ks1 * z1 / b0min
    if p.robust:
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
    evaluate = sp.lambdify(symbols, [alpha, total_derivative])

    def evaluated(theta, eta_v, v0, psi, signals, rate):
        return evaluate(*theta, *eta_v, v0.second, *psi, *signals, *rate)

    return evaluated


@pytest.mark.parametrize("robust", ["none", "quadratic"])
def test_alpha_dot_holds_the_projected_rate(robust):
    """(45) with θ̂ on its bounds: dα1/dt has the rate after the projection in it, not Γτ."""
    p = params(oarc__robust_term=robust, oarc__epsilon1=50.0)
    evaluate = alpha_and_its_rate(p)
    rng = np.random.default_rng(9)
    blocked = 0
    for _ in range(200):
        inside, eta, v0, psi, *signals = random_point(p, rng)
        at = rng.integers(-1, 2, size=4)
        theta = Theta(
            *(
                lower if side < 0 else upper if side > 0 else value
                for side, lower, value, upper in zip(at, p.theta_min, inside, p.theta_max, strict=True)
            )
        )
        terms, rate, _ = law(p, theta, eta, v0, psi, *signals)
        free = free_rate(p, theta, eta, v0, psi, signals)
        assert rate == tuple(0.0 if side * v > 0.0 else v for side, v in zip(at, free, strict=True))
        _, expected = evaluate(theta, eta, v0, psi, signals, rate)
        assert math.isclose(terms.virtual_control_rate, expected, rel_tol=1e-7, abs_tol=1e-7)
        _, unprojected = evaluate(theta, eta, v0, psi, signals, free)
        blocked += not math.isclose(expected, unprojected, rel_tol=1e-3, abs_tol=1e-3)
    assert blocked > 50


def free_rate(p, theta, eta, v0, psi, signals):
    """Γτ before the projection: what blocks an estimate at a bound lets it go with Γ turned round."""
    turned = p._replace(gamma=Theta(*(-g for g in p.gamma)))
    _, rate, _ = law(p, theta, eta, v0, psi, *signals)
    _, other, _ = law(turned, theta, eta, v0, psi, *signals)
    return Theta(*(a if a != 0.0 else -b for a, b in zip(rate, other, strict=True)))


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
        terms, rate, _ = law(wide, theta, eta, v0, psi, x1, xd, xd1, xd2)
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
