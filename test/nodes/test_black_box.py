# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The recorder as a black box: what it has of the time before something happened."""

import signal
import time

import pytest
from bench import call, set_parameters, spin_until
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterValue
from rclpy.serialization import serialize_message
from std_srvs.srv import Trigger

from valve_control.nodes.adapter import encoded
from valve_control.nodes.black_box import OVERHEAD, SILENT, BlackBox, BoxLimits
from valve_control.nodes.harness.processes import process
from valve_control.nodes.parameter_capture import EVENTS
from valve_control.recordings import parameters
from valve_control.recordings.analysis import analyze
from valve_control.recordings.bags.bag import Bag
from valve_control.recordings.modes import Mode
from valve_control.recordings.recording import load

SECONDS, AFTER = 1.0, 0.25
MOVING = [
    "-p", "scenario:=sine", "-p", "amplitude:=2.0", "-p", "frequency:=1.5", "-p", "start:=0.0",
    "-p", "duration:=200.0", "-p", "delay:=0.0",
]  # fmt: skip
BOX = ["-p", "black_box:=true", "-p", f"box.seconds:={SECONDS}", "-p", f"box.after:={AFTER}"]


def bags(folder):
    return sorted(path for path in folder.iterdir() if path.name.startswith("box_"))


@pytest.mark.alone
def test_a_frozen_lvdt_and_a_killed_controller_leave_the_seconds_before_them(ros, tmp_path):
    log = tmp_path / "recorder.log"

    def wait(seconds, what):
        end = time.monotonic() + seconds
        spin_until(ros, lambda: time.monotonic() > end, what)

    def next_bag(known):
        spin_until(ros, lambda: set(bags(tmp_path)) - known, "bag")
        return (set(bags(tmp_path)) - known).pop()

    with (
        process("recorder", ["-p", f"bag:={tmp_path / 'box'}", *BOX], log) as recorder,
        process("controller", ["-p", "controller:=pid"], tmp_path / "controller.log") as controller,
        process("valve_simulator", ["-p", "lvdt.noise:=0.004"], tmp_path / "simulator.log"),
        process("command_source", MOVING, tmp_path / "source.log"),
    ):
        spin_until(ros, lambda: "parameters of /controller\n" in log.read_text(), "parameters")
        assert set_parameters(ros, "controller", pid__kp=3.0).successful
        # Longer than the box holds, so that the change and the list of the parameters are no longer in it.
        wait(2.0 * SECONDS + AFTER + SILENT, "motion")
        known = set(bags(tmp_path))
        frozen = time.time()
        assert set_parameters(ros, "valve_simulator", fault__lvdt="frozen").successful
        of_fault = next_bag(known)
        assert set_parameters(ros, "valve_simulator", fault__lvdt="none").successful
        wait(SECONDS, "order")
        known = set(bags(tmp_path))
        killed = time.time()
        controller.send_signal(signal.SIGKILL)
        of_kill = next_bag(known)
        answer = call(ros, Trigger, "/recorder/save_box", Trigger.Request())
        assert answer.success and f"{tmp_path / 'box_'}" in answer.message
        recorder.send_signal(signal.SIGINT)
        spin_until(ros, lambda: recorder.poll() is not None, "end of the recorder")
        assert recorder.returncode == 0, log.read_text()
    said = log.read_text()
    assert "(asked for)" in said and "silence of /controller" in said
    assert not list(tmp_path.glob(".*"))
    for folder, moment in ((of_fault, frozen), (of_kill, killed)):
        loaded = load(folder)
        valve = loaded.valves["valve"]
        time_of = valve.signals["spool_position"].time * 1e-9
        assert moment - SECONDS - 1.0 < time_of[0] < moment - 0.5 * SECONDS and time_of[-1] > moment, said
        numbers = valve.signals["spool_position"].sequence
        assert len(numbers) > 0.9 * (numbers[-1] - numbers[0]) > 100
        assert valve.controller.initial["pid.kp"] == 3.0 and valve.controller.missing == 0
        assert not [change for change in valve.controller.changes if "pid.kp" in change.values]
        assert analyze(loaded).valves["valve"].parts[0].indices.e_rms > 0.0
    assert any(interval.mode is Mode.SAFE for interval in load(of_fault).valves["valve"].modes)
    voltages = load(of_kill).valves["valve"].signals["valve_voltage"].time * 1e-9
    assert voltages[-1] == pytest.approx(killed, abs=0.2)


def box(folder, told, **limits):
    usual = {"seconds": 60.0, "after": 60.0, "keep": 3, "max_bytes": 10**6}
    made = BlackBox(
        folder / "box",
        "mcap",
        "none",
        BoxLimits(**{**usual, **limits}),
        lambda text, wrong: told.append(text),
    )
    made.add_topic("/x", "std_msgs/msg/Float64")
    made.add_topic(EVENTS, parameters.TYPE)
    return made


