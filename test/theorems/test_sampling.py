# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The sample period that each weight ρ of z2 allows."""

import pytest

from research.theorems import sampling


def test_the_printed_weight_chatters_above_a_third_of_a_millisecond():
    limits = sampling.sample_period_limit([1.0, 1.44e6], [3e-4, 5e-4, 1e-3], duration=2.0)
    literal, scaled = limits.lines
    assert limits.limit(1.0) == 3e-4
    assert limits.limit(1.44e6) == 1e-3
    assert literal.saturated[0] == 0.0 and literal.saturated[-1] > 0.5
    assert literal.e_rms[-1] > 10.0 * scaled.e_rms[-1]


@pytest.mark.parametrize(
    ("weight", "gain", "expected"), [(1.0, 1.0, 3.84e-4), (1.0, 1.25, 3.06e-4), (10.0, 1.0, 3.26e-3)]
)
def test_critical_period_of_the_sampled_loop(weight, gain, expected):
    assert sampling.critical_period(weight, gain) == pytest.approx(expected, rel=0.01)
