# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Commands of an upper level that is slower than the loop: what the law and the valve get of them."""

import math

import numpy as np
import pytest
from grids import grid
from hypothesis import given
from hypothesis import strategies as st
from slow import PERIOD, bare, lag, run, settings

from valve_control.control.analysis.indices import rms
from valve_control.control.laws import registry
from valve_control.control.parameters import build
from valve_control.control.supervision import command_course, late_commands
from valve_control.control.supervision.record import Mode
from valve_control.control.supervision.supervisor import Supervisor

LAWS = ("arc", "oarc", "pid", "compensator", "open_loop")
LINEAR = command_course.Params(False, 10.0, PERIOD)
EXTRAPOLATE = command_course.Params(True, 10.0, PERIOD)


def followed(p, commands, every, until, jitter=()):
    """Values at the samples, of commands ``every`` samples apart, each so many samples late."""
    late = [0, *jitter, *([0] * len(commands))]
    arrivals = {i * every + late[i]: i for i in range(len(commands))}
    s, got, last = None, [], None
    for k in range(until):
        if k in arrivals:
            i = arrivals[k]
            interval = 0.0 if last is None else (i - last) * every * PERIOD
            s = command_course.taken(p, s, commands[i], interval, k * PERIOD)
            last = i
        got.append(command_course.value(s, k * PERIOD))
    return np.array(got)


@grid("law, every, jitter", LAWS, [5, 10], [0.0, 0.0007])
def test_there_is_no_staircase_in_the_voltage(law, every, jitter):
    assert set(registry.LAWS) >= set(LAWS)
    fast = run(bare(), 1, controller=law)
    stairs = run(bare(), every, jitter=jitter, controller=law)
    for kind in ("linear", "extrapolate"):
        joined = run(bare(), every, jitter=jitter, controller=law, command__interpolation=kind)
        assert joined.supervisor.mode is Mode.OK
        assert joined.chatter < 1.3 * fast.chatter
        assert joined.chatter < stairs.chatter


@grid("law, every, lead", ["oarc", "dcarc"], [5, 10], [0.005, 0.016])
def test_a_lead_of_joined_commands_has_no_corners(law, every, lead):
    """Lead for the reshaping alone, and for the lag of the line too."""
    changes = {"controller": law, "reshaping__lead": lead}
    fast = run(bare(), 1, **changes)
    for kind in ("linear", "extrapolate"):
        joined = run(bare(), every, command__interpolation=kind, **changes)
        assert joined.chatter < 1.3 * fast.chatter
    if lead < 0.01:  # less than the lag that there is to make up for
        linear = run(bare(), every, command__interpolation="linear", **changes)
        without = run(bare(), every, controller=law, command__interpolation="linear")
        assert linear.error < without.error - 0.6 * lead * rms(np.gradient(fast.wanted, PERIOD))


def test_a_step_that_is_joined_has_no_lead():
    values = settings(controller="dcarc", command__interpolation="linear", reshaping__lead=0.01)
    supervisor = Supervisor()
    supervisor.apply(values, build.law_params(values))
    got = []
    for k in range(60):
        if k % 10 == 0:
            supervisor.command(0.05 if k < 25 else 0.15, 0.01 if k else 0.0)
        supervisor.sample(0.05 + 0.001 * (k % 3), k + 1)
        got.append(supervisor.telemetry()[2])
    assert 0.149 < max(got) <= 0.15 + 1e-12  # what is left of the takeover's offset is below it
    assert min(got) >= 0.05 - 1e-12


@pytest.mark.parametrize("every", [5, 10])
def test_the_lag_is_that_of_the_documentation(every):
    """hold: half a command period less half a sample; linear: one and a sample; extrapolate: nearly none."""
    period = every * PERIOD
    expected = {"hold": 0.5 * (period - PERIOD), "linear": period + PERIOD}
    for kind, seconds in expected.items():
        made = run(bare(), every, controller="open_loop", command__interpolation=kind)
        assert lag(made) == pytest.approx(seconds, abs=1e-4)
    made = run(bare(), every, controller="open_loop", command__interpolation="extrapolate")
    assert 0.0 <= lag(made) < 0.15 * period


