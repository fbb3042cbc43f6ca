# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""An axis in a bag: a bench simulated offline, recorded as its nodes publish it, and analysed."""

import json

import numpy as np
import pytest
from made import BEGIN, EVENT, FLOAT, PERIOD, STORE, Message, Run, T, event, write

from valve_control.cli import main
from valve_control.control.axis import run as axis_run
from valve_control.control.axis.axis_parameters import AXIS_NODES
from valve_control.control.parameters import files
from valve_control.parameter import updated
from valve_control.recordings.bags.writer import BagWriter

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


MACHINE = {
    "cylinder.area_a": 1.25e-3,
    "cylinder.area_b": 7.6e-4,
    "supply.kind": "constant",
    "supply.pressure": 140e5,
    "relief.pressure": 140e5,
}


def small(folder, machine=MACHINE, rooms="ab", pressure=1e6, joints=JOINTS, fast=lambda k: True):
    """The valve's own topics, and an axis that moves out by 0.1 m/s, exactly at its goal."""
    valve = Run(seed=1)
    valve.move(50)
    valve.flush()
    messages = list(valve.messages)

    def add(topic, kind, time, message):
        data = bytes(STORE.serialize_cdr(message, kind)) if kind != EVENT else message
        messages.append(Message(topic, kind, time, 0, data, time))

    add("/parameter_events", EVENT, BEGIN, event("/axis_simulator", machine, new=True))
    for k in range(50):
        time = BEGIN + k * PERIOD
        header = T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](time // 10**9, time % 10**9), "")
        position = np.array([0.25 + 1e-4 * k])
        joint = T[JOINTS](header, ["axis"], position, np.array([]), np.array([]))
        add("/joint_states", joints, time, joint if joints == JOINTS else T[FLOAT](1.0))
        for room in rooms:
            add(f"/pressure_{room}", FLUID, time, T[FLUID](header, pressure, 0.0))
        speed = np.array([0.1]) if fast(k) else np.array([])
        after = T["builtin_interfaces/msg/Duration"](time // 10**9, time % 10**9)
        add("/axis_goal", POINT, time, T[POINT](position, speed, np.array([]), np.array([]), after))
    return write(folder / "bag", messages)


def analysed(bag, capsys):
    """The axis in JSON, and what the terminal says of it."""
    assert main(["analyze", str(bag), "--json", str(bag.parent / "a.json")]) == 0
    said = capsys.readouterr().out
    return json.loads((bag.parent / "a.json").read_text())["axes"][""], said[said.index("axis /") :]


def test_energy_of_a_steady_motion(tmp_path, capsys):
    axis, said = analysed(small(tmp_path), capsys)
    way = 49e-4
    assert axis["supplied_J"] == pytest.approx(140e5 * 1.25e-3 * way)
    assert axis["work_J"] == pytest.approx(1e6 * (1.25e-3 - 7.6e-4) * way)
    assert axis["e_max_m"] == 0.0 and axis["speed_max_m_s"] == 0.1 and "note" not in said


def test_without_pressures_of_a_room_there_is_no_work(tmp_path, capsys):
    """Readings that are no numbers ended in a traceback; a room without readings in "nan J"."""
    for name, options in (("nan", {"pressure": np.nan}), ("room", {"rooms": "a"})):
        (tmp_path / name).mkdir()
        axis, said = analysed(small(tmp_path / name, **options), capsys)
        assert axis["work_J"] is None and axis["supplied_J"] > 0.0
        assert "J from the supply\n" in said and "nan J" not in said


def test_a_machine_that_is_known_in_part_has_no_energy(tmp_path, capsys):
    """A recorder that joins late has some of the parameters; that was a traceback."""
    part = {name: value for name, value in MACHINE.items() if not name.startswith("supply")}
    axis, said = analysed(small(tmp_path, machine=part), capsys)
    assert axis["work_J"] is None and axis["supplied_J"] is None and axis["readings"] == 50
    assert "no supply.kind, supply.pressure of /axis_simulator, so no energy" in said


def test_the_speed_is_that_of_the_goals_that_have_one(tmp_path, capsys):
    assert analysed(small(tmp_path, fast=lambda k: k % 2 == 1), capsys)[0]["speed_max_m_s"] == 0.1


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
