# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Scales: words at the ends of their ranges, formulas, both directions."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from valve_control.control.drivers.scaling import Scale, ScaleError, parse

numbers = st.floats(-1e6, 1e6, allow_subnormal=False)
factors = st.floats(1e-3, 1e3).flatmap(lambda f: st.sampled_from([f, -f]))


@pytest.mark.parametrize(
    ("word", "low", "centre", "high"),
    [("V", -10.0, 0.0, 10.0), ("-10..10V", -10.0, 0.0, 10.0), ("%", -100.0, 0.0, 100.0),
     ("0..10V", 0.0, 5.0, 10.0), ("4..20mA", 4.0, 12.0, 20.0)],
)  # fmt: skip
def test_words_make_their_whole_range_ten_volts_to_each_side(word, low, centre, high):
    scale = parse(word)
    assert [scale.volts(signal) for signal in (low, centre, high)] == [-10.0, 0.0, 10.0]
    assert [scale.signal(volts) for volts in (-10.0, 0.0, 10.0)] == [low, centre, high]
    assert scale.live_zero == (3.6 if word == "4..20mA" else -math.inf)


@pytest.mark.parametrize(
    ("text", "scale"),
    [("*250", Scale(250.0)), ("*1.25-15", Scale(1.25, -15.0)), (" * -2e-1 + .5 ", Scale(-0.2, 0.5)),
     ("*1e-3-1e+2", Scale(0.001, -100.0))],
)  # fmt: skip
def test_formulas_are_read(text, scale):
    assert parse(text) == scale


@pytest.mark.parametrize(
    "text", ["", "mA", "*", "*0", "*0.0+1", "*1e999", "*1+-1", "*nan", "2", "*2 3", "*1-1-1"]
)
def test_what_is_no_scale_is_refused_with_the_words(text):
    with pytest.raises(ScaleError, match=r"4\.\.20mA.*\*factor±offset"):
        parse(text)


@given(factors, numbers, numbers)
def test_signal_and_volts_are_inverse_and_polarity_mirrors(factor, offset, volts):
    scale = Scale(factor, offset)
    assert scale.volts(scale.signal(volts)) == pytest.approx(volts, rel=1e-9, abs=1e-9 * (1.0 + abs(offset)))
    signal = scale.signal(volts)
    assert scale.reversed().volts(signal) == -scale.volts(signal)


@given(factors.map(lambda f: float(f"{f:g}")), numbers.map(lambda f: float(f"{f:g}")))
def test_a_scale_is_written_as_it_is_read(factor, offset):
    assert parse(str(Scale(factor, offset))) == Scale(factor, offset)
