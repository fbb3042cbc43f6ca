# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A valve learnt from normal operation: what that tells is right, what it does not tell is left alone."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from said import sentences

from benchmarks.supervised import SupervisedValve
from valve_control.control.parameters import build, files
from valve_control.control.parameters.table import VALVE
from valve_control.control.simulation.robustness import BOX
from valve_control.design.commissioning import recorded
from valve_control.design.identification.experiment import Experiment
from valve_control.parameter import ParameterError, defaults, updated

sys.path.append(str(Path(__file__).parents[1] / "recordings"))
from made import Run, write

TRUE = {
    "gain_scale": 1.15,
    "friction.coulomb": 0.7,
    "disturbance.offset": 0.4,
    "lvdt.noise": 0.004,
    "lvdt.delay": 0.001,
}


def operated(wanted, controller="oarc"):
    """A recording in lockstep: that law on the true valve."""
    made = Run(controller={"controller": controller, "lockstep": True}, simulator=TRUE)
    for command in wanted:
        made.sample(float(command))
    return made


def experiment(made):
    reading, voltage = np.array(made.readings), np.array(made.voltages)
    return Experiment("a bag: valve", 0.001, voltage, reading, (), 10.0, (), "oarc")


def moving(seconds):
    time = np.arange(round(1000 * seconds)) * 0.001
    return 1.2 * np.sin(2.0 * np.pi * 0.7 * time) + 0.5 * np.sin(2.0 * np.pi * 3.1 * time)


@pytest.fixture(scope="module")
def moved():
    return operated(moving(8.0))


def test_motion_in_closed_loop_tells_gain_speed_friction_offset_and_dead_time(moved):
    found = recorded.learnt(experiment(moved), defaults(VALVE), [])
    told = {one.name: one for one in found.learnt}
    assert all(one.determined for one in found.learnt), found.learnt
    for name, true in (
        ("gain", 1.15),
        ("speed", 1.0),
        ("friction.coulomb", 0.7),
        ("disturbance.offset", 0.4),
        ("lvdt.delay", 0.001),
    ):
        one = told[name]
        assert abs(one.value - true) <= max(1.5 * one.bound, 0.02 * abs(true)), one
    assert found.residual == pytest.approx(0.004, rel=0.2)
    box = {q.name: q for q in recorded.box(found, BOX)}
    assert "flow_force" not in box and 0.0 <= box["friction.coulomb"].low < 0.7 < box["friction.coulomb"].high
    assert box["gain"].low > 0.9 and box["gain"].high < 1.1


def test_what_the_excitation_does_not_determine_is_left_alone():
    """A steady ramp to one side: friction and offset cannot be told apart."""
    made = operated(np.linspace(0.0, 1.5, 6000))
    whole = experiment(made)
    steady = whole._replace(voltage=whole.voltage[2000:], position=whole.position[2000:])
    found = recorded.learnt(steady, updated(VALVE, defaults(VALVE), {"lvdt.delay": 0.0005}), [])
    told = {one.name: one for one in found.learnt}
    left = {one.name for one in found.learnt if not one.determined}
    assert left & {"disturbance.offset", "friction.coulomb"}, found.learnt
    for name in left:
        assert told[name].value == {"gain": 1.0, "speed": 1.0, "lvdt.delay": 0.0005}.get(name, 0.0)
    usual = {q.name: q for q in BOX}
    assert all(q == usual[q.name] for q in recorded.box(found, BOX) if q.name in left)


SOLENOID = {
    "valve": "solenoid",
    "u_max": 4.0,
    "solenoid.u_min": -4.0,
    "solenoid.gain": 1.0,
    "solenoid.natural_frequency": 12.0,
    "solenoid.coil": 0.003,
    "solenoid.hysteresis": 0.2,
    "solenoid.positive": 1.05,
    "solenoid.negative": 0.95,
    "solenoid.dead_time": 0.0005,
    "solenoid.bits": 12,
    "friction.coulomb": 0.3,
    "friction.presliding": 0.02,
    "lvdt.noise": 0.003,
}


def with_solenoids(true):
    """A recording: the PID on a ``true`` valve."""
    bench = SupervisedValve(true, {"controller": "pid"})
    for command in moving(8.0):
        bench.supervisor.command(float(command))
        bench.sample()
    return Experiment(
        "a bag: valve", 0.001, np.array(bench.voltages), np.array(bench.readings), (), 10.0, (), "pid"
    )


