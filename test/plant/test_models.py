# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What models say of a valve in slow motion, and what follows from it for the reference and a search."""

import math

import pytest

from valve_control.control.laws import reshaping
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant import models
from valve_control.control.plant.models import FOURTH_ORDER, SECOND_ORDER, TransferFunction
from valve_control.design.tuning import trial
from valve_control.parameter import defaults, updated


def second_order(frequency, damping=0.8, gain=1.0):
    w = 2.0 * math.pi * frequency
    return TransferFunction((gain * w * w,), (1.0, 2.0 * damping * w, w * w))


def test_a_second_order_is_its_own_slow_motion_and_a_coil_takes_from_its_acceleration():
    w = 2.0 * math.pi * 40.0
    assert models.slow_motion(second_order(40.0)) == pytest.approx((1.6 * w, w * w, w * w))
    lag = 0.002
    late = TransferFunction((w * w,), (lag, 1.0 + 1.6 * w * lag, 1.6 * w + w * w * lag, w * w))
    found = models.slow_motion(late)
    assert found.b0 == pytest.approx(w * w / (1.0 + 1.6 * w * lag))
    assert models.slow_motion(TransferFunction((1.0,), (1.0, 2.0))) is None


@pytest.mark.parametrize("model", [SECOND_ORDER, FOURTH_ORDER, FOURTH_ORDER.scaled(1.213)])
def test_valves_like_the_d3fxe_keep_its_limits_and_ranges(model):
    assert reshaping.limits(model, 10.0) == {}
    assert models.scale_of(model) == models.D3FXE


def test_ranges_of_every_law_follow_from_the_valve():
    """In (4) of a valve of 35 Hz; and those of each law stay ranges that the table accepts."""
    model = second_order(35.0)
    scale = models.scale_of(model)
    for law in (law for law in LAWS.values() if law.free):
        for variant in law.variants:
            values = updated(CONTROLLER, defaults(CONTROLLER), variant)
            usual = {free.name: free for free in trial.free_numbers(law, values, False)}
            for free in trial.free_numbers(law, values, False, scale):
                assert free.low < free.high
                middle = math.sqrt(free.low * free.high) if free.logarithmic else free.high
                trial.gains_at([free], values, [0.5])
                if free.name == "pid.theta[1]":
                    assert free.low < models.slow_motion(model).a0 < free.high
                    assert usual[free.name].high < middle
