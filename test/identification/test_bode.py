# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Responses of transfer functions: hold, sampling, delay, corners."""

import math

import numpy as np
import pytest
import scipy.signal

from valve_control.control.parameters import build
from valve_control.control.parameters.table import VALVE
from valve_control.control.plant import valve
from valve_control.control.plant.transfer_functions import FOURTH_ORDER, SECOND_ORDER, TransferFunction
from valve_control.design.identification import bode
from valve_control.parameter import defaults, updated


def settled_ratio(model, frequency, period, delay=0):
    """Sampled sine through the simulated valve: complex amplitude of position over that of voltage."""
    own = {
        "valve": "custom",
        "numerator": list(model.numerator),
        "denominator": list(model.denominator),
        "sample_period": period,
        "lvdt.delay": delay * period,
    }
    p = build.valve_params(updated(VALVE, defaults(VALVE), own))
    s = valve.initial(p)
    k = np.arange(round(2.0 / period))
    u = np.cos(2.0 * np.pi * frequency * period * k)
    y = []
    for value in u:
        y.append(valve.read(p, s, 0.0))
        s = valve.step(p, s, float(value))
    late = k >= len(k) // 2
    columns = np.exp(2j * np.pi * frequency * period * k[late])
    basis = np.column_stack([columns.real, -columns.imag])
    fit, *_ = np.linalg.lstsq(basis, np.array(y)[late], rcond=None)
    return complex(*fit)


@pytest.mark.parametrize("model", [SECOND_ORDER, FOURTH_ORDER])
@pytest.mark.parametrize(("frequency", "delay"), [(1.0, 1.5), (6.0, 0.4), (40.0, 0), (180.0, 2)])
def test_held_response_is_that_of_the_simulated_valve(model, frequency, delay):
    got = bode.held_response(model, np.array([frequency]), 0.002, delay * 0.002)[0]
    assert abs(got / settled_ratio(model, frequency, 0.002, delay) - 1.0) < 1e-6


@pytest.mark.parametrize("power", [1, 2, 3])
def test_equal_poles_have_partial_fractions_too(power):
    model = TransferFunction((60.0**power,), tuple(map(float, np.poly([-60.0] * power))))
    f = np.geomspace(0.1, 450.0, 25)
    numerator, denominator, _ = scipy.signal.cont2discrete(model, 0.001)
    exact = scipy.signal.freqz(np.ravel(numerator), denominator, f, fs=1000.0)[1]
    assert bode.held_response(model, f, 0.001) == pytest.approx(exact, abs=1e-5)


def test_corners_of_the_paper():
    assert np.allclose(bode.model_corners(FOURTH_ORDER), (6.9, 6.2), atol=0.05)
    second = bode.model_corners(SECOND_ORDER)
    assert math.isclose(second.minus_90, math.sqrt(1657.206) / (2.0 * math.pi), rel_tol=1e-5)


def test_roots_as_frequency_and_damping():
    (pole,) = bode.roots((1.0, 2.0 * 0.3 * 100.0, 1e4))
    assert pole.pair and math.isclose(pole.damping, 0.3) and math.isclose(pole.frequency, 50.0 / math.pi)
    slow, fast = bode.roots((1.0, -6.0, 5.0))
    assert (slow.pair, slow.damping, fast.damping) == (False, -1.0, -1.0) and fast.frequency > slow.frequency
