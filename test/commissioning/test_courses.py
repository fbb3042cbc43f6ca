# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Courses: within the limits whatever the valve does, and back to 0 V at their end."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valve_control.control.commands.scenarios import sine_steps
from valve_control.design.commissioning import courses
from valve_control.design.commissioning.bench import Instant, SafetyLimits

PERIOD = 0.001


def driven(course, readings, most=60_000):
    """Commands of a course that sees ``readings``, the last one for ever."""
    commands = [next(course)]
    for k in range(most):
        try:
            commands.append(course.send(Instant((k + 1) * PERIOD, readings[min(k, len(readings) - 1)])))
        except StopIteration:
            return np.array(commands)
    raise AssertionError("the course does not end")


numbers = st.floats(-20.0, 20.0)


@given(st.floats(0.1, 10.0), st.floats(0.2, 5.0), st.lists(numbers, min_size=1, max_size=300))
def test_triangle_stays_within_the_voltage_and_ends_at_rest(voltage, travel, readings):
    limits = SafetyLimits(voltage, travel)
    rate = 0.4 * voltage
    commands = driven(courses.triangle(limits, rate, 4), [*readings, 0.0])
    assert np.max(np.abs(commands)) <= voltage
    assert commands[0] == 0.0 and commands[-1] == 0.0
    assert np.max(np.abs(np.diff(commands))) <= rate * PERIOD * (1.0 + 1e-6)


def test_a_spool_that_goes_on_after_a_turn_is_turned_earlier_the_next_time():
    """A valve that is 0.15 s late goes on by 0.26 V after the first turn; the next ones stay within REACH."""
    limits, late, gain = SafetyLimits(4.0, 2.0), 150, 1.1
    course = courses.triangle(limits, 1.6, 4)
    commands, readings = [next(course)], []
    with pytest.raises(StopIteration):
        while True:
            readings.append(gain * commands[max(0, len(commands) - 1 - late)])
            commands.append(course.send(Instant(len(commands) * PERIOD, readings[-1])))
    first = int(np.argmax(readings))
    assert readings[first] == pytest.approx(
        courses.REACH * limits.travel + gain * 1.6 * late * PERIOD, abs=0.01
    )
    turned = np.abs(readings[first + 2 * late :])
    assert np.max(turned) == pytest.approx(courses.REACH * limits.travel, abs=0.01)


@given(st.floats(0.1, 10.0), st.floats(-5.0, 5.0), st.lists(numbers, min_size=1, max_size=300))
def test_sines_stay_within_the_voltage_and_become_smaller_beyond_the_reach(amplitude, offset, readings):
    limits = SafetyLimits(3.0, 1.0)
    steps = sine_steps(5.0, 20.0, 3, 2, 0.3)
    commands = driven(courses.stepped_sine(limits, steps, amplitude, offset), readings)
    assert np.max(np.abs(commands)) <= 3.0
    assert commands[-1] == 0.0


def test_a_sine_is_made_smaller_until_the_spool_stays_within_its_reach():
    """A valve without lag and with a gain of 2: the sine ends where the reading is at REACH of the travel."""
    limits = SafetyLimits(4.0, 2.0)
    course = courses.stepped_sine(limits, sine_steps(2.0, 2.0, 1, 12, 6.0), 3.0, 0.0)
    command, largest = next(course), []
    for k in range(5000):
        largest.append(abs(2.0 * command))
        command = course.send(Instant((k + 1) * PERIOD, 2.0 * command))
    assert max(largest[-1000:]) <= courses.REACH * 2.0
    assert max(largest[-1000:]) >= courses.REACH * 2.0 * courses.LOWER - 0.01


def test_a_motion_is_played_by_the_numbers_of_the_readings():
    wanted = np.array([0.0, 1.0, 2.0, 3.0])
    course = courses.motion(wanted, PERIOD)
    assert next(course) == pytest.approx((0.0, 0.5 / PERIOD, 1.0 / PERIOD**2))
    assert course.send(Instant(2 * PERIOD, 0.0)).position == 2.0  # a reading was lost
    assert course.send(Instant(3 * PERIOD, 0.0)).position == 3.0
    assert course.send(Instant(4 * PERIOD, 0.0)) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("period", [0.001, 0.01, 0.02])
def test_the_triangle_has_its_rate_at_any_period(period):
    """With readings every 10 ms it rose at half of it, and took twice as long as was said."""
    limits, time = SafetyLimits(4.0, 2.0), 0.0
    course = courses.triangle(limits, 1.6, 4, period=period)
    commands = [next(course)]
    with pytest.raises(StopIteration):
        while True:
            time += period
            commands.append(course.send(Instant(time, 0.0)))
    assert np.max(np.abs(np.diff(commands))) == pytest.approx(1.6 * period)
    assert time == pytest.approx(2.0 * 4 * 4.0 / 1.6, rel=0.02)
