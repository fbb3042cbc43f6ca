# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The upper level's supervision, sample by sample, and the motion of the spool that it asks for."""

import math
import re

import changed
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valve_control.axis import axis_pid, axis_watch, course, path
from valve_control.axis import axis_supervisor as supervisor
from valve_control.axis.axis_parameters import AXIS_CONTROLLER
from valve_control.axis.course import Goal
from valve_control.axis.machine import Reading
from valve_control.control.supervision.memory import Mode
from valve_control.parameter import ParameterError

MS = 1_000_000
LIMITS = course.MotionLimits(0.25, 2.0, 40.0)


def designed(**changes):
    return supervisor.design(changed.values(AXIS_CONTROLLER, **{"machine": "bench", "kp": 8.0, **changes}))


def sample(p, s, position, k):
    return supervisor.sample(p, s, Reading(math.nan, position, math.nan, math.nan), k * MS)


def under_way(p, able, end):
    """State before sample ``end`` of a motion from 0.2 m to 0.3 m that the axis follows exactly."""
    s = sample(p, supervisor.at_rest(p), 0.2, 1)
    s = supervisor.begin(s, path.towards(0.3, s.goal, LIMITS, able), None)
    for k in range(2, end):
        s = sample(p, s, s.goal.position, k)
    return s


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"machine": ""}, "machine is empty; it must name a file in config/axis"),
        ({"sample_period": 0.002}, "sample_period is 0.001 s for the machine 'bench' and 0.002 s for axis_"),
        ({"overlap": 10.0, "spool_limit": 5.0}, "overlap is 10 V, no less than spool_limit, 5 V"),
    ],
)
def test_values_that_do_not_go_together_are_refused(changes, sentence):
    with pytest.raises(ParameterError, match=re.escape(sentence)):
        designed(**changes)


def test_without_a_goal_it_holds_the_first_position_and_follows_a_path_to_the_last_bit():
    p, able = designed()
    rows = course.point_to_point(0.2, [0.3], 0.05, LIMITS, 0.001, 1.0)
    s = sample(p, supervisor.at_rest(p), 0.2001, 1)
    assert s.goal == (0.2001, 0.0, 0.0) and s.command == 0.0
    made = path.through([path.PathPoint(*row, k * MS) for k, row in enumerate(rows)], s.goal, able)
    s = supervisor.begin(s, made, None)
    upper, position = s.upper, 0.2
    for k, row in enumerate(rows):
        reading = Reading(math.nan, position, math.nan, math.nan)
        s = sample(p, s, position, k + 2)
        command, upper, _ = axis_pid.step(p.upper, upper, Goal(*row), reading)
        assert s.goal == tuple(row) and s.command == command
        position = row[0] + 1e-4 * math.sin(0.01 * k)
    assert supervisor.mode(s) == (Mode.OK, "holds its position")


def test_a_trajectory_that_begins_later_leaves_the_motion_before_it_alone_until_then():
    p, able = designed()
    s = under_way(p, able, 302)
    assert s.goal.velocity > 0.1
    at, before = 401 * MS, s
    then = supervisor.present(s, at)
    for k in range(302, 402):
        before = sample(p, before, before.goal.position, k)
    assert then == before.goal and then != s.goal
    points = [path.PathPoint(0.35, 0.0, None, 1000 * MS)]
    s = supervisor.begin(s, path.through(points, then, able), at)
    positions, velocities = [], []
    for k in range(302, 1502):
        s = sample(p, s, s.goal.position, k)
        positions.append(s.goal.position)
        velocities.append(s.goal.velocity)
    assert positions[99] == before.goal.position
    assert s.path is None and s.goal == (0.35, 0.0, 0.0)
    mean = 0.5 * (np.array(velocities)[1:] + np.array(velocities)[:-1])
    assert np.max(np.abs(np.diff(positions) / p.period - mean)) < 1e-3


def test_an_axis_at_rest_waits_for_the_beginning_of_its_path():
    p, able = designed()
    s = sample(p, supervisor.at_rest(p), 0.2, 1)
    s = supervisor.begin(s, path.towards(0.3, s.goal, LIMITS, able), 50 * MS)
    for k in range(2, 60):
        s = sample(p, s, s.goal.position, k)
        assert (s.goal.position > 0.2) == (k > 50)


@pytest.mark.parametrize(("lost", "periods"), [(None, 1), (0, 1), (2, 3), (3, 1)])
def test_a_reading_without_a_stamp_counts_the_lost_ones_that_can_be_bridged(lost, periods):
    p, _ = designed(sensor__hold_samples=2)
    s = sample(p, supervisor.at_rest(p), 0.2, 1)
    assert supervisor.unstamped(p, s, lost) == s.time + periods * MS


