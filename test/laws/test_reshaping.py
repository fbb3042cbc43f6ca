# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The reshaped reference, and the lead of the command before it."""

import math

import numpy as np
import pytest
from changed import controller
from hypothesis import given, settings
from hypothesis import strategies as st

from valve_control.control.laws import command_lead, reshaping
from valve_control.control.parameters.table import CONTROLLER
from valve_control.parameter import defaults, updated

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


def braking(period, **changes):
    """Parameters of the braking form, or another, from changes of the defaults."""
    named = {f"reshaping.{name}": value for name, value in {"form": "braking", **changes}.items()}
    own = {"sample_period": period, **named}
    return reshaping.build(updated(CONTROLLER, defaults(CONTROLLER), own))


@given(
    logarithms=st.tuples(
        st.floats(-4.0, -1.7),
        st.floats(0.0, 5.0),
        st.floats(-1.0, 1.0),
        st.floats(-1.0, 5.0),
        st.floats(0.0, 7.0),
    ),
    steps=st.lists(st.floats(-10.0, 10.0), min_size=1, max_size=3),
)
@settings(max_examples=60, deadline=None)
def test_the_braking_form_never_overshoots_a_step_and_keeps_its_limits(logarithms, steps):
    """Whatever frequency, damping, limits and sample period; each step begins at rest."""
    period, frequency, damping, rate, accel = (10.0**x for x in logarithms)
    p = braking(period, natural_frequency=frequency, damping=damping, max_rate=rate, max_accel=accel)
    at = 0.0
    for wanted in steps:
        s, way = reshaping.State(at, 0.0), math.copysign(1.0, wanted - at)
        for _ in range(400):
            change = reshaping.acceleration(p, s, wanted)
            s = reshaping.advance(p, s, change)
            assert abs(change) <= p.max_accel * (1.0 + 1e-9)
            assert abs(s.rate) <= p.max_rate * (1.0 + 1e-9)
            assert (s.reference - wanted) * way <= 1e-12
        at = s.reference


@pytest.mark.parametrize("form", ["paper", "braking"])
@given(rate=st.floats(5.0, 200.0), accel=st.floats(-11000.0, 11000.0), frequency=st.floats(100.0, 900.0))
def test_a_command_that_is_known_ahead_gives_its_own_acceleration(form, rate, accel, frequency):
    """`command_of` and `steady_command` invert both forms of (8)."""
    p = braking(PERIOD, form=form, natural_frequency=frequency)
    for sign in (1.0, -1.0):
        v, a = sign * rate, sign * accel
        euler = reshaping.State(0.3, v + 0.5 * PERIOD * a)
        command = reshaping.command_of(p, 0.3, v, a)
        assert math.isclose(reshaping.acceleration(p, euler, command), a, rel_tol=1e-6, abs_tol=1e-3)
        steady = reshaping.steady_command(p, 0.3, v)
        assert abs(reshaping.acceleration(p, reshaping.State(0.3, v), steady)) < 1e-3


PERIOD = 0.001
TIME = np.arange(2000) * PERIOD


def led(commands, **changes):
    """Commands with their lead, which are the same to the bit compiled and in plain Python."""
    p, commands = command_lead.build(controller(**changes), True), np.array(commands, dtype=float)
    made, plain = command_lead.applied(p, commands), np.empty_like(commands)
    command_lead.fill(p, commands, plain)
    assert np.array_equal(made, plain)
    return made


def reference(commands, values=None):
    """x_vd under these commands."""
    p = reshaping.build(values or controller())
    s = reshaping.State(float(commands[0]), 0.0)
    got = []
    for command in commands:
        got.append(s.reference)
        s = reshaping.advance(p, s, reshaping.acceleration(p, s, float(command)))
    return np.array(got)


PARABOLA = 200.0 * TIME[:180] ** 2  # V  below all limits


@pytest.mark.parametrize(
    "natural_frequency, damping", [(314.0, 0.8), (800.0, 0.8), (1000.0, 1.0), (500.0, 1.27)]
)
@pytest.mark.parametrize("ahead", [0.0, 0.002, 0.005])
def test_with_the_acceleration_a_parabola_is_followed_without_error(natural_frequency, damping, ahead):
    """The reference is the command that comes ``ahead``, which makes up for a loop that is later by that."""
    changes = {"reshaping__natural_frequency": natural_frequency, "reshaping__damping": damping}
    lead = 2.0 * damping / natural_frequency + ahead
    wanted = 200.0 * (TIME[120:180] + ahead) ** 2
    for share, left in ((1.0, 0.0), (0.0, None)):
        given = led(PARABOLA, reshaping__lead=lead, reshaping__lead_accel=share, **changes)
        error = reference(given, controller(**changes))[120:180] - wanted
        if left is None:
            bend = command_lead.build(
                controller(reshaping__lead=lead, reshaping__lead_accel=1.0, **changes), True
            )
            left = -400.0 * (bend.bend + 0.0015 * lead)
        assert error == pytest.approx(left, abs=1e-9)


@given(
    st.floats(-10.0, 10.0),
    st.floats(-10.0, 10.0),
    st.floats(0.001, 0.1),
    st.integers(1, 30),
    st.integers(0, 9),
    st.floats(0.0, 1.0),
)
def test_a_step_is_no_motion(before, after, lead, wait, late, share):
    """So it overshoots not at all, whatever its height."""
    command = [before] * wait + [after] * (20 + late)
    assert np.array_equal(led(command, reshaping__lead=lead, reshaping__lead_accel=share), command)


@given(st.lists(st.floats(-10.0, 10.0), min_size=1, max_size=200), st.floats(0.001, 0.1), st.floats(0.0, 1.0))
def test_whatever_comes_the_lead_stays_within_the_limits(commands, lead, share):
    p = command_lead.build(controller(reshaping__lead=lead, reshaping__lead_accel=share), True)
    s = command_lead.initial(commands[0])
    for command in commands:
        before, s = s.rate, command_lead.step(p, s, command)
        assert abs(s.rate) <= 250.0  # (7)
        assert abs(s.rate) <= abs(before) + 12.0 * (1.0 + 1e-9)  # (6)
        assert abs(s.accel) <= 12000.0 * (1.0 + 1e-9)  # (6)
        assert abs(command_lead.led(p, s, command)) <= 10.0
