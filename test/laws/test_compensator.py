# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Compensators: printed and designed bandwidths; the bits of `scipy.signal` without it."""

import math
import subprocess
import sys

import numpy as np
import pytest
import scipy.signal

from valve_control.control.laws import biquads, compensator_design, oarc
from valve_control.control.laws.signals import Start
from valve_control.control.plant.transfer_functions import FOURTH_ORDER, SECOND_ORDER, TransferFunction


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
        ((compensator_design.PRINTED_SECOND_ORDER, FOURTH_ORDER), (28.26, 20.48)),
        ((compensator_design.PRINTED_FOURTH_ORDER, FOURTH_ORDER), (13.14, 13.02)),
    ],
)
def test_bandwidths_of_the_printed_compensators(parts, expected):
    assert np.allclose(bandwidth(*parts), expected, rtol=0.0, atol=0.02)


@pytest.mark.parametrize("model", [SECOND_ORDER, FOURTH_ORDER])
@pytest.mark.parametrize("wanted", [15.0, 25.0, 40.0])
def test_designed_compensator_reaches_its_bandwidth(model, wanted):
    c = compensator_design.pole_zero_compensator(model, wanted)
    got, _ = bandwidth(c, model)
    assert math.isclose(got, wanted, abs_tol=0.01 * wanted)
    assert math.isclose(c.static_gain * model.static_gain, 1.0, rel_tol=1e-9)
    led_by_zero = TransferFunction((0.0, *model.numerator), model.denominator)
    assert compensator_design.pole_zero_compensator(led_by_zero, wanted) == c


@pytest.mark.parametrize(
    "printed", [compensator_design.PRINTED_SECOND_ORDER, compensator_design.PRINTED_FOURTH_ORDER]
)
def test_sampled_compensator_follows_the_continuous_one(printed):
    period = 0.001
    p = compensator_design.compensator_params(printed, period, 1e6)
    s = biquads.initial(p, Start(0.0, 0.0, 0.0, 0.0, 0.0))
    t = np.arange(3000) * period
    u = np.sin(2.0 * math.pi * 6.0 * t)
    out = []
    for value in u:
        voltage, s, _ = biquads.step(p, s, float(value), 0.0, 0.0)
        out.append(voltage)
    _, exact, _ = scipy.signal.lsim((printed.numerator, printed.denominator), u, t)
    assert np.max(np.abs(np.array(out) - exact)[500:]) < 0.01 * np.max(np.abs(exact))


@pytest.mark.parametrize("order", range(1, 7))
def test_bessel_poles(order):
    _, wanted, _ = scipy.signal.bessel(order, 157.0, analog=True, output="zpk", norm="mag")
    assert np.array_equal(compensator_design.bessel_poles(order, 157.0), wanted)


def points(random, count):
    """Real and conjugate points left of the imaginary axis, some pairs with one real part, some twice."""
    found = []
    while len(found) < count:
        left = 10.0 ** random.uniform(0.5, 3.5)
        up = left * random.uniform(0.1, 5.0)
        new = [-left] if random.random() < 0.4 else [-left + 1j * up, -left - 1j * up]
        if len(new) == 2 and random.random() < 0.2:
            new += [-left + 2j * up, -left - 2j * up]
        new *= 2 if random.random() < 0.1 else 1
        found += new if len(found) + len(new) <= count else [-left]
    return np.array(found)


def test_sections_of_random_transfer_functions():
    """Those of which scipy says that a pole has no conjugate, for lack of digits, say it here too."""
    random = np.random.default_rng(7)
    whole = 0
    for _ in range(600):
        order = int(random.integers(1, 7))
        b = np.atleast_1d(np.poly(points(random, int(random.integers(0, order + 1))))).real
        a = np.poly(points(random, order)).real * random.uniform(0.1, 3.0)
        b *= 10.0 ** random.uniform(-3.0, 6.0)
        wanted = scipy.signal.tf2zpk(b, a)
        found = compensator_design.zeros_poles_gain(TransferFunction(tuple(b), tuple(a)))
        assert all(map(np.array_equal, found, wanted))
        wanted, found = scipy.signal.bilinear_zpk(*wanted, 1e3), compensator_design.bilinear(*found, 1e3)
        assert all(map(np.array_equal, found, wanted))
        try:
            rows = scipy.signal.zpk2sos(*wanted)
        except ValueError:
            with pytest.raises(ValueError):
                compensator_design.sections(*found)
            continue
        assert np.array_equal(compensator_design.sections(*found), rows)
        whole += 1
    assert whole > 500


def test_k_filter():
    random = np.random.default_rng(8)
    for k1, k2, period in 10.0 ** random.uniform([0.0, 0.0, -5.0], [4.0, 7.0, -2.0], (200, 3)):
        system = np.array([[-k1, 1.0], [-k2, 0.0]]), np.array([[0.0], [1.0]]), np.eye(2), np.zeros((2, 1))
        a, b, *_ = scipy.signal.cont2discrete(system, period)
        assert list(oarc.k_filter(k1, k2, period)) == [*a.ravel(), *b.ravel()]


def test_a_controller_starts_without_scipy_signal():
    """Its import takes longer than all else of the start; a law that is chosen while it runs needs none."""
    text = (
        "import sys; from valve_control.control.parameters import build, table; "
        "from valve_control.parameter import defaults; values = defaults(table.CONTROLLER); "
        "[build.law_params({**values, 'compensator.design': design}) for design in "
        "('printed_fourth_order', 'printed_second_order', 'designed')]; "
        "sys.exit('scipy.signal' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", text], timeout=60, check=False).returncode == 0