def word(*conditions, node="controller"):
    pairs = [KeyValue(key="mode", value="ok"), KeyValue(key="conditions", value=", ".join(conditions))]
    return serialize_message(DiagnosticArray(status=[DiagnosticStatus(name=node, values=pairs)]))


def fill(made, count, first=0):
    for i in range(first, first + count):
        made.write("/x", i, i, i + 1, encoded(float(i)))


def values(folder):
    return Bag(folder).read({"/x": ["data"]})["/x"].values["data"].tolist()


def test_memory_is_bounded_and_the_newest_are_kept(tmp_path):
    told = []
    made = box(tmp_path, told, max_bytes=100 * (OVERHEAD + 12))
    fill(made, 250)
    assert made.total_bytes == 100 * (OVERHEAD + 12) and made.message_count == 250
    folder = made.save("asked for")
    assert not folder.exists()
    made.close()
    assert values(folder) == [float(i) for i in range(150, 250)]
    assert any("wrote 100 messages" in text and "asked for" in text for text in told)
    assert [path.name for path in tmp_path.iterdir()] == [folder.name]


def test_a_condition_that_begins_is_a_reason_once(tmp_path):
    """Not what the first word of a node tells, nor what stays or flickers; two at a time are one bag."""
    told = []
    made = box(tmp_path, told, after=0.0)
    fill(made, 10)
    began = []
    for conditions in (
        ["old"],
        ["old"],
        ["old", "lvdt_jump", "saturation"],
        ["lvdt_jump"],
        [],
        ["lvdt_jump"],
    ):
        before = len(told)
        made.observe(word(*conditions))
        began.append(len(told) - before)
        made.flush()
    made.observe(b"\0\1\0\0\xff")
    assert began == [0, 0, 1, 0, 0, 0]
    made.close()
    assert len(made.bags) == 1 and values(made.bags[0]) == [float(i) for i in range(10)]
    assert "lvdt_jump of /controller; saturation of /controller" in told[-1]


def test_what_began_before_a_bag_that_waits_is_in_it_with_its_own_seconds(tmp_path):
    """A controller is missed only 3 s after its last word; meanwhile something else may have happened."""
    made = box(tmp_path, [], seconds=0.0, after=0.0)
    silent = time.monotonic()
    fill(made, 1)
    folder = made.save("something else")
    assert made.save("silence", silent) == folder
    made.close()
    assert values(folder) == [0.0]


def test_the_newest_bags_are_kept_and_nothing_else_is_removed(tmp_path):
    (tmp_path / "box_of_mine").mkdir()
    (tmp_path / "box_20200101_000000").mkdir()  # no bag
    told = []
    made = box(tmp_path, told, after=0.0, keep=2)
    folders = []
    for k in range(4):
        fill(made, 5, 5 * k)
        folders.append(made.save(f"reason {k}"))
        made._begin()
    made.close()
    assert [folder.exists() for folder in folders] == [False, False, True, True]
    assert values(folders[3]) == [float(i) for i in range(20)]
    assert (tmp_path / "box_of_mine").exists() and (tmp_path / "box_20200101_000000").exists()


def test_parameters_that_left_the_memory_are_those_of_the_bags_beginning(tmp_path):
    def event(kind, **values):
        listed = [Parameter(name=n, value=ParameterValue(type=3, double_value=v)) for n, v in values.items()]
        return serialize_message(ParameterEvent(node="/controller", **{kind: listed}))

    made = box(tmp_path, [], max_bytes=20 * (OVERHEAD + 12))
    made.write(EVENTS, 1, 1, 0, event("new_parameters", a=1.0, b=2.0))
    made.write(EVENTS, 2, 2, 0, event("changed_parameters", a=5.0))
    fill(made, 30, 3)
    made.write(EVENTS, 33, 33, 0, event("changed_parameters", b=7.0))
    folder = made.save("asked for")
    made.close()
    found = parameters.history(Bag(folder).read({}, raw=[EVENTS])[EVENTS], [])["/controller"]
    assert found.initial == {"a": 5.0, "b": 2.0}
    assert [(change.time, change.values) for change in found.changes] == [(33, {"b": 7.0})]


def test_a_bag_that_cannot_be_written_is_said_and_the_box_goes_on(tmp_path):
    told = []
    (tmp_path / "file").write_text("")
    made = box(tmp_path / "file", told, after=0.0)
    fill(made, 3)
    made.save("asked for")
    made.close()
    assert "could not be written" in made.doubt and "could not be written" in told[-1]
