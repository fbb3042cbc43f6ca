# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from changed import controller
from hypothesis import given
from hypothesis import strategies as st

from valve_control.control.laws import command_lead, reshaping

PERIOD = 0.001
TIME = np.arange(2000) * PERIOD


def led(commands, **changes):
    return command_lead.applied(
        command_lead.build(controller(**changes), True), np.array(commands, dtype=float)
    )


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
