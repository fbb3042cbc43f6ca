# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Overshoot and settling time of positions whose answer is known."""

import math

import numpy as np
import pytest

from valve_control.control.analysis import steps

PERIOD = 0.001
TIMES = np.arange(1000) * PERIOD


def second_order(damping, frequency=40.0):
    turning = frequency * math.sqrt(1.0 - damping**2)
    fading = np.exp(-damping * frequency * TIMES)
    return 1.0 - fading * (np.cos(turning * TIMES) + damping * frequency / turning * np.sin(turning * TIMES))


@pytest.mark.parametrize("damping", [0.3, 0.5, 0.7])
@pytest.mark.parametrize("height", [2.0, -0.5])
def test_overshoot_of_a_second_order_is_that_of_the_textbook(damping, height):
    command = np.concatenate([np.zeros(100), np.full(1000, height)])
    answer = second_order(damping)
    position = np.concatenate([np.zeros(100), height * answer])
    found = steps.answer(command, position, PERIOD)
    assert found.overshoot == pytest.approx(
        math.exp(-math.pi * damping / math.sqrt(1.0 - damping**2)), abs=1e-3
    )
    assert found.settling == pytest.approx(
        np.flatnonzero(np.abs(answer - 1.0) > 0.02)[-1] * PERIOD, abs=0.0015
    )


def test_the_worst_of_several_steps_and_positions_counts_and_motions_have_none():
    command = np.repeat([0.0, 1.0, 0.5], 100)
    good, bad = command.copy(), command.copy()
    bad[200:] = 0.45
    found = steps.answer(command, np.stack([good, bad]), PERIOD)
    assert found.overshoot == pytest.approx([0.0, 0.1]) and list(found.settling) == [0.0, math.inf]
    assert steps.answer(command, np.full(300, np.nan), PERIOD).settling == math.inf
    assert steps.answer(np.sin(TIMES), np.sin(TIMES), PERIOD) is None
    assert steps.answer(np.zeros(100), np.zeros(100), PERIOD) is None
