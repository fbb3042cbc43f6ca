# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Courses and paths of an axis, the cascade that follows them, and its machines."""

import json
import math

import changed
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valve_control.axis import course, path, run
from valve_control.axis.axis_parameters import AXIS_NODES
from valve_control.axis.course import Goal
from valve_control.cli import main
from valve_control.control.parameters import files, ros_file
from valve_control.parameter import ParameterError, updated

ABLE = path.Range(0.0, 0.5, 0.7, 0.5, 0.002)
REST = Goal(0.2, 0.0, 0.0)
MS = 1_000_000
LIMITS = course.MotionLimits(0.25, 2.0, 40.0)


def points(*rows):
    return [path.PathPoint(*row[:3], row[3] * MS) for row in rows]


@given(
    st.lists(
        st.tuples(st.floats(0.15, 0.25), st.floats(-0.05, 0.05), st.floats(-0.5, 0.5)), min_size=1, max_size=6
    ),
    st.integers(0, 2),
)
def test_between_points_the_derivatives_are_derivatives_and_nothing_leaps(rows, known):
    """With accelerations, with velocities alone, or without either."""
    given_points = [
        path.PathPoint(x, v if known > 0 else None, a if known > 1 else None, 100 * MS * (k + 1))
        for k, (x, v, a) in enumerate(rows)
    ]
    last = given_points[-1]
    given_points[-1] = last._replace(velocity=0.0 if known > 0 else None)
    try:
        made = path.through(given_points, REST, ABLE._replace(speed_out=5.0, speed_in=5.0))
    except ParameterError as error:
        assert "outside the stroke" in str(error)
        return
    assert path.goal_of(made, 0)[:2] == REST[:2]
    for p in given_points[:-1]:
        goal = path.goal_of(made, p.time)
        assert goal.position == p.position
        assert known == 0 or goal.velocity == p.velocity
        assert known < 2 or goal.acceleration == pytest.approx(p.acceleration)
    times = np.arange(0, made.end, MS // 2)
    x, v, a = np.array([path.goal_of(made, int(t)) for t in times]).T
    assert np.max(np.abs(np.diff(x) - 0.00025 * (v[1:] + v[:-1]))) < 1e-6
    if known == 2:
        assert np.max(np.abs(np.diff(v) - 0.00025 * (a[1:] + a[:-1]))) < 1e-3


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([], "0 points"),
        (
            [(0.2, None, None, 0), (0.6, None, None, 1000)],
            "point 1 of the trajectory is at 0.6 m, outside the stroke",
        ),
        ([(0.2, None, None, 0), (math.nan, None, None, 1000)], "point 1 of the trajectory has numbers"),
        ([(0.2, None, None, 5), (0.3, None, None, 5)], "do not rise"),
        ([(0.21, None, None, 0), (0.3, None, None, 1000)], "begins 0.01 m from the present goal at 0.2 m"),
        ([(0.2, None, None, 0), (0.3, None, None, 100)], "1.5 m/s outwards; the axis has 0.7 m/s"),
        ([(0.3, None, None, 1000), (0.2, None, None, 1100)], "inwards; the axis has 0.5 m/s"),
        ([(0.2, 0.0, None, 0), (0.3, 0.1, None, 1000)], "ends with 0.1 m/s; it must end at rest"),
        ([(0.2, 0.0, None, 0), (0.01, -0.4, None, 800), (0.01, 0.0, None, 1600)], "reaches -"),
        (
            [(0.2, 0.0, None, 0), (0.2, 1e308, None, 9000), (0.2, 0.0, None, 9999)],
            "numbers that are too large",
        ),
    ],
)
def test_what_is_no_path_is_refused_in_one_sentence(rows, words):
    with pytest.raises(ParameterError) as error:
        path.through(points(*rows), REST, ABLE)
    assert words in str(error.value), error.value


@pytest.mark.parametrize("whole", [True, False], ids=["quintic", "cubic"])
def test_a_course_between_two_points_is_refused_if_and_only_if_it_leaves_stroke_or_speeds(whole):
    random, wide, outcomes = np.random.default_rng(1), path.Range(-9.0, 9.0, 99.0, 99.0, 0.002), []
    for _ in range(300):
        there = random.uniform(0.3, 0.5), random.uniform(-0.5, 0.5), random.uniform(-2.0, 2.0)
        time = int(random.uniform(300.0, 3000.0))
        rows = [(0.3, 0.0, 0.0, 0), (*there, time), (0.3, 0.0, 0.0, time + 1500)]
        course_points = [p if whole else p._replace(acceleration=None) for p in points(*rows)]
        start = Goal(0.3, 0.0, 0.0)
        free = path.through(course_points, start, wide)
        x, v = np.array([path.goal_of(free, int(t))[:2] for t in np.linspace(0, free.end, 400)]).T
        most = max(x.max() - 0.5, -x.min(), v.max() - ABLE.speed_out, -v.min() - ABLE.speed_in)
        try:
            path.through(course_points, start, ABLE)
            assert most <= 1e-9
        except ParameterError:
            assert most > -1e-3  # its extreme lies between these looks
        outcomes.append(most > 0.0)
    assert 30 < sum(outcomes) < 270


