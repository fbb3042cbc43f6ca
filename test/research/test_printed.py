# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
import numpy as np

from research import printed


def test_factors_of_the_paper():
    """(12) is its factors to the last printed digit; of (13) one coefficient is off."""
    second, fourth = printed.printed()
    for agreement in (second, fourth):
        assert np.max(np.abs(agreement.numerator_errors)) < 1e-6
    # 470 for 469.91, 79652 for 79651.9, 6168503.
    assert [round(c, d) for c, d in zip(second.again.denominator, (0, 0, 0, 0), strict=True)] == [
        1, 470, 79652, 6168503,
    ]  # fmt: skip
    assert [round(c) for c in fourth.again.denominator] == [
        1, 752, 237999, 40483518, 3703487601, 151893300250,
    ]  # fmt: skip
    assert fourth.printed.denominator[1] == 753.0
    assert np.isclose(second.static_gain, 1.0) and np.isclose(fourth.static_gain, 0.889, atol=1e-3)
    assert np.allclose(second.printed_on_fourth_order, (28.3, 20.5), atol=0.06)
    assert np.allclose(fourth.printed_on_fourth_order, (13.2, 13.0), atol=0.06)
    assert np.allclose(second.printed_on_second_order, (22.9, 18.7), atol=0.08)
