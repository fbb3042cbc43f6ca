# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Compensators and filters without `scipy.signal` have its bits."""

import subprocess
import sys

import numpy as np
import pytest
import scipy.signal

from valve_control.control.laws import design, oarc
from valve_control.control.plant.models import TransferFunction


@pytest.mark.parametrize("order", range(1, 7))
def test_bessel_poles(order):
    _, wanted, _ = scipy.signal.bessel(order, 157.0, analog=True, output="zpk", norm="mag")
    assert np.array_equal(design.bessel_poles(order, 157.0), wanted)


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
        found = design.zeros_poles_gain(TransferFunction(tuple(b), tuple(a)))
        assert all(map(np.array_equal, found, wanted))
        wanted, found = scipy.signal.bilinear_zpk(*wanted, 1e3), design.bilinear(*found, 1e3)
        assert all(map(np.array_equal, found, wanted))
        try:
            rows = scipy.signal.zpk2sos(*wanted)
        except ValueError:
            with pytest.raises(ValueError):
                design.sections(*found)
            continue
        assert np.array_equal(design.sections(*found), rows)
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
