# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from valve_control.control.analysis.overlay import TimedSignal, shift
from valve_control.control.commands.scenarios import stroke


def strokes(time):
    """Two strokes of different height, 0.4 s and 1.4 s after the time 0."""
    there = np.array([stroke(t - 0.4, 2.0, 20.0, 400.0) for t in time])
    return there + np.array([stroke(t - 1.4, -1.2, 20.0, 400.0) for t in time])


def sine(time):
    return np.where(time > 0.0, 2.0 * np.sin(2.0 * np.pi * 1.5 * time), 0.0)


def motion(law, begin, end, clock=0.0, period=1e-3, noise=0.0):
    """``law`` from ``begin`` to ``end`` of its time [s], recorded from ``clock`` on."""
    time = np.arange(begin, end, period)
    value = law(time) + np.random.default_rng(1).normal(0.0, noise, len(time))
    return TimedSignal(time - begin + clock, value, period)


@pytest.mark.parametrize("law", [strokes, sine])
@pytest.mark.parametrize("begin", [-3.0, -0.2, 0.0])
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_a_longer_rest_before_the_motion_is_made_good(law, begin, noise):
    over = motion(law, -0.5, 3.0)
    moved, alike = shift(motion(law, begin, 3.0, clock=7.0, noise=noise), over)
    assert alike and moved == pytest.approx(begin + 0.5 - 7.0, abs=1.1e-3)


def test_a_sine_without_rest_lies_in_phase():
    moved, alike = shift(motion(sine, 1.123, 6.0), motion(sine, 0.9, 5.0))
    cycles = (moved - 0.223) * 1.5
    assert alike and cycles == pytest.approx(round(cycles), abs=3e-3)  # 2 ms


def test_motions_that_are_not_alike_begin_together():
    """A stroke, and a slow ramp that begins 2 s later."""
    over = motion(strokes, 0.0, 3.0)
    ramp = motion(lambda t: np.clip(t - 2.4, 0.0, 4.0) * -0.5, 0.0, 6.0)
    moved, alike = shift(ramp, over)
    assert not alike and moved == pytest.approx(-2.0, abs=0.05)
