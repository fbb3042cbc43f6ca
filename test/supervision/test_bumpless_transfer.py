# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The offsets of a takeover die out as a critically damped system does, whatever the sample period."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from valve_control.control.supervision import bumpless_transfer
from valve_control.control.supervision.bumpless_transfer import NOTHING, ZERO, Offset, State


@given(st.floats(0.001, 10.0), st.floats(1e-4, 1e-2), st.floats(-10.0, 10.0), st.floats(-100.0, 100.0))
def test_the_decay_is_that_of_the_differential_equation(tau, period, value, rate):
    p = bumpless_transfer.design(tau, period)
    s = State(Offset(value, rate), ZERO, False)
    for k in range(1, 50):
        s = bumpless_transfer.step(p, s)
        t = k * period
        exact = (value + (rate + value / tau) * t) * math.exp(-t / tau)
        assert s.voltage.value == pytest.approx(exact, rel=1e-9, abs=3e-9 * (1.0 + abs(value)))
    assert s.command is ZERO


def test_at_rest_nothing_changes():
    assert bumpless_transfer.step(bumpless_transfer.design(0.05, 0.001), NOTHING) == NOTHING