@pytest.mark.parametrize("leap", [-5000, 5000])
def test_a_path_goes_on_where_the_clock_of_the_readings_is_set(leap):
    p, able = designed()
    runs = []
    for by in (0, leap):
        s = sample(p, supervisor.at_rest(p), 0.2, 10_000)
        s = supervisor.begin(s, path.towards(0.3, s.goal, LIMITS, able), None)
        goals = []
        for k in range(1, 800):
            s = sample(p, s, s.goal.position, 10_000 + k + (by if k > 300 else 0))
            goals.append(s.goal)
        assert s.path is None and s.goal == (0.3, 0.0, 0.0) and not s.stopped
        runs.append(np.array(goals))
    assert np.max(np.abs(runs[1] - runs[0])) < 1e-9


def test_a_trajectory_of_the_past_whose_present_point_is_far_away_is_refused():
    p, able = designed(start_tolerance=0.002)
    s = sample(p, supervisor.at_rest(p), 0.2, 1000)
    made = path.through([path.PathPoint(0.3, 0.0, None, 1000 * MS)], s.goal, able)
    assert supervisor.begin(s, supervisor.joining(s, made, 950 * MS, able), 950 * MS).path is made
    again = supervisor.found(p, supervisor.reset(p, s), 0.2, 1000 * MS)  # not sampled yet
    with pytest.raises(ParameterError, match="the trajectory began 0.5 s ago"):
        supervisor.joining(again, made, 500 * MS, able)
    with pytest.raises(ParameterError) as error:
        supervisor.joining(s, made, 500 * MS, able)
    assert str(error.value) == (
        "the trajectory began 0.5 s ago and is now 0.05 m from the present goal at 0.2 m; 0.002 m are allowed"
    )


@given(st.lists(st.sampled_from(["sound", "jump", "nan", "beyond"]), max_size=60))
def test_wrong_readings_never_reach_the_upper_level_and_too_many_in_a_row_stop_it(kinds):
    p, _ = designed(sensor__hold_samples=2)
    s = sample(p, supervisor.at_rest(p), 0.2, 1)
    values = {"sound": 0.2, "jump": 0.3, "nan": math.nan, "beyond": 0.6}
    in_a_row, expected = 0, False
    for k, kind in enumerate(kinds):
        s = sample(p, s, values[kind], k + 2)
        in_a_row = 0 if kind == "sound" else in_a_row + 1
        expected = expected or in_a_row > 2
        assert s.command == 0.0 and bool(s.stopped) == expected
        assert supervisor.mode(s)[0] is (Mode.SAFE if expected else Mode.DEGRADED if in_a_row else Mode.OK)


def run_away(p, stamps, numbers):
    """Rates of the error [m/s] of an axis that runs away from its goal at 0.01 m/s; ``stamps`` in periods."""
    s, rates, before = supervisor.at_rest(p), [], None
    for k, stamp in enumerate(stamps):
        number = numbers[k] if numbers else None
        lost = None if number is None or before is None else number - before - 1
        before = number
        reading = Reading(math.nan, 0.2 + 0.01 * round(stamp) * p.period, math.nan, math.nan)
        s = supervisor.sample(p, s, reading, round(stamp * MS), lost)
        rates.append(s.upper.error.velocity)
    return rates


def test_a_late_stamp_is_no_lost_reading_where_readings_have_numbers():
    """A lost reading is stepped over, a stamp 0.45 periods late after one 0.1 early is not."""
    p, _ = designed(error_limit=0.0)
    regular = [float(k) for k in range(1, 200)]
    late = list(regular)
    late[100], late[101] = late[100] - 0.1, late[101] + 0.45
    exact = run_away(p, regular, None)
    assert run_away(p, late, None)[101] != pytest.approx(-0.01, rel=1e-3)
    assert run_away(p, late, list(range(1, 200))) == exact
    without = run_away(p, regular[:100] + regular[101:], [*range(1, 101), *range(102, 200)])
    assert without[100] == pytest.approx(-0.01, rel=1e-6)


def test_an_axis_that_does_not_follow_is_stopped_and_reset_holds_where_it_is():
    p, able = designed(error_limit=0.01)
    s = sample(p, supervisor.at_rest(p), 0.2, 1)
    s = supervisor.begin(s, path.towards(0.3, s.goal, LIMITS, able), None)
    k = 1
    while not s.stopped:
        k += 1
        s = sample(p, s, 0.2, k)
    assert s.stopped.startswith("the position is 0.01") and "error_limit is 0.01 m" in s.stopped
    assert s.command == 0.0 and supervisor.present(s) is None
    s = sample(p, supervisor.reset(p, s), 0.25, k + 1)
    assert s.goal == (0.25, 0.0, 0.0) and not s.stopped


