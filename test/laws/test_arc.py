# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""ARC against its error dynamics, both parts of Theorem 1, and the projection (P1)."""

import math

import changed
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

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
    rng = np.random.default_rng(1)
    p = params(arc__robust_term="quadratic", arc__epsilon=1e4)
    for _ in range(50):
        estimate = Theta(*rng.uniform(p.theta_min, p.theta_max))
        truth = rng.uniform(p.theta_min, p.theta_max)
        x1, x2, xd, xd1, xd2 = (float(v) for v in rng.normal(size=5) * [3.0, 30.0, 3.0, 30.0, 500.0])
        terms, tau, _ = evaluated(p, estimate, x1, x2, xd, xd1, xd2)
        z2 = (x2 - xd1) + p.k1 * (x1 - xd)
        acceleration = truth @ [-x2, -x1, terms.unsaturated_voltage, 1.0]
        got = acceleration - (xd2 - p.k1 * (x2 - xd1))  # (19)
        phi = np.array([-x2, -x1, terms.model_voltage, 1.0])
        expected = (
            -terms.z1
            - truth[2] / p.theta_min.b0 * p.k2 * z2
            + truth[2] * terms.robust_voltage
            - (np.array(estimate) - truth) @ phi
        )  # (22)
        assert math.isclose(got, expected, rel_tol=1e-9, abs_tol=1e-6)
        assert np.allclose(tau, phi * z2)


LOWER = Theta(5.0, 500.0, 900.0, -6000.0)
UPPER = Theta(150.0, 3000.0, 2500.0, 6000.0)
share = st.floats(0.0, 1.0) | st.sampled_from([0.0, 1.0])
shares = st.tuples(share, share, share, share)
four = st.tuples(*[st.floats(-1e6, 1e6)] * 4)
positive = st.tuples(*[st.floats(0.01, 1e4)] * 4)


def inside(fractions):
    # written so that fractions 0 and 1 give the bounds themselves
    return Theta(
        *(
            high if f == 1.0 else min(high, low + f * (high - low))
            for f, low, high in zip(fractions, LOWER, UPPER, strict=True)
        )
    )


@given(shares, four, positive, st.floats(1e-6, 1.0))
def test_p1_estimates_stay_in_their_bounds(fractions, tau, gamma, period):
    theta = inside(fractions)
    rate = projection.rates(theta, Theta(*gamma), Theta(*tau), LOWER, UPPER)
    after = projection.advance(theta, rate, period, LOWER, UPPER)
    assert all(lo <= v <= hi for lo, v, hi in zip(LOWER, after, UPPER, strict=True))


@given(four, shares, shares)
def test_uncertainty_bounds_the_parametric_error_and_is_no_larger_than_the_norms(phi, estimate, truth):
    span = np.array(UPPER) - np.array(LOWER)
    h = projection.uncertainty(Theta(*span), Theta(*phi), 0.0)
    error = np.array(inside(estimate)) - np.array(inside(truth))
    assert abs(error @ np.array(phi)) <= h * (1.0 + 1e-9) + 1e-9
    assert h <= np.linalg.norm(span) * np.linalg.norm(phi) * (1.0 + 1e-9) + 1e-100
