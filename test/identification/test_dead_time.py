# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Dead time between actuator and sensor: its parts add up, and a wrong choice is told with its error."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from valve_control.design.identification import dead_time

SECONDS = st.floats(0.0, 0.02)


@given(SECONDS, SECONDS)
def test_sensor_and_actuator_share_the_whole_dead_time(total, sensor):
    found = dead_time.divided(total, sensor)
    assert found.sensor + found.actuator == pytest.approx(total)
    assert 0.0 <= found.sensor <= sensor and found.actuator >= 0.0


def test_the_error_of_a_wrong_choice_is_told():
    (note,) = dead_time.notes(0.003, 0.001)
    assert note.startswith("2 ms of dead time count as the actuator's") and "velocity times 2 ms" in note
    assert dead_time.notes(0.001, 0.001) == [] and dead_time.notes(0.0, 0.0) == []
