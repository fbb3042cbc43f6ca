# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The cascade of an axis: same bits compiled or not, its course, its upper level."""

import json

import changed
import numpy as np
import pytest

from valve_control.axis import course, run
from valve_control.axis.axis_parameters import AXIS_NODES
from valve_control.cli import main
from valve_control.control.parameters import files, ros_file
from valve_control.parameter import ParameterError, updated


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
