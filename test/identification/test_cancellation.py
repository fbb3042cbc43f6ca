# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Pole-zero compensators: what they reach, what is warned of, and the paper's two."""

import numpy as np
import pytest

from valve_control.control.laws import design
from valve_control.control.plant.models import FOURTH_ORDER, SECOND_ORDER, TransferFunction
from valve_control.design.identification import cancellation
from valve_control.parameter import ParameterError


@pytest.mark.parametrize("model", [SECOND_ORDER, FOURTH_ORDER])
@pytest.mark.parametrize("period", [0.0005, 0.001])
def test_wanted_bandwidth_is_reached_as_sampled(model, period):
    made = cancellation.make(model, 25.0, period=period)
    assert np.isclose(made.compensated.minus_3db, 25.0, rtol=0.01)
    assert np.isclose(made.sampled.minus_3db, 25.0, rtol=0.02)
    assert made.compensated.minus_90 > made.sampled.minus_90 > 0.9 * made.compensated.minus_90
    assert np.isclose(made.transfer_function.static_gain * model.static_gain, 1.0)


def test_kept_zeros_and_order():
    made = cancellation.make(FOURTH_ORDER, 25.0, cancel_zeros=False, order=5)
    assert len(made.transfer_function.denominator) == 6
    assert any("zeros that stay" in warning for warning in made.warnings)
    steeper = cancellation.make(SECOND_ORDER, 25.0, order=5)
    assert np.isclose(steeper.compensated.minus_3db, 25.0, rtol=0.01)
    assert steeper.compensated.minus_90 < made.compensated.minus_90


def test_warnings():
    assert cancellation.make(SECOND_ORDER, 20.0).warnings == ()
    light = cancellation.make(FOURTH_ORDER, 20.0).warnings
    assert "poles at 32.33 Hz have a damping of 0.29" in light[0]
    loud = cancellation.make(SECOND_ORDER, 100.0).warnings
    assert any("noise of the command" in warning for warning in loud)
    right = TransferFunction((-10.0, 2000.0), (1.0, 30.0, 900.0, 5000.0))
    assert any("lies to the right" in warning for warning in cancellation.make(right, 10.0).warnings)


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (TransferFunction((1.0,), (1.0, -3.0, 2.0)), "stable model"),
        (TransferFunction((1.0, 2.0, 3.0), (1.0, 3.0, 2.0)), "2 zeros and 2 poles"),
        (TransferFunction((0.0,), (1.0, 2.0)), "more poles than zeros"),
        (TransferFunction((1.0, 0.0), (1.0, 2.0, 3.0)), "zero at 0 rad/s"),
        (TransferFunction((float("inf"),), (1.0, 2.0)), "not finite"),
    ],
)
def test_models_that_cannot_be_compensated(model, words):
    with pytest.raises(ParameterError, match=words):
        cancellation.make(model, 10.0)


def test_factors_of_the_printed_compensators():
    """(12) to the last printed digit; of (13) the coefficient of s⁴ is off by 0.6."""
    slow, double = 50.0 * np.pi, [1.0, 1.6 * 157.0, 157.0**2]
    second = np.polymul([1.0, 1.4 * slow, slow**2], [1.0, 250.0])
    fourth = np.polymul(np.polymul(double, double), [1.0, 250.0])
    assert np.allclose(design.PRINTED_SECOND_ORDER.denominator, second, rtol=2e-4)
    off = np.array(design.PRINTED_FOURTH_ORDER.denominator) - fourth
    assert off[1] == pytest.approx(0.6, abs=1e-9) and np.max(np.abs(off[2:] / fourth[2:])) < 3e-6
