# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Dead time between actuator and sensor: its parts add up, and a wrong choice is told with its error."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valve_control.design.identification import dead_time
from valve_control.parameter import ParameterError

SECONDS = st.floats(0.0, 0.02)


@given(SECONDS, SECONDS)
def test_sensor_and_actuator_share_the_whole_dead_time(total, sensor):
    found = dead_time.divided(total, sensor)
    assert found.sensor + found.actuator == pytest.approx(total)
    assert 0.0 <= found.sensor <= sensor and found.actuator >= 0.0
    assert np.isclose(sum(dead_time.of_dcarc(total, sensor).values()), total)


def test_the_error_of_a_wrong_choice_is_told():
    (note,) = dead_time.notes(0.003, 0.001)
    assert note.startswith("2 ms of dead time count as the actuator's") and "velocity times 2 ms" in note
    assert dead_time.notes(0.001, 0.001) == [] and dead_time.notes(0.0, 0.0) == []
    (note,) = dead_time.notes(0.0002, 0.001)
    assert "less than the 1 ms that --sensor-delay gives" in note


@pytest.mark.parametrize("sensor", [-0.001, 1.5, float("nan"), float("inf")])
def test_what_is_no_dead_time_of_a_sensor_is_refused(sensor):
    with pytest.raises(ParameterError, match="--sensor-delay is .*; it must lie between 0 and 1 s"):
        dead_time.check(sensor)
