# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Noise and step of an LVDT, told by its readings in motion."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from valve_control.design.identification import lvdt


@settings(max_examples=40, deadline=None)
@given(
    noise=st.floats(1e-3, 15e-3),
    resolution=st.sampled_from([0.0, 0.5e-3, 3.7e-3]),
    frequency=st.floats(0.1, 20.0),
    seed=st.integers(0, 1000),
)
def test_noise_and_step_come_back_under_a_motion(noise, resolution, frequency, seed):
    random = np.random.default_rng(seed)
    t = np.arange(20_000) * 0.001
    y = 2.0 * np.sin(2.0 * np.pi * frequency * t) + noise * random.standard_normal(len(t))
    y = resolution * np.round(y / resolution) if resolution else y
    found = lvdt.observe(y)
    assert found.resolution == pytest.approx(resolution, rel=1e-6)
    # In the sum with the steps' variance the estimate is good to 3 %.
    assert np.hypot(found.noise, resolution / 12**0.5) == pytest.approx(
        np.hypot(noise, resolution / 12**0.5), rel=0.06
    )


def test_lost_readings_do_not_count_and_too_few_tell_nothing():
    random = np.random.default_rng(1)
    y = 0.005 * random.standard_normal(5000)
    y[::50] = np.nan
    assert lvdt.observe(y).noise == pytest.approx(0.005, rel=0.06)
    assert lvdt.observe(y[:20]) == (0.0, 0.0)


def test_noise_below_a_step_is_hidden():
    found = lvdt.observe(0.01 * np.round(np.linspace(0.0, 1.0, 5000) / 0.01))
    assert found.resolution == pytest.approx(0.01) and found.noise == 0.0
