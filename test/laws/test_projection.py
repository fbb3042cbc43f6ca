# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from valve_control.control.laws import projection
from valve_control.control.laws.projection import Theta

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
