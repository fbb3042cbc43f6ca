# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The table of docs/explanation/command_course.md: an upper level with a clock of its own."""

import numpy as np
import pytest

from benchmarks import command_times


@pytest.fixture(scope="module")
def cases():
    return [case for case in command_times.tuned() if case.name.startswith("d3fxe_experiment")]


@pytest.mark.parametrize("rate", [1000, 100])
def test_sines_have_error_chatter_and_voltage_of_commands_in_time(cases, rate):
    name = "the same, 2 % late" if rate == 1000 else "1000 ppm, jitter"
    found = np.array([command_times.ratios(case, rate, name)["sines"] for case in cases])
    assert np.all(found[:, 0] < command_times.LIMITS[0])
    assert np.all(np.median(found, axis=0) < command_times.LIMITS)


def test_strokes_and_steps_are_those_of_one_clock(cases):
    for case in cases:
        for motion, ratios in command_times.ratios(case, 1000, "1000 ppm").items():
            assert np.all(np.array(ratios) < command_times.LIMITS), (case.name, motion, ratios)
