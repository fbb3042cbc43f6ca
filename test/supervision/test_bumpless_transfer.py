# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The offsets of a takeover die out as a critically damped system does, whatever the sample period."""

import math
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from valve_control.control.laws import reshaping
from valve_control.control.supervision import bumpless_transfer
from valve_control.control.supervision.bumpless_transfer import ZERO, Offset, State


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


def test_a_reference_behind_a_filter_goes_on_with_the_rate_of_the_filter():
    p = SimpleNamespace(reshaping=SimpleNamespace(smoothing=200.0))
    s = SimpleNamespace(reference=reshaping.State(1.5, 40.0), smooth=1.25)
    assert bumpless_transfer.followed(p, s) == reshaping.State(1.25, 50.0)