def test_a_valve_with_solenoids_is_learnt_as_one():
    """Its coil, play and sides stay as they are known; ten percent more gain and speed are found."""
    known = SOLENOID
    limits = {"u_max": 10.0, "solenoid.u_min": -10.0}
    faster = {"solenoid.gain": 1.1, "solenoid.natural_frequency": 13.2, "solenoid.coil": 0.003 / 1.1}
    true = {**known, **limits, **faster, "friction.coulomb": 0.5, "disturbance.offset": 0.2}
    found = recorded.learnt(with_solenoids(true), updated(VALVE, defaults(VALVE), known), ["lvdt.delay"])
    told = {one.name: one for one in found.learnt}
    wanted = {"gain": 1.1, "speed": 1.1, "friction.coulomb": 0.5, "disturbance.offset": 0.2}
    for name, value in wanted.items():
        assert told[name].determined and told[name].value == pytest.approx(value, rel=0.02, abs=0.01), told
    kept = ("valve", "solenoid.hysteresis", "solenoid.positive", "solenoid.negative", "solenoid.dead_time")
    assert {name: found.values[name] for name in kept} == {name: known[name] for name in kept}
    assert found.values["solenoid.coil"] == pytest.approx(0.003 / 1.1, rel=0.02)
    assert found.values["u_max"] == 10.0 and found.values["solenoid.u_min"] == -10.0
    assert found.residual == pytest.approx(np.hypot(0.003, 0.0049 / np.sqrt(12.0)), rel=0.2)


@pytest.mark.parametrize(("before", "behind"), [(0.0016, 0.0003), (0.0, 0.0003), (0.0, 0.0001)])
def test_the_dead_time_of_solenoids_is_learnt_as_a_whole(before, behind):
    """More or less of it; the sensor keeps the 0.3 ms that it is known for, as far as there is so much."""
    limits = {"u_max": 10.0, "solenoid.u_min": -10.0}
    known = updated(VALVE, defaults(VALVE), {**SOLENOID, **limits, "lvdt.delay": 0.0003})
    true = {**known, "solenoid.dead_time": before, "lvdt.delay": behind}
    found = recorded.learnt(with_solenoids(true), known, [])
    told = {one.name: one for one in found.learnt}["dead_time"]
    # Play and friction make the residual rough, so that a search ends up to 0.1 ms beside the least one.
    assert told.determined and told.value == pytest.approx(before + behind, abs=1.5e-4)
    assert abs(told.value - before - behind) <= 1.5 * told.bound
    sensor, actuator = found.values["lvdt.delay"], found.values["solenoid.dead_time"]
    assert sensor == min(0.0003, told.value)
    assert actuator == pytest.approx(told.value - sensor, abs=1e-12)
    box = {q.name: q for q in recorded.box(found, BOX)}
    assert box["lvdt.delay"].low <= sensor < box["lvdt.delay"].high < sensor + 0.001
    assert box["lvdt.delay"].low <= before + behind - actuator < box["lvdt.delay"].high


def test_a_recording_at_rest_is_one_sentence():
    with pytest.raises(ParameterError, match="has no excitation: the readings move by"):
        recorded.learnt(experiment(operated(np.zeros(3000))), defaults(VALVE), [])


@pytest.mark.campaign
def test_tune_from_a_bag(run, tmp_path, moved):
    write(tmp_path / "operation", moved.messages)
    few = ["--valves", "3", "--unseen", "4", "--budget", "50", "--max-chatter", "0.5"]
    status, out, err = run(
        "tune", "--bag", "operation", "--controller", "pid", *few, "--output", "t.yaml", "--json", "-"
    )
    assert status == 0, err
    assert json.loads(out)["recording"]["valve"]["gain"]["value"] == pytest.approx(1.15, rel=0.03)
    tuned = files.load("t.yaml")  # with this file alone simulate has the valve of the bag
    assert tuned["controller"]["controller"] == "pid"
    model = build.valve_model(updated(VALVE, defaults(VALVE), tuned["valve_simulator"]))
    assert model.static_gain == pytest.approx(1.15 * build.valve_model(defaults(VALVE)).static_gain, rel=0.03)
    status, out, err = run("tune", "--bag", "operation", "--scenario", "sine", "--json", "-")
    assert status == 2 and "takes no --scenario" in err and len(sentences(err)) == 1
