# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Places of sliders, and the form's text of a value."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from valve_control.control.parameters.ros_file import from_text
from valve_control.control.parameters.table import CONTROLLER
from valve_control.dashboard.form import shown
from valve_control.dashboard.slider import STEPS, scale
from valve_control.parameter import Parameter

GAIN = Parameter("k", 1.0, "", "", 0.001, 1e5)
FROM_ZERO = Parameter("ki", 1.0, "", "", 0.0, 1e9)
NARROW = Parameter("share", 0.0, "", "", -1.0, 1.0)


@pytest.mark.parametrize("parameter", CONTROLLER, ids=lambda p: p.name)
def test_what_is_shown_is_read_as_the_same_value(parameter):
    assert from_text(parameter, shown(parameter.default)) == parameter.default


@given(place=st.integers(0, STEPS))
@pytest.mark.parametrize("parameter", [GAIN, FROM_ZERO, NARROW], ids=lambda p: p.name)
def test_a_slider_stays_where_it_is_put(parameter, place):
    s = scale(parameter)
    assert parameter.low <= s.value(place) <= parameter.high
    assert s.place(s.value(place)) == place


@pytest.mark.parametrize("high", [99, 999])
def test_a_slider_of_whole_numbers_gives_the_number_at_which_it_stands(high):
    s = scale(Parameter("n", 1, "", "", 0, high))
    found = [s.value(s.place(n)) for n in range(100)]
    assert found == list(range(100)) and all(isinstance(n, int) for n in found)


def test_ranges_over_decades_are_logarithmic_and_reach_both_ends():
    assert scale(GAIN).value(500) == pytest.approx(math.sqrt(0.001 * 1e5), rel=1e-3)
    for parameter in (GAIN, FROM_ZERO, NARROW):
        s = scale(parameter)
        assert (s.value(0), s.value(STEPS)) == (parameter.low, parameter.high)
    assert 0.0 < scale(FROM_ZERO).value(1) < 2.0 and scale(NARROW).value(500) == 0.0
    assert scale(Parameter("n", 1, "", "", 0, 100_000)).value(1) < 1.1  # not thousands at once
    assert scale(Parameter("x", 1.0, "", "")) is None and scale(Parameter("s", "a", "", "")) is None
