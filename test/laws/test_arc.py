# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""ARC against SymPy, and both parts of Theorem 1."""

import math

import changed
import numpy as np
import sympy as sp

from valve_control.control.laws import arc, lyapunov_bound, reshaping, velocity
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
