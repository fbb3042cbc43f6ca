# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""An axis in a bag: a bench simulated offline, recorded as its nodes publish it, and analysed."""

import json

import numpy as np
import pytest
from made import BEGIN, FLOAT, PERIOD, STORE, Message, Run, T, write

from valve_control.axis import run as axis_run
from valve_control.axis.axis_parameters import AXIS_NODES
from valve_control.cli import main
from valve_control.control.parameters import files, ros_file
from valve_control.parameter import updated
from valve_control.recordings.bags.writer import BagWriter

JOINTS, FLUID = "sensor_msgs/msg/JointState", "sensor_msgs/msg/FluidPressure"
POINT = "trajectory_msgs/msg/JointTrajectoryPoint"


@pytest.fixture(scope="module")
def bench():
    path = str(ros_file.config_folder() / "axis" / "bench.yaml")
    given = files.given([path], {}, [], None, AXIS_NODES)
    base = axis_run.default_settings()
    values = {node: updated(table, base[node], given[node]) for node, table in AXIS_NODES.items()}
    values["axis_controller"].update(duration=1.5, pause=0.1, back=False)
    made = axis_run.setup(values)
    return axis_run.simulate(made), made.goals


def recorded(folder, bench):
    """The valve's own topics from ``made``, and beside them the axis."""
    run, goals = bench
    valve = Run(seed=1)
    valve.move(200)
    valve.flush()
    messages = list(valve.messages)

    def add(topic, kind, time, data):
        messages.append(Message(topic, kind, time, 0, bytes(data), time))

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


def test_analyze_gives_error_and_pressures_of_the_axis(tmp_path, bench, capsys):
    run, goals = bench
    bag = recorded(tmp_path, bench)
    assert main(["analyze", str(bag), "--json", str(tmp_path / "a.json")]) == 0
    said = capsys.readouterr().out
    assert "axis /\n1500 readings over 1.499 s" in said
    axis = json.loads((tmp_path / "a.json").read_text())["axes"][""]
    error = goals[:, 0] - run.signals["measured"]
    assert axis["readings"] == 1500
    assert axis["e_rms_m"] == pytest.approx(np.sqrt(np.mean(error**2)))
    assert axis["e_max_m"] == pytest.approx(np.max(np.abs(error)))
    a = run.signals["pressure_a"]
    assert axis["pressures_Pa"]["pressure_a"] == pytest.approx([a.min(), a.max()])


def small(folder, joints=JOINTS, pressure=1e6, fast=lambda k: True):
    """The valve's own topics, and an axis that moves out by 0.1 m/s, exactly at its goal."""
    valve = Run(seed=1)
    valve.move(50)
    valve.flush()
    messages = list(valve.messages)

    def add(topic, kind, time, message):
        messages.append(Message(topic, kind, time, 0, bytes(STORE.serialize_cdr(message, kind)), time))

    for k in range(50):
        time = BEGIN + k * PERIOD
        header = T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](time // 10**9, time % 10**9), "")
        position = np.array([0.25 + 1e-4 * k])
        joint = T[JOINTS](header, ["axis"], position, np.array([]), np.array([]))
        add("/joint_states", joints, time, joint if joints == JOINTS else T[FLOAT](1.0))
        add("/pressure_a", FLUID, time, T[FLUID](header, pressure, 0.0))
        speed = np.array([0.1]) if fast(k) else np.array([])
        after = T["builtin_interfaces/msg/Duration"](time // 10**9, time % 10**9)
        add("/axis_goal", POINT, time, T[POINT](position, speed, np.array([]), np.array([]), after))
    return write(folder / "bag", messages)


def analysed(bag, capsys):
    """The axis in JSON, and what the terminal says of it."""
    assert main(["analyze", str(bag), "--json", str(bag.parent / "a.json")]) == 0
    said = capsys.readouterr().out
    return json.loads((bag.parent / "a.json").read_text())["axes"][""], said[said.index("axis /") :]


def test_topics_of_an_axis_that_cannot_be_read_leave_the_valve(tmp_path, capsys):
    """A topic of another type was 0 readings without a word; one without a definition ended the analysis."""
    axis, said = analysed(small(tmp_path, joints=FLOAT), capsys)
    assert axis["readings"] == 0 and "50 messages of /joint_states have no position[0]" in said
    valve = Run(seed=1)
    valve.move(50)
    path = tmp_path / "unknown"
    with BagWriter(path, "mcap") as writer:
        for kind, topic in {(m.type, m.topic) for m in valve.messages}:
            text, _ = STORE.generate_msgdef(kind, ros_version=2)
            writer.add_topic(topic, kind, text, STORE.hash_rihs01(kind))
        writer.add_topic("/axis_goal", "some_msgs/msg/Goal", "", "")
        for m in valve.messages:
            writer.write(m.topic, m.log_time, m.time, m.sequence, m.data)
        writer.write("/axis_goal", BEGIN, BEGIN, 1, b"\0\1\0\0" + bytes(8))
    axis, said = analysed(path, capsys)
    assert axis["readings"] == 0 and "some_msgs/msg/Goal, of which the bag has no definition" in said