@pytest.mark.parametrize("present", [REST, Goal(0.2, 0.2, 1.0), Goal(0.3, -0.1, 0.0)])
def test_a_goal_is_reached_from_any_motion_within_the_limits(present):
    made = path.towards(0.25, present, LIMITS, ABLE)
    times = np.arange(0, made.end + MS, MS)
    x, v, a = np.array([path.goal_of(made, int(t)) for t in times]).T
    assert (x[0], v[0]) == pytest.approx(present[:2], abs=1e-12)
    assert tuple(path.goal_of(made, made.end)) == (0.25, 0.0, 0.0)
    assert np.max(np.abs(v)) <= 0.25 + 1e-9 and np.max(np.abs(a)) <= 2.0 + 1e-9
    assert np.max(np.abs(np.diff(x))) < 0.25 * 0.001 * 1.01


def test_goals_that_cannot_be_reached_are_refused():
    for target, words in ((0.51, "outside the stroke"), (math.nan, "must be finite")):
        with pytest.raises(ParameterError, match=words):
            path.towards(target, REST, LIMITS, ABLE)
    with pytest.raises(ParameterError, match=r"the motion to 0.499 m reaches 0.5\d+ m, outside the stroke"):
        path.towards(0.499, Goal(0.49, 0.25, 0.0), LIMITS, ABLE)


def test_round_distances_are_reached_though_a_profile_is_the_limit_of_two():
    """10 mm at 2 m/s² and 40 m/s³: the acceleration just reaches its limit, where ruckig finds no way."""
    for at in (0.12, 0.25, 0.3):
        for way in (0.01, -0.01, 0.02, 0.05):
            made = path.towards(at + way, Goal(at, 0.0, 0.0), LIMITS, ABLE)
            rows = course.point_to_point(at, [at + way], 0.0, LIMITS, 0.001, 1.5)
            assert rows[-1, 0] == pytest.approx(at + way, abs=1e-12)
            assert np.max(np.abs(rows[:, 2])) <= 2.0 + 1e-9
            for k in range(0, len(rows) - 1, 50):
                assert path.goal_of(made, k * MS) == pytest.approx(tuple(rows[k]), abs=1e-9)


def settings(controller="open_loop", **changes):
    """Settings by node; names with __ for a dot, given to every node that has them."""
    result = run.default_settings()
    for name, value in changed.dotted({"controller": controller, **changes}).items():
        owners = [node for node, table in AXIS_NODES.items() if any(p.name == name for p in table)]
        assert owners, name
        for node in owners:
            result[node] = updated(AXIS_NODES[node], result[node], {name: value})
    return result


NOISY = {
    "position__noise": 1e-5,
    "position__resolution": 5e-6,
    "position__delay": 0.0015,
    "pressure__noise": 1e4,
    "pressure__delay": 0.001,
    "load__coulomb": 100.0,
    "lvdt__noise": 0.005,
    "lvdt__delay": 0.0025,
}


@pytest.mark.parametrize("level", ["axis_pid", "axis_arc"])
def test_plain_python_gives_the_bits_of_a_compiled_run(level):
    made = run.setup(settings(**NOISY, upper_level=level, duration=1.5, pause=0.1, back=False))
    one = run.simulate(made)
    plain = run.simulate(made._replace(goals=made.goals[:500]), compiled=False)
    for name, signal in plain.signals.items():
        assert np.array_equal(signal, one.signals[name][:500]), name
    assert run.simulate(made).indices == one.indices  # a run leaves nothing behind
    assert one.indices.e_rms > 0.0 and one.indices.chatter > 0.0


def test_an_ideal_valve_follows_its_course_and_settles_within_its_overlap():
    """Velocity feedforward (docs/explanation/axis.md) leaves 1 % of the motion, less at rest."""
    valve = {"valve": "custom", "numerator": [3.95e5], "denominator": [1.0, 880.0, 3.95e5]}
    ideal = settings(**valve, open_loop__static_gain=1.0, duration=3.0, pause=0.2)
    ideal["axis_controller"]["back"] = False
    made = run.setup(ideal)
    found = run.simulate(made)
    assert np.ptp(found.signals["goal"]) == pytest.approx(0.1)
    assert found.indices.e_max < 0.001
    assert found.indices.e_end < 0.0005


