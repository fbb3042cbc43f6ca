# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Commands that come slowly, late or by another clock: as a node has them, and what loops make of them."""

import math

import changed
import numpy as np
import pytest

from benchmarks import command_times
from valve_control.control.laws import command_lead
from valve_control.control.simulation import delivery
from valve_control.control.simulation.delivery import Delivery

TIMES = np.arange(1000) * 0.001
SINE = np.sin(2.0 * math.pi * 3.0 * TIMES)


def test_one_command_a_sample_in_time_is_the_motion_itself():
    own = changed.controller(reshaping__lead=0.004)
    lead = command_lead.build(own, True)
    made = delivery.led(lead, own, SINE, Delivery(0.001))
    assert np.array_equal(made, command_lead.applied(lead, SINE))


def test_messages_have_the_motion_at_their_times():
    told = Delivery(0.002, 0.0005, drift=1e-3, late=0.1, pause=0.01)
    commands, stamps, came = delivery.messages(SINE, told, 0.001)
    sent = stamps * (1.0 + 1e-3)
    assert np.allclose(commands, np.sin(2.0 * math.pi * 3.0 * sent), atol=1e-6)
    assert np.all(came >= sent - 1e-12) and np.all(np.diff(came) >= 0.0)
    gaps = np.diff(stamps)
    assert np.isclose(np.min(gaps), 0.002) and np.max(gaps) > 0.009


def test_between_two_samples_a_step_is_not_gone_beyond():
    commands, *_ = delivery.messages(np.where(TIMES < 0.5, 0.0, 2.0), Delivery(0.0013), 0.001)
    assert np.all((commands >= 0.0) & (commands <= 2.0))


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
