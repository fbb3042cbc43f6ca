# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What models say of a valve in slow motion, and what follows from it for the reference."""

import math

import pytest

from valve_control.control.laws import reshaping
from valve_control.control.plant import transfer_functions
from valve_control.control.plant.transfer_functions import FOURTH_ORDER, SECOND_ORDER, TransferFunction


def second_order(frequency, damping=0.8, gain=1.0):
    w = 2.0 * math.pi * frequency
    return TransferFunction((gain * w * w,), (1.0, 2.0 * damping * w, w * w))


def test_a_second_order_is_its_own_slow_motion_and_a_coil_takes_from_its_acceleration():
    w = 2.0 * math.pi * 40.0
    assert transfer_functions.slow_motion(second_order(40.0)) == pytest.approx((1.6 * w, w * w, w * w))
    lag = 0.002
    late = TransferFunction((w * w,), (lag, 1.0 + 1.6 * w * lag, 1.6 * w + w * w * lag, w * w))
    found = transfer_functions.slow_motion(late)
    assert found.b0 == pytest.approx(w * w / (1.0 + 1.6 * w * lag))
    assert transfer_functions.slow_motion(TransferFunction((1.0,), (1.0, 2.0))) is None


@pytest.mark.parametrize("model", [SECOND_ORDER, FOURTH_ORDER, FOURTH_ORDER.scaled(1.213)])
def test_valves_like_the_d3fxe_keep_its_limits_and_ranges(model):
    assert reshaping.limits(model, 10.0) == {}
    assert transfer_functions.scale_of(model) == transfer_functions.D3FXE
