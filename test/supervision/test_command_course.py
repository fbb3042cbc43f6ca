# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Course of the command: the motion of an upper level at the times of the readings, and its clock."""

import math

import changed
import numpy as np
import pytest
from grids import grid
from hypothesis import given
from hypothesis import strategies as st
from slow import PERIOD, SETTLED, SWIFT, made

from valve_control.control.analysis.indices import rms
from valve_control.control.simulation import delivery
from valve_control.control.simulation.delivery import Delivery
from valve_control.control.supervision import clock, command_course
from valve_control.control.supervision.command_course import LONGEST, Course

P = command_course.Params(0.006, 0.0, 10.0, PERIOD)
RATES = (0.001, 0.002, 0.005, 0.01)  # s  between two commands


def course_of(commands, stamps):
    """State after these commands."""
    s = None
    for command, stamp in zip(commands, stamps, strict=True):
        s = command_course.taken(P, s, float(command), float(stamp), float(stamp))
    return s


def values_of(commands, stamps, came, times, p=P):
    """Command [V] of each of the ``times`` [s], of commands that come at ``came`` [s]."""
    s, k, result = None, 0, []
    for now in times:
        while k < len(came) and came[k] <= now + 1e-9:
            s = command_course.taken(p, s, float(commands[k]), float(stamps[k]), float(stamps[k]))
            k += 1
        result.append(0.0 if s is None else command_course.value(p, s, float(now)))
    return np.array(result)


@given(st.lists(st.floats(-10.0, 10.0), min_size=1, max_size=60))
def test_a_command_for_each_sample_is_the_input_of_the_law_to_the_bit(commands):
    times = np.arange(len(commands)) * PERIOD
    assert values_of(commands, times, times, times).tolist() == commands


@given(st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6), st.floats(0.001, 0.02), st.floats(0.0, 2.5))
def test_a_polynomial_of_degree_5_is_continued(coefficients, interval, ahead):
    """The recursion has the derivatives of numpy's polynomial through the same six points."""
    x = np.arange(-30, 1) * 1.0
    s = course_of(np.polyval(coefficients, x / 30.0), x * interval)
    wanted = np.polyval(coefficients, ahead / 30.0)
    assert command_course.position(s.exact, ahead * interval) == pytest.approx(wanted, abs=1e-5)


