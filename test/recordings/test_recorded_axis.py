# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""An axis in a bag: a bench simulated offline, recorded as its nodes publish it, and analysed."""

import json

import numpy as np
import pytest
from made import BEGIN, EVENT, PERIOD, STORE, Message, Run, T, event, write

from valve_control.cli import main
from valve_control.control.axis import run as axis_run
from valve_control.control.parameters import files
from valve_control.control.parameters.axis_parameters import AXIS_NODES
from valve_control.parameter import updated

JOINTS, FLUID = "sensor_msgs/msg/JointState", "sensor_msgs/msg/FluidPressure"
POINT = "trajectory_msgs/msg/JointTrajectoryPoint"


@pytest.fixture(scope="module")
def bench():
    path = str(files.config_folder() / "axis" / "bench.yaml")
    given = files.given([path], {}, [], None, AXIS_NODES)
    base = axis_run.default_settings()
    values = {node: updated(table, base[node], given[node]) for node, table in AXIS_NODES.items()}
    values["axis_controller"].update(duration=1.5, pause=0.1, back=False)
    made = axis_run.setup(values)
    return values, axis_run.simulate(made), made.goals


def recorded(folder, bench, parameters=True):
    """The valve's own topics from ``made``, and beside them the axis."""
    values, run, goals = bench
    valve = Run(seed=1)
    valve.move(200)
    valve.flush()
    messages = list(valve.messages)

    def add(topic, kind, time, data):
        messages.append(Message(topic, kind, time, 0, bytes(data), time))

    if parameters:
        add("/parameter_events", EVENT, BEGIN, event("/axis_simulator", values["axis_simulator"], new=True))
    for k, goal in enumerate(goals):
        time = BEGIN + k * PERIOD
        stamp = T["builtin_interfaces/msg/Time"](time // 10**9, time % 10**9)
        header = T["std_msgs/msg/Header"](stamp, "")
        reading = np.array([run.signals["measured"][k]])
        joint = T[JOINTS](header, ["axis"], reading, np.array([]), np.array([]))
        add("/joint_states", JOINTS, time, STORE.serialize_cdr(joint, JOINTS))
        for room in "ab":
            fluid = T[FLUID](header, run.signals[f"pressure_{room}"][k], 0.0)
            add(f"/pressure_{room}", FLUID, time, STORE.serialize_cdr(fluid, FLUID))
        point = T[POINT](
            *(np.array([v]) for v in goal),
            np.array([]),
            T["builtin_interfaces/msg/Duration"](time // 10**9, time % 10**9),
        )
        add("/axis_goal", POINT, time, STORE.serialize_cdr(point, POINT))
    return write(folder / "bag", messages)


def test_analyze_gives_error_pressures_and_energy_of_the_axis(tmp_path, bench, capsys):
    _, run, goals = bench
    bag = recorded(tmp_path, bench)
    assert main(["analyze", str(bag), "--json", str(tmp_path / "a.json")]) == 0
    said = capsys.readouterr().out
    assert "axis /: 1500 readings over 1.499 s" in said and "from the supply" in said
    axis = json.loads((tmp_path / "a.json").read_text())["axes"][""]
    error = goals[:, 0] - run.signals["measured"]
    assert axis["readings"] == 1500
    assert axis["e_rms_m"] == pytest.approx(np.sqrt(np.mean(error**2)))
    assert axis["e_max_m"] == pytest.approx(np.max(np.abs(error)))
    a = run.signals["pressure_a"]
    assert axis["pressures_Pa"]["pressure_a"] == pytest.approx([a.min(), a.max()])
    force = 1.257e-3 * a - 7.66e-4 * run.signals["pressure_b"]
    work = np.sum(force * run.signals["velocity"]) * 1e-3
    assert axis["work_J"] == pytest.approx(work, rel=0.02)
    # Outwards: what the piston swept at the pressure of the relief valve.
    assert axis["supplied_J"] == pytest.approx(1.4e7 * 1.257e-3 * 0.1, rel=0.05)
    assert axis["work_J"] < axis["supplied_J"]


def test_what_is_missing_is_said(tmp_path, bench, capsys):
    bag = recorded(tmp_path, bench, parameters=False)
    assert main(["analyze", str(bag), "--from", "0.05", "--to", "0.15"]) == 0
    said = capsys.readouterr().out
    assert "axis /: 10" in said and "no parameters of axis_simulator, so no energy" in said