@pytest.mark.parametrize("goals", [[0.3], [0.3, 0.1], [0.2001]])
def test_courses_keep_their_limits_and_end_at_rest(goals):
    limits = course.MotionLimits(0.25, 2.0, 40.0)
    rows = course.point_to_point(0.2, goals, 0.1, limits, 0.001, 3.0)
    x, v, a = rows.T
    assert x[0] == 0.2 and x[-1] == pytest.approx(goals[-1], abs=1e-12) and v[-1] == a[-1] == 0.0
    assert np.max(np.abs(v)) <= 0.25 + 1e-9 and np.max(np.abs(a)) <= 2.0 + 1e-9
    assert np.max(np.abs(np.diff(a))) <= 40.0 * 0.001 + 1e-9
    assert np.max(np.abs(np.diff(x) - 0.0005 * (v[1:] + v[:-1]))) < 40.0 * 0.001**3
    with pytest.raises(ParameterError, match=r"the motion to .* ends at"):
        course.point_to_point(0.2, goals, 2.99, limits, 0.001, 3.0)


def test_a_sine_begins_at_rest_and_its_derivatives_are_its_derivatives():
    x, v, a = course.sine(0.2, 0.05, 2.0, 1e-4, 2.0).T
    assert x[0] == 0.2 and v[0] == a[0] == 0.0
    assert np.max(np.abs(np.gradient(x, 1e-4)[1:-1] - v[1:-1])) < 1e-5
    assert np.max(np.abs(np.gradient(v, 1e-4)[1:-1] - a[1:-1])) < 1e-3
    assert np.max(np.abs(x - 0.2)) == pytest.approx(0.05, rel=1e-3)


def test_the_command_prints_indices_and_refuses_in_one_sentence(capfd):
    assert main(["axis", "--upper", "axis_arc", "--controller", "open_loop", "--json", "-"]) == 0
    result = json.loads(capfd.readouterr().out)
    assert result["upper_level"] == "axis_arc" and 0.0 < result["e_rms"] < 0.01
    for arguments in (
        ["--set", "offset=0.2"],  # beyond the stroke
        ["--set", "cylinder.stroke=-1"],
        ["--duration", "0.6"],  # ends before the motion
        ["--set", "course=step", "--set", "pause=5"],
        ["--upper", "axis_arc", "--set", "axis_arc.k1=600"],
        ["--set", "load.force=-1e6"],  # stalls the axis
    ):
        assert main(["axis", *arguments]) == 2, arguments
        assert capfd.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("law", ["arc", "pid"])
def test_the_lead_of_axis_arc_counts_once_whether_it_sends_commands_or_trajectories(law):
    """On the bench; counted twice, the error under arc is 1.15 times that with commands."""
    folder = ros_file.config_folder() / "axis"
    errors = {}
    for message in ("command", "trajectory"):
        for lead in (0.0005, 0.004):
            own = {"upper_level": "axis_arc", "message": message, "axis_arc.lead": lead}
            own = {"axis_controller": own, "controller": {"controller": law}}
            given = files.given([str(folder / "bench.yaml")], own, [], None, AXIS_NODES)
            base = run.default_settings()
            made = {node: updated(table, base[node], given[node]) for node, table in AXIS_NODES.items()}
            errors[message, lead] = run.simulate(run.setup(made)).indices.e_rms
    assert errors["trajectory", 0.004] < 1.05 * errors["command", 0.004]
    assert errors["trajectory", 0.004] < 1.05 * errors["trajectory", 0.0005]


@pytest.mark.parametrize("level", ["axis_pid", "axis_arc"])
@pytest.mark.parametrize("machine", ["bench", "crane_boom", "crane_arm", "press"])
def test_each_machine_moves_there_and_back_within_its_limit(machine, level):
    folder = ros_file.config_folder() / "axis"
    path = str(folder / f"{machine}.yaml")
    given = files.given([path], {"axis_controller": {"upper_level": level}}, [], None, AXIS_NODES)
    base = run.default_settings()
    made = run.setup({node: updated(table, base[node], given[node]) for node, table in AXIS_NODES.items()})
    assert np.ptp(made.goals[:, 0]) > 0.09
    found = run.simulate(made)
    assert found.indices.e_max < 0.2 * given["axis_controller"].get("error_limit", 0.05)
    assert np.min(found.signals["pressure_a"]) > made.machine.axis.vapour