@pytest.mark.parametrize("memory", command_course.MEMORIES)
def test_a_fading_memory_is_the_weighted_least_squares_fit(memory):
    """Second derivation: weights θ^k on all commands, by the normal equations."""
    commands = np.random.default_rng(2).normal(size=120)
    course = Course(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    gains = command_course._fading(memory)
    for command in commands:
        course = command_course.after(course, 1.0)
        course = command_course.renewed(course, gains, command, command - course.position, 0.0, 1.0, 5)
    x = np.arange(-119, 1)
    fit = np.polynomial.Polynomial.fit(x, commands, 3, w=memory ** (-0.5 * x), domain=[-1, 1], window=[-1, 1])
    wanted = [fit.deriv(n)(0.0) if n else fit(0.0) for n in range(4)]
    assert course[:4] == pytest.approx(wanted, rel=1e-5, abs=1e-7)


@grid("period, jitter", RATES, [0.0, 0.0007])
def test_a_step_takes_effect_at_once_and_nothing_goes_beyond_it(period, jitter):
    stamps = np.arange(0.0, 0.4, period)
    came = np.maximum.accumulate(stamps + np.random.default_rng(4).uniform(0.0, 2.0 * jitter, len(stamps)))
    times = np.arange(400) * PERIOD
    for at, base in ((0.2, 0.0), (0.2, -1.0)):
        got = values_of(np.where(stamps < at, base, 2.0), stamps, came, times)
        seen = times + 1e-9 >= came[np.argmax(stamps >= at)]
        assert got[seen] == pytest.approx(2.0, abs=1e-9)
        assert got[20:][~seen[20:]] == pytest.approx(base, abs=1e-9)


@given(
    st.lists(st.floats(-10.0, 10.0), min_size=2, max_size=40), st.floats(0.0005, 0.05), st.floats(0.0, 0.2)
)
def test_whatever_comes_the_result_is_within_the_limit_and_ends_at_the_newest(commands, interval, late):
    stamps = np.arange(len(commands)) * interval
    s = course_of(commands, stamps)
    assert abs(command_course.value(P, s, stamps[-1] + late)) <= 10.0
    assert command_course.value(P, s, stamps[-1] + 100.0) == commands[-1]


@pytest.mark.parametrize(
    "intervals",
    [(0.0013, 0.0007), (0.001, 0.001, 0.002), (1e-6, 0.001), (2e-4, 2e-4, 2e-4, 0.0034), (0.0001, 0.0019)],
)
def test_commands_at_uneven_times_are_followed_for_ever(intervals):
    """As of two senders, bursts, or a rate that the sender's clock does not divide."""
    stamps = np.cumsum(np.resize(intervals, 12000))
    commands = np.sin(2.0 * math.pi * 3.0 * stamps)
    s, errors = None, []
    for command, stamp in zip(commands.tolist(), stamps.tolist(), strict=True):
        s = command_course.taken(P, s, command, stamp, stamp)
        got = command_course.value(P, s, stamp + 0.001)
        errors.append(got - math.sin(2.0 * math.pi * 3.0 * (stamp + 0.001)))
    assert np.max(np.abs(errors)) < 0.25 and rms(np.array(errors)) < 0.02  # NaN is neither


@given(st.floats(0.0, 0.02), st.floats(0.001, 0.02))
def test_the_horizon_has_the_derivatives_that_it_says_and_no_kink(bridge, interval):
    until = command_course.LATE * interval + bridge
    for time in (0.5 * until, until, 1.3 * until, 3.0 * until):
        h = 1e-5 * until
        before, here, after = (command_course.horizon(bridge, interval, time + i * h) for i in (-1, 0, 1))
        assert (after.time - before.time) / (2.0 * h) == pytest.approx(here.rate, abs=1e-3)
        assert until * (after.rate - before.rate) / (2.0 * h) == pytest.approx(until * here.bend, abs=1e-3)
    assert command_course.horizon(bridge, interval, 11.1 * until).time == 0.0


@pytest.mark.parametrize("elapsed", [0.0, -0.01, LONGEST * 1.01, -LONGEST * 1.01])
def test_a_command_of_the_same_time_or_of_another_course_counts_at_once(elapsed):
    s = course_of([1.0, 2.0], [1.0, 1.0 + elapsed])
    assert command_course.value(P, s, s.sent) == 2.0


def test_a_driver_that_stood_still_beside_a_spool_at_rest_leaves_the_course_where_it_belongs():
    """For 10 ms no reading comes, and no number is missing: within 50 ms commands count at the right time."""
    supervisor = made(controller="arc", lvdt__disturbance=0.0)
    number, last = 0, 1999
    for k in range(2060):
        stands = last < k < last + 10
        since = 0.0005 + PERIOD * max(0, min(k, last + 10) - last - 1) * (k <= last + 10)
        supervisor.command(math.sin(9.0 * k * PERIOD), 1.0 + k * PERIOD, since)
        if not stands:
            number += 1
            supervisor.sample(0.001 * (k % 3), number, 0.01 if k == last + 10 else PERIOD)
    assert supervisor.memory.command.value == pytest.approx(math.sin(9.0 * (k + 0.5) * PERIOD), abs=0.03)


CASES = {
    "two clocks": Delivery(0.001, 0.0007, drift=1e-3),
    "late": Delivery(0.001, 0.0007, drift=1e-4, late=0.02),
    "pauses": Delivery(0.001, 0.0007, drift=1e-4, pause=0.006),
    "200 Hz": Delivery(0.005, 0.0007, drift=1e-4),
}


@pytest.mark.parametrize("case", CASES)
def test_the_command_is_that_of_the_motion(case):
    """5 Hz of 1 V: within 60 µs of its rate, where the newest command alone is off by milliseconds."""
    times = np.arange(4000) * PERIOD
    wanted = np.sin(2.0 * math.pi * 5.0 * times) * np.minimum(1.0, times / 0.3) ** 2
    got = delivery.received(changed.controller(**SWIFT), wanted, CASES[case])
    error = rms((got - wanted)[3 * SETTLED :])
    assert error < 2.0 * math.pi * 5.0 / math.sqrt(2.0) * 6e-5


def offsets(came, stamps):
    """Offset [s] after each message."""
    s, found = clock.NOTHING, []
    for time, stamp in zip(came, stamps, strict=True):
        s = clock.step(s, float(time), float(time - stamp))
        found.append(clock.offset(s))
    return np.array(found)


@grid("drift, jitter, period", [0.0, 1e-4, -1e-3], [0.0, 0.0001, 0.0014], [0.001, 0.01])
def test_offset_and_drift_are_found_from_the_smallest_delays(drift, jitter, period):
    stamps = np.arange(0.0, 10.0, period)
    sent = 50.0 + stamps * (1.0 + drift)
    came = np.maximum.accumulate(sent + np.random.default_rng(1).uniform(0.0, jitter, len(stamps)))
    wrong = (offsets(came, stamps) - (sent - stamps))[stamps > 6.0]
    share = 0.05 if period == 0.001 else 0.2  # of the jitter; fewer messages, a larger smallest delay
    assert np.max(np.abs(wrong)) < 1e-5 + share * jitter


@grid("pause, begin", [0.008, 0.03, 0.06], [0.0, 2.0])
def test_a_burst_after_a_standstill_moves_the_offset_for_less_than_50_ms(pause, begin):
    """With the line of before, or with one that begins with the burst."""
    stamps = np.arange(begin, 4.0, 0.001)
    delays = np.random.default_rng(1).exponential(1e-4, len(stamps))
    came = np.where(stamps < 2.0, stamps, np.maximum(stamps, 2.0 + pause)) + delays
    came = np.maximum.accumulate(came) + 1e-9 * np.arange(len(stamps))
    wrong = np.abs(offsets(came, stamps))
    assert np.max(wrong[stamps > 2.05 + pause]) < 1e-4


@pytest.mark.parametrize("leap", [-3600.0, -0.03, 0.03, 3600.0])
def test_a_clock_that_is_set_is_followed(leap):
    """At once where it was set by more than LEAP; otherwise within two windows."""
    stamps = np.arange(0.0, 4.0, 0.001)
    sent = stamps + np.where(stamps < 2.0, 0.0, leap)
    wrong = np.abs(offsets(sent, stamps) - (sent - stamps))
    settled = 2.0 if leap < -clock.LIMIT or leap > clock.LEAP else 3.2
    assert np.max(wrong[stamps > settled]) < 1e-3
