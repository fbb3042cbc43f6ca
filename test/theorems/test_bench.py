# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

from research.theorems import bench
from research.theorems.bench import CosineReference
from valve_control.control.laws import reshaping
from valve_control.control.laws.projection import Theta


@pytest.mark.parametrize("truth", [(58.771, 1657.206), (120.0, 900.0), (60.0, 900.0)])
@pytest.mark.parametrize("period", [2e-5, 1e-3, 0.05])
def test_plant_is_the_matrix_exponential(truth, period):
    a1, a0 = truth
    m = scipy.linalg.expm(np.array([[0.0, 1.0, 0.0], [-a0, -a1, 1.0], [0.0, 0.0, 0.0]]) * period)
    got = bench.plant(Theta(a1, a0, 1.0, 0.0), period)
    assert np.allclose([got.m11, got.m12, got.m21, got.m22], m[:2, :2].ravel(), rtol=1e-10)
    assert np.allclose([got.g1, got.g2], m[:2, 2], rtol=1e-6)


def test_reference_has_its_own_derivatives_and_passes_the_reshaping():
    m = CosineReference(0.3, 1.0, 7.0, -0.4, 31.0, 0.2, 90.0)
    h = 1e-5
    p = bench.unlimited(1e-3)
    for t in np.linspace(0.0, 1.0, 23):
        x, v, a = bench.reference(m, float(t))
        before, after = bench.reference(m, float(t - h)), bench.reference(m, float(t + h))
        assert math.isclose((after[0] - before[0]) / (2.0 * h), v, rel_tol=1e-5, abs_tol=1e-4)
        assert math.isclose((after[1] - before[1]) / (2.0 * h), a, rel_tol=1e-5, abs_tol=1e-2)
        command = bench.command_for(p, x, v, a)
        got = reshaping.acceleration(p, reshaping.State(x, v), command)
        assert math.isclose(got, a, rel_tol=1e-9, abs_tol=1e-6)


def test_observer_peak_is_the_integral_of_the_impulse_response():
    """The integral of the impulse response's size, by (33), from the matrix exponential."""
    k1, k2 = 308.0, 48400.0
    peak = bench.observer_peak(k1, k2)
    a0 = np.array([[-k1, 1.0], [-k2, 0.0]])
    t = np.linspace(0.0, 0.12, 1201)
    step = scipy.linalg.expm(a0 * t[1])
    response = [1.0]
    x = np.array([0.0, 1.0])
    for _ in t[1:]:
        x = step @ x
        response.append(x[1])
    assert math.isclose(peak, scipy.integrate.trapezoid(np.abs(response), t), rel_tol=1e-3)
    assert peak > k1 / k2  # what a constant disturbance of 1 V/s² leads to
