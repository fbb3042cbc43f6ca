# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Structure by evidence: coils come out as poles, dead times as dead times, and nothing is invented."""

import math

import numpy as np
import pytest

from valve_control.control.plant.models import FOURTH_ORDER, SECOND_ORDER, TransferFunction
from valve_control.design.identification import bode, rational
from valve_control.design.identification.response import Response

PERIOD = 0.001


def made(model, delay=0.0, deviation=1e-4, seed=1, count=30):
    """A response as a stepped sine of equal length would measure it."""
    f = np.geomspace(0.5, 100.0, count)
    noise = np.random.default_rng(seed).standard_normal((2, count)) * deviation
    value = bode.held_response(model, f, PERIOD, delay) + noise[0] + 1j * noise[1]
    return Response(f, value, np.full(count, deviation), np.ones(count), PERIOD, "stepped sine", ())


def with_coil(hertz, damping, lag, gain=0.85):
    omega = 2.0 * math.pi * hertz
    denominator = np.polymul([1.0, 2.0 * damping * omega, omega**2], [1.0, 1.0 / lag])
    return TransferFunction((gain * omega**2 / lag,), tuple(map(float, denominator)))


@pytest.mark.parametrize("delay", [0.0, 0.0005, 0.001])
@pytest.mark.parametrize(("hertz", "damping", "lag"), [(9.0, 0.8, 0.004), (7.0, 0.8, 0.003)])
def test_a_coil_is_a_pole_and_not_dead_time(hertz, damping, lag, delay):
    best = rational.choose(made(with_coil(hertz, damping, lag), delay))
    assert (best.order, len(best.model.numerator)) == (3, 1)
    assert ("delay" in best.names) == (delay > 0.0)
    assert abs(best.delay - delay) < 1e-5
    fast = max(bode.roots(best.model.denominator), key=lambda root: root.frequency)
    assert 2.0 * math.pi * fast.frequency * lag == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("model", "delay", "form"),
    [
        (SECOND_ORDER, 0.0, (2, 0, False)),
        (SECOND_ORDER, 0.001, (2, 0, True)),
        (FOURTH_ORDER, 0.0, (4, 2, False)),
        (FOURTH_ORDER, 0.006, (4, 2, True)),
    ],
)
def test_the_models_of_the_paper_keep_their_structure(model, delay, form):
    best = rational.choose(made(model, delay))
    assert (best.order, len(best.model.numerator) - 1, "delay" in best.names) == form
    assert np.allclose(best.values[: len(best.values) - form[2]][-1], model.denominator[-1], rtol=0.02)


def test_noise_that_explains_the_second_order_ends_the_search():
    measured = made(SECOND_ORDER, deviation=1e-3)
    assert rational.choose(measured).names == ("b0", "a1", "a0")
