# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""ARC against SymPy, and both parts of Theorem 1."""

import math

import changed
import numpy as np
import sympy as sp

from valve_control.control.laws import arc, lyapunov_bound, projection, reshaping, velocity
from valve_control.control.laws.projection import Theta


def params(**changes):
    return arc.build(changed.controller(**changes))


def evaluated(p, theta, x1, x2, xd, xd1, xd2):
    """The law at one instant: position [V], velocity [V/s], x_vd and its derivatives."""
    rest = velocity.State(x1, x2)
    return arc.law(p, arc.State(reshaping.State(xd, xd1), rest, theta, lyapunov_bound.ANEW), x1, x2, xd2)


def test_error_dynamics_are_equation_22():
    """Put the law's voltage into the plant (17): what remains must be (22), for any numbers."""
    x1, x2, xd, xd1, xd2 = sp.symbols("x1 x2 xd xd1 xd2")
    th = sp.symbols("th1:5")
    rng = np.random.default_rng(1)
    p = params(arc__robust_term="quadratic", arc__epsilon=1e4)
    for _ in range(50):
        estimate = Theta(*rng.uniform(p.theta_min, p.theta_max))
        truth = rng.uniform(p.theta_min, p.theta_max)
        numbers = rng.normal(size=5) * [3.0, 30.0, 3.0, 30.0, 500.0]
        terms, tau, _ = evaluated(p, estimate, *(float(v) for v in numbers))
        z1 = x1 - xd
        z2 = (x2 - xd1) + p.k1 * z1
        u = terms.unsaturated_voltage
        z2_dot = -th[0] * x2 - th[1] * x1 + th[2] * u + th[3] - (xd2 - p.k1 * (x2 - xd1))  # (19)
        values = dict(zip((x1, x2, xd, xd1, xd2, *th), (*numbers, *truth), strict=True))
        got = float(z2_dot.subs(values))
        phi = np.array([-numbers[1], -numbers[0], terms.model_voltage, 1.0])
        z2_value = float(z2.subs(values))
        expected = (
            -terms.z1
            - truth[2] / p.theta_min.b0 * p.k2 * z2_value
            + truth[2] * terms.robust_voltage
            - (np.array(estimate) - truth) @ phi
        )  # (22)
        assert math.isclose(got, expected, rel_tol=1e-9, abs_tol=1e-6)
        assert np.allclose(tau, phi * z2_value)


def continuous(p, theta_true, duration, period, reference, disturbance, adapt=True):
    """Theorem's own setting: true states, Euler-fine period, plant (17) with disturbance [V/s²]."""
    a1, a0, b0, b0dn = theta_true
    x1 = x2 = 0.0
    theta = p.theta_initial
    history = []
    for k in range(round(duration / period)):
        t = k * period
        xd, xd1, xd2 = reference(t)
        terms, tau, _ = evaluated(p, theta, x1, x2, xd, xd1, xd2)
        history.append((terms.z1, terms.z2, terms.lyapunov))
        accel = -a1 * x2 - a0 * x1 + b0 * terms.unsaturated_voltage + b0dn + disturbance(t)
        x2 += accel * period
        x1 += x2 * period
        if adapt:
            rate = projection.rates(theta, p.gamma, tau, p.theta_min, p.theta_max)
            theta = projection.advance(theta, rate, period, p.theta_min, p.theta_max)
    return np.array(history)


def sine(t, amplitude=1.0, w=2.0 * math.pi * 2.0):
    return (
        amplitude * (1.0 - math.cos(w * t)),
        amplitude * w * math.sin(w * t),
        amplitude * w * w * math.cos(w * t),
    )


def test_theorem_1b_error_vanishes_under_parametric_error_only():
    # Γ below is larger than the paper's only to see the limit within seconds.
    p = params(arc__gamma=[20.0, 1100.0, 1200.0, 5000.0])
    history = continuous(p, (58.771, 1657.206, 1502.057, 300.0), 20.0, 2e-4, sine, lambda t: 0.0)
    early = np.max(np.abs(history[:2500, 0]))
    late = np.max(np.abs(history[-2500:, 0]))
    assert late < 0.03 * early  # the Euler step leaves a floor of order ΔT
    fixed = continuous(p, (58.771, 1657.206, 1502.057, 300.0), 20.0, 2e-4, sine, lambda t: 0.0, adapt=False)
    assert np.max(np.abs(fixed[-2500:, 0])) > 20.0 * late