@pytest.mark.parametrize("gains", [{}, {"ki": 5.0}, {"acceleration_feedforward": 0.01}])
def test_the_spools_velocity_and_acceleration_are_the_derivatives_of_its_command(gains):
    """Behind the overlap, on a course without leaps of its jerk; the axis stays 1 mm behind its goal."""
    p, _ = designed(overlap_zone=1e-4, **gains)
    period = p.period
    t = np.arange(1000) * period
    w = 2.0 * np.pi
    x = 0.2 + 0.02 * (t - np.sin(w * t) / w)
    v, a, j = 0.02 * (1.0 - np.cos(w * t)), 0.02 * w * np.sin(w * t), 0.02 * w**2 * np.cos(w * t)
    s, found = axis_pid.initial(p.upper), []
    for row in zip(x, v, a, j, strict=True):
        goal = Goal(*row[:3])
        _, s, terms = axis_pid.step(p.upper, s, goal, Reading(0.0, row[0] - 0.001, 0.0, 0.0))
        found.append(axis_pid.motion(p.upper, s, goal, row[3], terms))
    spool, rate, acceleration = np.array(found)[100:].T
    assert np.max(np.abs(np.gradient(spool, period) - rate)[1:-1]) < 0.01 * np.max(np.abs(rate))
    if not gains:
        assert np.max(np.abs(np.gradient(rate, period) - acceleration)[1:-1]) < 0.02 * np.max(
            np.abs(acceleration)
        )


def test_with_pressures_that_cannot_be_believed_axis_arc_is_stopped_and_axis_pid_is_not():
    for level, stops in (("axis_pid", False), ("axis_arc", True)):
        p, _ = designed(upper_level=level, sensor__hold_samples=2)
        assert stops == p.level.NEEDS_PRESSURES
        s = supervisor.at_rest(p)
        for k in range(1, 20):
            s = supervisor.sample(p, s, Reading(math.nan, 0.2, 50e5, 80e5), k * MS)
            assert not s.stopped and abs(s.command) <= 10.0
        command = s.command
        for k, wrong in enumerate((math.nan, 80e5 + 9e7, math.inf), 20):
            assert s.command == command
            s = supervisor.sample(p, s, Reading(math.nan, 0.2, 50e5, wrong), k * MS)
        assert bool(s.stopped) == stops and (s.command == 0.0 or not stops)
        assert set(supervisor.estimates(p, s)) == ({"mass_kg", *LEARNT} if stops else set())


def test_a_jump_of_a_pressure_is_a_fault_unless_wrong_readings_left_it_time():
    p, _ = designed(sensor__pressure_jump=20e5)
    known = axis_watch.State(0.2, (50e5, 80e5), 0.0, 0)
    assert axis_watch.pressure_fault(p.watch, known, (50e5, 110e5)) == "pressure b jumps by 30 bar"
    assert axis_watch.pressure_fault(p.watch, known._replace(wrong=1), (50e5, 110e5)) == axis_watch.SOUND


LEARNT = ("damping_Ns_m", "coulomb_N", "force_N", "bulk_modulus_Pa")


def test_silence_stops_an_axis_that_has_been_seen_and_no_other():
    p, _ = designed()
    unseen = supervisor.at_rest(p)
    waiting = supervisor.mode(supervisor.silent(unseen, "silence"))
    assert waiting == (Mode.DEGRADED, "no position reading yet")
    assert supervisor.spool_motion(p, unseen) == (0.0, 0.0, 0.0)
    s = supervisor.silent(sample(p, unseen, 0.2, 1), "silence")
    assert supervisor.mode(s) == (Mode.SAFE, "stopped, 0 V: silence")
    assert supervisor.spool_motion(p, s) == (0.0, 0.0, 0.0)
    assert supervisor.found(p, s, 0.3).goal == s.goal and sample(p, s, 0.2, 2).command == 0.0


def test_a_path_that_began_a_moment_ago_replaces_the_one_in_motion_and_goes_on_from_there():
    p, able = designed()
    s = under_way(p, able, 100)
    new = path.towards(0.35, s.goal, LIMITS, able)
    for at in (None, 99 * MS, 150 * MS):  # no reading of the past is asked for
        assert supervisor.joining(s, new, at, able) is new
    assert supervisor.begin(s, new, None).begun == s.time == 99 * MS
    s = supervisor.begin(s, new, 95 * MS)
    assert s.path is new and s.begun == 95 * MS and s.later is None
    s = sample(p, s, s.goal.position, 100)
    assert s.goal == path.goal_of(new, 5 * MS)


def test_a_command_that_is_no_number_stops_the_axis():
    p, able = designed()
    p = p._replace(upper=p.upper._replace(kp=math.inf))
    s = supervisor.begin(supervisor.at_rest(p), path.towards(0.3, Goal(0.2, 0.0, 0.0), LIMITS, able), None)
    s = sample(p, s, 0.2, 1)
    assert supervisor.mode(s) == (Mode.SAFE, "stopped, 0 V: the upper level's command is nan")
    assert s.command == 0.0 and supervisor.spool_motion(p, s) == (0.0, 0.0, 0.0)
