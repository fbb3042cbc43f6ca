# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np

from valve_control.control.analysis.indices import indices


def test_sine_in_the_head():
    t = np.arange(0.0, 6.0, 0.001)
    got = indices(0.2 * np.sin(2 * math.pi * 5 * t), 3.0 * np.sin(2 * math.pi * 5 * t), 0.001)
    assert math.isclose(got.e_M, 0.2, rel_tol=1e-6)
    assert math.isclose(got.e_F, 0.2, rel_tol=1e-6)
    assert math.isclose(got.e_rms, 0.2 / math.sqrt(2.0), rel_tol=1e-6)
    assert math.isclose(got.u_rms, 3.0 / math.sqrt(2.0), rel_tol=1e-6)
    assert math.isclose(got.c_u, 2.0 * math.sin(math.pi * 5 * 0.001), rel_tol=1e-3)


def test_final_error_is_that_of_the_last_two_seconds():
    error = np.zeros(6000)
    error[3990] = 1.0
    error[4500] = -0.5
    got = indices(error, np.zeros(6000), 0.001)
    assert (got.e_M, got.e_F, got.c_u) == (1.0, 0.5, 0.0)


def test_of_some_samples_in_the_head():
    """Three kept, then one, then two: no step of the voltage over what lies between."""
    error = np.array([1.0, 2.0, 3.0, 9.0, 4.0, 9.0, 5.0, 6.0])
    voltage = np.array([1.0, 2.0, 2.0, 9.0, 1.0, 9.0, 2.0, 4.0])
    kept = np.array([True, True, True, False, True, False, True, True])
    got = indices(error, voltage, 1.0, kept)
    assert got.e_M == 6.0 and got.e_F == 6.0
    assert math.isclose(got.e_rms, math.sqrt((1 + 4 + 9 + 16 + 25 + 36) / 6))
    assert math.isclose(got.u_rms, math.sqrt((1 + 4 + 4 + 1 + 4 + 16) / 6))
    assert math.isclose(got.c_u, math.sqrt((1 + 0 + 4) / 3) / got.u_rms)
    assert indices(error, voltage, 1.0, np.ones(8, dtype=bool)) == indices(error, voltage, 1.0)
