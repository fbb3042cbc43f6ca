# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Signals in messages of several publishers, of which not each has the joint that is asked for."""

import numpy as np
import pytest
from made import STORE, Message, Run, T, write

from valve_control.cli.command import run as main
from valve_control.recordings.analysis import analyze, as_dict
from valve_control.recordings.recording import align, load

JOINTS = "sensor_msgs/msg/JointState"
MAP = ["spool_position=/joint_states.position[spool]"]


def joints(names, values):
    header = T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](0, 0), "")
    message = T[JOINTS](header, names, np.array(values, dtype=float), np.array([]), np.array([]))
    return bytes(STORE.serialize_cdr(message, JOINTS))


@pytest.fixture(scope="module")
def run():
    made = Run()
    made.move(2000)
    return made


def as_joints(messages, names=("spool",)):
    """The readings as a JointState, in which the spool is the last of ``names``."""
    return [
        m._replace(
            topic="/joint_states", type=JOINTS,
            data=joints(list(names), [*[9.0] * (len(names) - 1), *np.frombuffer(m.data[4:])]),
        )
        if m.topic == "/spool_position"
        else m
        for m in messages
    ]  # fmt: skip


def arm(messages, per, names, numbered, begin=0):
    """Another publisher on the readings' topic: ``per`` messages after each of them."""
    count = 0
    for m in messages:
        if m.topic == "/joint_states":
            for k in range(per):
                count += 1
                later = 30_000 * (k + 1)
                yield Message(
                    m.topic, JOINTS, m.time + later, (begin + count) * numbered,
                    joints(names, [3.0] * len(names)), m.log_time + later,
                )  # fmt: skip


def checked(bag, run, true, numbered=True):
    loaded = load(bag, MAP)
    about = as_dict(analyze(loaded))
    valve = about["valves"]["valve"]
    assert np.array_equal(align(loaded.valves["valve"]).measurement, run.readings)
    assert valve["timing"]["spool_position"]["lost"] == (0 if numbered else None)
    assert valve["timing"]["spool_position"]["messages"] == len(run.readings)
    assert valve["indices"] == true["indices"]
    return [*valve["left_out"], *about["left_out"]]


@pytest.fixture(scope="module")
def true(run, tmp_path_factory):
    bag = write(tmp_path_factory.mktemp("true") / "bag", run.messages)
    return as_dict(analyze(load(bag)))["valves"]["valve"]


@pytest.mark.parametrize("numbered", [True, False])
@pytest.mark.parametrize("names", [["thumb"], ["boom", "arm", "bucket"], []])
@pytest.mark.parametrize(("per", "begin"), [(1, 0), (3, 40_000)])
def test_another_publisher_of_other_joints_costs_nothing(run, true, tmp_path, per, begin, names, numbered):
    """Also where its messages are as long as those with the joint (thumb), so that only the names tell."""
    own = as_joints([m._replace(sequence=m.sequence * numbered) for m in run.messages])
    bag = write(tmp_path / "bag", [*own, *arm(own, per, names, numbered, begin)])
    notes = checked(bag, run, true, numbered)
    (note,) = [text for text in notes if "/joint_states" in text]
    assert f"{per * 2000} messages of /joint_states have no position[spool]" in note
    assert not any("decoded" in text or "lost" in text for text in notes)


@pytest.mark.parametrize(("every", "lost"), [(2, 0), (3, 0), (5, 40)])
def test_a_publisher_that_alternates_its_joints_loses_none(run, tmp_path, every, lost):
    """Only what nobody recorded is lost, not the messages of the same publisher that have other joints."""
    own = as_joints(run.messages)
    readings = [m for m in own if m.topic == "/joint_states"]
    others = [m._replace(data=joints(["boom"], [3.0])) for k, m in enumerate(readings) if k % every]
    kept = [m for k, m in enumerate(readings) if k % every == 0]
    rest = [m for m in own if m.topic != "/joint_states"]
    found = as_dict(analyze(load(write(tmp_path / "bag", [*rest, *kept, *others[lost:]]), MAP)))
    timing = found["valves"]["valve"]["timing"]["spool_position"]
    assert timing["lost"] == lost and timing["messages"] == len(kept)


def test_a_label_that_never_comes_is_refused_with_those_that_do(run, tmp_path, capsys):
    own = as_joints(run.messages, ["boom", "spool"])
    bag = str(write(tmp_path / "bag", [*own, *arm(own, 1, ["arm"], True)]))
    assert main(["analyze", bag, "--map", "spool_position=/joint_states.position[spol]"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "there is no position[spol]" in line
    assert all(name in line for name in ("boom", "spool", "arm"))
