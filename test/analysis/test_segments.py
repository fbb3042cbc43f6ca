# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from valve_control.control.analysis.segments import motions
from valve_control.control.commands.scenarios import stroke, stroke_time

PERIOD = 0.001


def strokes(times, noise=0.0):
    t = np.arange(8000) * PERIOD
    command = np.zeros(8000)
    for i, begin in enumerate(times):
        distance = 2.92 if i % 2 == 0 else -2.92
        command += [stroke(x - begin, distance, 8.0, 64.0) for x in t]
    return command + noise * np.random.default_rng(1).standard_normal(8000)


@pytest.mark.parametrize("noise", [0.0, 0.0005])
def test_each_stroke_is_a_motion_and_rests_are_none(noise):
    begins = [1.0, 3.5, 6.0]
    found = motions(strokes(begins, noise), PERIOD)
    assert len(found) == 3
    ramp, cruise, _ = stroke_time(2.92, 8.0, 64.0)
    for motion, begin in zip(found, begins, strict=True):
        assert motion.start * PERIOD == pytest.approx(begin, abs=0.06)
        assert motion.end * PERIOD == pytest.approx(begin + 2.0 * ramp + cruise, abs=0.06)


def test_a_sine_is_one_motion_and_a_constant_none():
    t = np.arange(5000) * PERIOD
    found = motions(np.sin(2 * np.pi * 2.0 * t), PERIOD)
    assert [(m.start, m.end) for m in found] == [(0, 5000)]
    assert motions(np.full(5000, 1.5), PERIOD) == []


def test_a_pause_shorter_than_a_rest_does_not_end_a_motion():
    command = np.concatenate(
        [np.zeros(500), np.linspace(0, 1, 300), np.ones(60), np.linspace(1, 2, 300), np.full(500, 2.0)]
    )
    assert len(motions(command, PERIOD)) == 1
    command = np.concatenate(
        [np.zeros(500), np.linspace(0, 1, 300), np.ones(300), np.linspace(1, 2, 300), np.full(500, 2.0)]
    )
    assert len(motions(command, PERIOD)) == 2
