import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from valve_control.laws import reshaping
from valve_control.parameter import defaults, updated
from valve_control.parameters.table import CONTROLLER

PERIOD = 0.001


@given(
    st.lists(st.floats(-10.0, 10.0), min_size=1, max_size=300),
    st.floats(1.0, 300.0),
    st.floats(10.0, 20000.0),
)
def test_rate_and_acceleration_stay_within_their_limits(commands, max_rate, max_accel):
    p = reshaping.Params(314.0, 0.8, max_rate, max_accel, PERIOD)
    s = reshaping.State(0.0, 0.0)
    for command in commands:
        accel = reshaping.acceleration(p, s, command)
        s = reshaping.advance(p, s, accel)
        assert abs(accel) <= max_accel * (1.0 + 1e-9)
        assert abs(s.rate) <= max_rate * (1.0 + 1e-9)


def test_small_step_follows_the_analytic_response_of_the_second_order_filter():
    period, wn, damping = 1e-5, 314.0, 0.8
    p = reshaping.Params(wn, damping, 1e9, 1e9, period)
    s = reshaping.State(0.0, 0.0)
    got = []
    for _ in range(3000):
        got.append(s.reference)
        s = reshaping.advance(p, s, reshaping.acceleration(p, s, 1.0))
    t = np.arange(3000) * period
    wd = wn * math.sqrt(1.0 - damping**2)
    exact = 1.0 - np.exp(-damping * wn * t) * (np.cos(wd * t) + damping * wn / wd * np.sin(wd * t))
    assert np.max(np.abs(np.array(got) - exact)) < 3.0 * wn * period


def test_ramp_lags_by_two_damping_over_frequency():
    p = reshaping.Params(314.0, 0.8, 1e9, 1e9, PERIOD)
    s = reshaping.State(0.0, 0.0)
    for k in range(500):
        s = reshaping.advance(p, s, reshaping.acceleration(p, s, k * PERIOD))
    assert math.isclose(500 * PERIOD - s.reference, 2.0 * 0.8 / 314.0, rel_tol=1e-6)


def last_outside(natural_frequency, damping, height, seconds=3.0):
    """Time [s] from which on the reference stays within 2 % of a step of ``height`` [V] at 1 kHz."""
    p = reshaping.Params(natural_frequency, damping, 250.0, 12000.0, 0.001)
    state, last = reshaping.State(0.0, 0.0), 0
    for k in range(round(seconds * 1000)):
        state = reshaping.advance(p, state, reshaping.acceleration(p, state, height))
        if abs(state.reference - height) > 0.02 * height:
            last = k
    return 0.001 * last


@given(damping=st.floats(0.4, 1.1), height=st.floats(0.05, 10.0))
@settings(max_examples=40)
def test_what_a_tuner_may_choose_comes_to_rest_at_the_limit_of_the_acceleration(damping, height):
    """A lead 2·ξ_n/ω_n of two periods: within half a second; of less than a period and a third: never."""
    values = updated(CONTROLLER, defaults(CONTROLLER), {"reshaping.damping": damping})
    highest = reshaping.frequency(values).high
    assert 2.0 * damping / highest >= 0.002 - 1e-9
    assert last_outside(highest, damping, height) < 0.5


def test_a_lead_of_one_and_a_third_periods_swings_for_ever():
    assert last_outside(1200.0, 0.8, 0.3) > 2.99
    assert last_outside(800.0, 0.8, 0.3) < 0.05
