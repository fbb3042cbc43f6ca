# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""tuned.yaml alone gives the controller that a commissioning leaves, whatever was in force before."""

import pytest

from valve_control.cli.commission import tuned_values
from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER
from valve_control.parameter import defaults, updated

MODEL = {
    "controller": "dcarc",
    "dcarc.model": "custom",
    "dcarc.numerator": [1706617.8],
    "dcarc.denominator": [1.0, 439.19, 40893.8, 1896320.0],
    "dcarc.coil": 0.003,
    "reshaping.natural_frequency": 500.0,
}
GAINS = {"dcarc.voltage_weight": 3.0, "reshaping.lead": 0.004}


@pytest.mark.parametrize(
    ("before", "applied"),
    [
        (MODEL, GAINS),  # the same law with its model: only gains are different
        ({"controller": "arc", "arc.k1": 77.0, "sample_period": 0.002}, {**MODEL, **GAINS}),
        ({**MODEL, "u_max": 9.0}, {"controller": "pid", "pid.kp": 1.5}),
    ],
)
def test_the_file_alone_is_the_law_that_stays(before, applied):
    usual = defaults(CONTROLLER)
    before = updated(CONTROLLER, usual, before)
    final = updated(CONTROLLER, before, applied)
    written = tuned_values(before, applied)
    assert written.items() >= applied.items()
    alone = updated(CONTROLLER, usual, written)
    assert build.law_params(alone) == build.law_params(final)
    assert alone["controller"] == final["controller"] and alone["sample_period"] == final["sample_period"]


def test_a_value_that_becomes_the_default_is_written():
    before = updated(CONTROLLER, defaults(CONTROLLER), {"controller": "pid", "pid.kp": 1.5})
    usual = defaults(CONTROLLER)["pid.kp"]
    assert tuned_values(before, {"pid.kp": usual})["pid.kp"] == usual
