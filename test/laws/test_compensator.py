# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest
import scipy.signal

from valve_control.control.laws import biquads, design
from valve_control.control.laws.signals import Start
from valve_control.control.plant.models import FOURTH_ORDER, SECOND_ORDER, TransferFunction


def bandwidth(*parts):
    """(-3 dB, -90°) [Hz] of a product of transfer functions, both relative to its static gain."""
    f = np.linspace(0.1, 60.0, 60000)
    h = np.ones(len(f), dtype=complex)
    for part in parts:
        h *= scipy.signal.freqs(part.numerator, part.denominator, 2.0 * math.pi * f)[1]
        h /= part.static_gain
    magnitude = 20.0 * np.log10(np.abs(h))
    phase = np.degrees(np.unwrap(np.angle(h)))
    return f[np.argmax(magnitude < -3.0)], f[np.argmax(phase < -90.0)]


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ((FOURTH_ORDER,), (6.89, 6.17)),
        ((design.PRINTED_SECOND_ORDER, FOURTH_ORDER), (28.26, 20.48)),
        ((design.PRINTED_FOURTH_ORDER, FOURTH_ORDER), (13.14, 13.02)),
    ],
)
def test_bandwidths_of_the_printed_compensators(parts, expected):
    assert np.allclose(bandwidth(*parts), expected, rtol=0.0, atol=0.02)


@pytest.mark.parametrize("model", [SECOND_ORDER, FOURTH_ORDER])
@pytest.mark.parametrize("wanted", [15.0, 25.0, 40.0])
def test_designed_compensator_reaches_its_bandwidth(model, wanted):
    c = design.pole_zero_compensator(model, wanted)
    got, _ = bandwidth(c, model)
    assert math.isclose(got, wanted, abs_tol=0.01 * wanted)
    assert math.isclose(c.static_gain * model.static_gain, 1.0, rel_tol=1e-9)
    led_by_zero = TransferFunction((0.0, *model.numerator), model.denominator)
    assert design.pole_zero_compensator(led_by_zero, wanted) == c


@pytest.mark.parametrize("printed", [design.PRINTED_SECOND_ORDER, design.PRINTED_FOURTH_ORDER])
def test_sampled_compensator_follows_the_continuous_one(printed):
    period = 0.001
    p = design.compensator_params(printed, period, 1e6)
    s = biquads.initial(p, Start(0.0, 0.0, 0.0, 0.0, 0.0))
    t = np.arange(3000) * period
    u = np.sin(2.0 * math.pi * 6.0 * t)
    out = []
    for value in u:
        voltage, s, _ = biquads.step(p, s, float(value), 0.0, 0.0)
        out.append(voltage)
    _, exact, _ = scipy.signal.lsim((printed.numerator, printed.denominator), u, t)
    assert np.max(np.abs(np.array(out) - exact)[500:]) < 0.01 * np.max(np.abs(exact))


def test_starts_in_the_steady_state_of_the_voltage():
    p = design.compensator_params(design.PRINTED_FOURTH_ORDER, 0.001, 10.0)
    s = biquads.initial(p, Start(0.0, 3.0, 0.0, 0.0, 0.0))
    for _ in range(100):
        voltage, s, _ = biquads.step(p, s, 3.0 / p.static_gain, 0.0, 0.0)
        assert math.isclose(voltage, 3.0, rel_tol=1e-9)
