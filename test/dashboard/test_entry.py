# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What people type, and places of sliders."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from valve_control.control.parameters.table import CONTROLLER
from valve_control.dashboard.entry import STEPS, EntryError, Field, number, parse, scale, shown, slid

GAIN = Field("k", "double", low=0.001, high=1e5)
FROM_ZERO = Field("ki", "double", low=0.0, high=1e9)
NARROW = Field("share", "double", low=-1.0, high=1.0)
COUNT = Field("n", "integer", low=0.0, high=100000.0)


@pytest.mark.parametrize(
    ("text", "value"),
    [("1.5", 1.5), ("1,5", 1.5), (" -,5 ", -0.5), ("\N{MINUS SIGN}3", -3.0), ("1e3", 1000.0),
     ("2,5E-3", 0.0025), ("+7.", 7.0)],
)  # fmt: skip
def test_numbers_with_point_or_comma(text, value):
    assert number(text) == value


@pytest.mark.parametrize(
    ("text", "words"),
    [("", "missing"), ("abc", "'abc' is no number"), ("1,234.5", "without separators"),
     ("1.2.3", "without separators"), ("nan", "no number"), ("inf", "no number"),
     ("1 000", "without separators"), ("0x10", "no number")],
)  # fmt: skip
def test_what_is_no_number_is_refused_with_a_reason(text, words):
    with pytest.raises(EntryError, match=words):
        number(text)


def test_values_of_each_kind():
    assert parse(COUNT, "12") == 12 and isinstance(parse(COUNT, "12"), int)
    assert parse(Field("b", "bool"), "True") is True
    assert parse(Field("t", "doubles"), "1,5; 2; 3") == [1.5, 2.0, 3.0]
    assert parse(Field("t", "doubles"), "[1.5 2 3]") == [1.5, 2.0, 3.0]
    assert parse(Field("t", "doubles"), "[2.0, 110.0, 5]") == [2.0, 110.0, 5.0]  # as in a parameter file
    assert parse(Field("t", "doubles"), "[2.0,110.0]") == [2.0, 110.0]
    assert parse(Field("s", "strings"), "a, b") == ["a", "b"]
    for field, text, words in [
        (COUNT, "1,5", "no whole number"), (GAIN, "0", "out of range: 0.001 to 100000"),
        (Field("b", "bool"), "ja", "neither"),
    ]:  # fmt: skip
        with pytest.raises(EntryError, match=words):
            parse(field, text)


@pytest.mark.parametrize("parameter", CONTROLLER, ids=lambda p: p.name)
def test_what_is_shown_is_read_as_the_same_value(parameter):
    kind = {"list of doubles": "doubles", "list of strings": "strings"}.get(
        parameter.type_name, parameter.type_name
    )
    assert parse(Field(parameter.name, kind), shown(parameter.default)) == parameter.default


@given(place=st.integers(0, STEPS))
@pytest.mark.parametrize("field", [GAIN, FROM_ZERO, NARROW], ids=lambda f: f.name)
def test_a_slider_stays_where_it_is_put(field, place):
    s = scale(field)
    assert field.low <= s.value(place) <= field.high
    assert s.place(s.value(place)) == place


@pytest.mark.parametrize("high", [99, 999])
def test_a_slider_of_whole_numbers_gives_the_number_at_which_it_stands(high):
    field = Field("n", "integer", low=0, high=high)
    s = scale(field)
    assert [slid(field, s, s.place(n)) for n in range(100)] == list(range(100))


def test_ranges_over_decades_are_logarithmic_and_reach_both_ends():
    gain, zero, narrow = scale(GAIN), scale(FROM_ZERO), scale(NARROW)
    assert gain.logarithmic and zero.logarithmic and not narrow.logarithmic
    assert gain.value(500) == pytest.approx(math.sqrt(0.001 * 1e5), rel=1e-3)
    for s, field in ((gain, GAIN), (zero, FROM_ZERO), (narrow, NARROW)):
        assert (s.value(0), s.value(STEPS)) == (field.low, field.high)
    assert zero.value(1) > 0.0
    assert scale(Field("x", "double")) is None and scale(Field("s", "string")) is None
    assert scale(COUNT).value(1) < 1.1  # not thousands at once


@pytest.mark.parametrize("kind", ["integer", "double", "doubles"])
def test_a_number_beyond_all_bounds_is_refused(kind):
    """It became infinity, which is no whole number: the page raised."""
    with pytest.raises(EntryError, match="too large"):
        parse(Field("x", kind), "1e999")
