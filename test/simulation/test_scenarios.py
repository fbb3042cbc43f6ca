# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from valve_control.control.commands import scenarios


@given(st.floats(0.01, 10.0), st.floats(0.1, 50.0), st.floats(1.0, 500.0))
def test_stroke_keeps_its_limits_and_arrives(distance, velocity, accel):
    ramp, cruise, peak = scenarios.stroke_time(distance, velocity, accel)
    duration = 2.0 * ramp + cruise
    t = np.linspace(0.0, duration, 2001)
    x = np.array([scenarios.stroke(v, distance, velocity, accel) for v in t])
    h = t[1] - t[0]
    assert math.isclose(x[-1], distance, rel_tol=1e-9)
    assert np.all(np.diff(x) >= -1e-9 * distance)
    assert np.max(np.diff(x)) / h <= velocity * (1.0 + 1e-6)
    assert np.max(np.abs(np.diff(x, 2))) / h**2 <= accel * 1.01
    assert peak <= velocity


def shape(**changes):
    base = dict(
        scenario="point_to_point", amplitude=2.92, offset=0.1, start=0.25, frequency=6.0,
        end_frequency=60.0, max_velocity=8.0, max_accel=64.0, cycle=5.81, sweep_time=5.0,
    )  # fmt: skip
    return scenarios.Shape(**{**base, **changes})


def test_papers_motion_reaches_8_v_per_s_and_64_v_per_s2():
    t = np.arange(0.0, 6.0, 1e-4)
    x = np.array([scenarios.command(shape(), v) for v in t])
    assert math.isclose(np.max(np.diff(x)) / 1e-4, 8.0, rel_tol=1e-3)
    assert math.isclose(np.max(np.abs(np.diff(x, 2))) / 1e-8, 64.0, rel_tol=1e-2)
    assert math.isclose(x.max(), 3.02) and math.isclose(x[-1], 0.1, abs_tol=1e-9)


def test_sweep_passes_its_end_frequency():
    s = shape(scenario="sweep", amplitude=1.0, offset=0.0, start=0.0)
    t = np.arange(0.0, 5.0, 1e-4)
    x = np.array([scenarios.command(s, v) for v in t])
    crossings = t[1:][np.diff(np.sign(x)) != 0]
    assert math.isclose(0.5 / np.mean(np.diff(crossings[:3])), 6.3, rel_tol=0.1)
    assert math.isclose(0.5 / np.mean(np.diff(crossings[-5:])), 59.0, rel_tol=0.05)


def test_stepped_sine_has_whole_cycles_of_log_spaced_frequencies():
    s = shape(scenario="stepped_sine", frequency=2.0, end_frequency=32.0, steps=5, cycles=4, step_time=0.5)
    steps = scenarios.steps_of(s)
    assert np.allclose([step.frequency for step in steps], [2.0, 4.0, 8.0, 16.0, 32.0])
    assert np.allclose([step.end - step.start for step in steps], [2.0, 1.0, 0.5, 0.5, 0.5])
    for step in steps:
        quarter = s.start + step.start + 0.25 / step.frequency
        assert math.isclose(scenarios.command(s, quarter), s.offset + s.amplitude)
        assert math.isclose(scenarios.command(s, s.start + step.end), s.offset, abs_tol=1e-9)
    assert scenarios.command(s, 100.0) == s.offset
