# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Commands that come slowly, joined, early or late: as a node has them."""

import math

import changed
import numpy as np
import pytest

from valve_control.control.laws import command_lead
from valve_control.control.simulation import delivery
from valve_control.control.simulation.delivery import Delivery
from valve_control.parameter import ParameterError

TIMES = np.arange(1000) * 0.001
SINE = np.sin(2.0 * math.pi * 3.0 * TIMES)


def values(kind="hold", **changes):
    return changed.controller(command__interpolation=kind, **changes)


def test_one_command_a_sample_in_time_is_the_motion_itself():
    own = values(reshaping__lead=0.004)
    lead = command_lead.build(own, True)
    made = delivery.led(lead, delivery.received(own, SINE, Delivery(0.001)))
    assert np.array_equal(made, command_lead.applied(lead, SINE))


@pytest.mark.parametrize(("kind", "late"), [("hold", 0.0045), ("linear", 0.011), ("extrapolate", 0.0014)])
def test_lag_at_100_hz_is_that_of_the_table_in_cascade(kind, late):
    got = delivery.received(values(kind), SINE, Delivery(0.01)).values
    spectrum = (got @ np.exp(-2j * math.pi * 3.0 * TIMES)) / (SINE @ np.exp(-2j * math.pi * 3.0 * TIMES))
    assert -np.angle(spectrum) / (2.0 * math.pi * 3.0) == pytest.approx(late, abs=4e-4)


def test_uneven_commands_come_twice_and_not_at_all():
    got = delivery.received(values(command__bridge=0.0), TIMES, Delivery(0.001, 0.0007)).values
    steps = np.round(np.diff(got) / 0.001)
    assert set(steps) >= {0.0, 1.0, 2.0} and np.all(steps >= 0.0)
    assert np.max(np.abs(got - TIMES)) < 0.0021


def test_uneven_commands_are_bridged():
    """Within half a sample of the motion on average, and with a quarter of the steps' unevenness."""
    held, bridged = (
        delivery.received(values(command__bridge=time), TIMES, Delivery(0.001, 0.0007)).values - TIMES
        for time in (0.0, 0.006)
    )
    assert abs(np.mean(bridged[50:])) < 0.0005 and np.max(np.abs(bridged)) < 0.0021
    assert np.std(np.diff(bridged[50:])) < 0.5 * np.std(np.diff(held[50:]))


@pytest.mark.parametrize(
    "wrong", [Delivery(0.0005), Delivery(0.2), Delivery(0.01, 0.02), Delivery(0.01, -1.0)]
)
def test_what_no_upper_level_does_is_refused(wrong):
    with pytest.raises(ParameterError, match="--command-(period|jitter) is .* must lie between"):
        delivery.check(values(), wrong)