def test_a_line_is_followed_at_its_slope_and_without_lag_if_extrapolated():
    ramp = [0.1 * i for i in range(40)]
    exact = 0.01 * np.arange(390)
    linear = followed(LINEAR, ramp, 10, 390)
    assert np.allclose(exact[50:] - linear[50:], 0.01 * 11, atol=1e-12)
    assert np.allclose(followed(EXTRAPOLATE, ramp, 10, 390)[200:], exact[200:], atol=1e-9)


def test_commands_that_come_unevenly_bend_the_course_little():
    """One that comes a sample late finds the line not at its end: the slope stays within 15 %."""
    ramp = [0.1 * i for i in range(60)]
    late = np.random.default_rng(3).integers(0, 2, 59).tolist()
    slopes = np.diff(followed(LINEAR, ramp, 10, 580, late))[100:] / 0.01
    assert np.all(np.abs(slopes - 1.0) < 0.15)


@given(st.lists(st.floats(-10.0, 10.0), min_size=2, max_size=40), st.integers(1, 30))
def test_linear_never_leaves_what_was_commanded_and_ends_at_the_last(commands, every):
    got = followed(LINEAR, commands, every, every * len(commands) + 3)
    assert np.all(got <= max(commands) + 1e-12) and np.all(got >= min(commands) - 1e-12)
    assert got[-1] == commands[-1]


@given(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0), st.integers(1, 30))
def test_a_step_is_not_gone_beyond(before, after, every):
    got = followed(EXTRAPOLATE, [before] * 5 + [after] * 5, every, 11 * every + 3)
    assert np.all(got <= max(before, after) + 1e-12) and np.all(got >= min(before, after) - 1e-12)
    assert got[-1] == pytest.approx(after, abs=1e-12)


@given(st.lists(st.floats(-10.0, 10.0), min_size=2, max_size=40), st.integers(1, 30))
def test_extrapolation_stays_within_the_command_limit(commands, every):
    assert np.all(np.abs(followed(EXTRAPOLATE, commands, every, every * len(commands) + 5)) <= 10.0)


@pytest.mark.parametrize("interval", [0.0, -0.01, late_commands.LONGEST * 1.01, math.inf])
def test_a_command_without_a_time_to_join_it_by_counts_at_once(interval):
    s = command_course.taken(LINEAR, None, 1.0, 0.0, 0.0)
    s = command_course.taken(LINEAR, s, 2.0, interval, 0.01)
    assert command_course.value(s, 0.01) == 2.0


def test_a_change_of_interpolation_is_in_force_at_once_and_holds_the_command():
    values = settings(controller="open_loop", command__interpolation="linear")
    supervisor = Supervisor()
    supervisor.apply(values, build.law_params(values))
    supervisor.command(0.05)
    supervisor.sample(0.0, 1)
    supervisor.command(0.15, 0.01)
    for k in range(2, 8):
        supervisor.sample(0.001 * k, k)
    assert 0.05 < supervisor.command_in_force < 0.15
    supervisor.apply(settings(controller="open_loop"), build.law_params(values))
    held = supervisor.command_in_force
    supervisor.sample(0.008, 8)
    assert supervisor.command_in_force == held and supervisor.memory.course is None


def test_lost_readings_leave_the_course_where_it_belongs():
    """The course goes by time: after five lost readings it is as far as without them."""
    found = []
    for lost in (range(0), range(12, 17)):
        values = settings(controller="arc", command__interpolation="linear")
        supervisor = Supervisor()
        supervisor.apply(values, build.law_params(values))
        for k in range(20):
            if k in (0, 10):
                supervisor.command(0.05 + 0.01 * k, 0.01 if k else 0.0)
            if k not in lost:
                supervisor.sample(0.001 * (k % 3), k + 1)
        found.append(supervisor.command_in_force)
    assert found[0] == pytest.approx(found[1], abs=1e-12)
    assert 0.05 < found[0] < 0.15
