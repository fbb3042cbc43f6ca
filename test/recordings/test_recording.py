# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What is read out of bags: alignment, parameters, and what is left out and said."""

import numpy as np
import pytest
from made import BEGIN, Run, number, write

from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.simulation import offline
from valve_control.recordings.analysis import analyze, as_dict
from valve_control.recordings.recorded_command import command_of, parameters_of
from valve_control.recordings.recording import align, load


@pytest.fixture(scope="module")
def run():
    made = Run()
    made.move(1500)
    made.change(arc__k1=100.0)
    made.move(500)
    return made


def test_aligned_signals_are_those_of_the_run(run, tmp_path):
    valve = load(write(tmp_path / "bag", run.messages)).valves["valve"]
    signals = align(valve)
    assert np.array_equal(signals.measurement, run.readings)
    assert np.array_equal(signals.voltage, run.voltages)
    expected = 2.0 * np.sin(2.0 * np.pi * np.arange(2000) * 1e-3)
    assert np.allclose(signals.command, expected, atol=1e-9)
    assert signals.unanswered == 0 and signals.period == 0.001
    assert signals.latency.min() >= 120e-6 and signals.latency.max() < 250e-6


@pytest.mark.parametrize("numbered", [True, False])
def test_a_reading_that_nobody_recorded_leaves_its_voltage_to_no_other(run, tmp_path, numbered):
    """Before, the reading ahead of a lost one got the voltage that answers the lost one."""
    kept = np.arange(2000) % 3 > 0
    messages, seen = [], 0
    for m in run.messages:
        if m.topic == "/spool_position":
            seen += 1
            if not kept[seen - 1]:
                continue
        messages.append(m._replace(sequence=m.sequence * numbered))
    signals = align(load(write(tmp_path / "bag", messages)).valves["valve"])
    assert np.array_equal(signals.measurement, np.array(run.readings)[kept])
    assert np.array_equal(signals.voltage, np.array(run.voltages)[kept])
    assert signals.unanswered == 0


def test_analysis_finds_parameters_changes_segments_and_estimates(run, tmp_path):
    about = as_dict(analyze(load(write(tmp_path / "bag", run.messages))))
    valve = about["valves"]["valve"]
    assert valve["controller"] == "arc"
    assert valve["parameters"]["/controller"]["initial"]["arc.k1"] == 120.0
    assert [c["values"] for c in valve["changes"]] == [{"arc.k1": 100.0}]
    assert valve["changes"][0]["time_s"] == pytest.approx(1.4995, abs=1e-6)
    kinds = [(s["kind"], s["samples"]) for s in valve["segments"]]
    assert ("run", 2000) in kinds and ("parameters", 1500) in kinds and ("parameters", 500) in kinds
    assert valve["timing"]["spool_position"]["lost"] == 0
    # The state of every tenth sample is before that sample's adaptation.
    assert valve["theta"] is not None and len(valve["theta"]) == 4
    assert valve["left_out"] == [] and about["left_out"] == []


# Left out and said


def said(path):
    loaded = load(path)
    result = analyze(loaded)
    return result, [*result.left_out, *(text for v in result.valves.values() for text in v.left_out)]


def test_nan_is_left_out_and_counted(run, tmp_path):
    messages = list(run.messages)
    for i in [j for j, m in enumerate(messages) if m.topic == "/spool_position"][100:103]:
        messages[i] = messages[i]._replace(data=number(np.nan))
    result, notes = said(write(tmp_path / "bag", messages))
    assert "3 messages of /spool_position hold NaN" in " ".join(notes)
    assert len(result.valves["valve"].signals.time) == 1997
    assert np.isfinite(result.valves["valve"].parts[0].indices.e_rms)


@pytest.mark.parametrize("part", ["spool_command", "spool_position", "valve_voltage"])
def test_a_missing_topic_takes_only_what_needs_it(run, tmp_path, part):
    result, notes = said(write(tmp_path / "bag", run.messages, keep=lambda m: not m.topic.endswith(part)))
    assert f"valve has no {part}" in " ".join(notes)
    valve = result.valves["valve"]
    assert set(valve.timing) == {"spool_command", "spool_position", "valve_voltage"} - {part}
    if part == "spool_command":
        assert np.isnan(valve.parts[0].indices.e_rms) and np.isfinite(valve.parts[0].indices.u_rms)
    elif part == "valve_voltage":
        assert np.isfinite(valve.parts[0].indices.e_rms) and np.isnan(valve.parts[0].indices.u_rms)
    else:
        assert valve.signals is None and valve.parts == []


def test_a_publisher_whose_clock_is_set_back_is_placed_by_the_times_of_recording(run, tmp_path):
    """The clock of the LVDT's driver is set back by 10 s after 1200 readings; nothing is lost."""
    readings = [m for m in run.messages if m.topic == "/spool_position"]
    late = set(map(id, readings[1200:]))
    messages = [m._replace(time=m.time - 10 * 10**9) if id(m) in late else m for m in run.messages]
    result, notes = said(write(tmp_path / "bag", messages))
    assert "source times go backwards on /spool_position; times of recording are used" in " ".join(notes)
    assert np.array_equal(result.valves["valve"].signals.measurement, run.readings)
    assert result.valves["valve"].parts[0].indices.e_rms < 0.2


def test_a_busy_recorder_is_not_taken_for_clocks_that_differ(run, tmp_path):
    """It stands still four times for 0.1 to 0.3 s; commands it takes for 40 ms of each 100 ms only."""
    messages = []
    for m in run.messages:
        log = m.log_time
        for begin, lasts in ((0.1, 0.2), (0.5, 0.3), (1.1, 0.25), (1.6, 0.1)):
            first, after = BEGIN + round(begin * 1e9), BEGIN + round((begin + lasts) * 1e9)
            if first <= log < after + 1_000_000:
                log = max(log, after + (m.time - first) // 1000)
        waits = m.time % 100_000_000
        if m.topic == "/spool_command" and waits > 40_000_000:
            log = max(log, m.time - waits + 100_000_000 + waits // 1000)
        messages.append(m._replace(log_time=log))
    result, notes = said(write(tmp_path / "bag", messages))
    assert notes == []
    expected = analyze(load(write(tmp_path / "right", run.messages))).valves["valve"].parts[0].indices
    assert result.valves["valve"].parts[0].indices == expected
    timing = result.valves["valve"].timing["spool_position"]
    assert timing.rate_hz == pytest.approx(1000.0, rel=0.02) and timing.lost == 0


def test_what_is_known_of_the_nodes_counts_from_the_beginning(run, tmp_path):
    """A part that begins after the parameters were told, and after a change."""
    bag = write(tmp_path / "bag", run.messages)
    valve = load(bag, start=1.7).valves["valve"]
    assert valve.controller.initial["arc.k1"] == 100.0 and valve.controller.changes == []
    assert valve.controller.missing == 0 and valve.simulator.initial["lvdt.noise"] == 0.004
    early = load(bag, start=0.5).valves["valve"]
    assert early.controller.initial["arc.k1"] == 120.0 and len(early.controller.changes) == 1


def test_a_change_alone_is_not_taken_for_all_parameters(run, tmp_path):
    """What `ros2 bag record` has of a node that ran already."""
    events = [m for m in run.messages if m.topic == "/parameter_events"]
    bag = write(tmp_path / "bag", run.messages, keep=lambda m: m not in events[:2])
    valve = load(bag).valves["valve"]
    assert valve.controller.initial == {} and len(valve.controller.changes) == 1
    _, notes = said(bag)
    count = len(CONTROLLER)
    assert f"does not have {count} parameters of /controller from its beginning" in " ".join(notes)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("bare", ["topic", "type", "both"])
def test_topics_without_a_slash_and_types_without_msg_are_read(run, tmp_path, storage, bare):
    """Other recorders write spool_position for /spool_position, std_msgs/Float64 for std_msgs/msg/Float64."""
    from made import STORE

    from valve_control.recordings.bags.writer import BagWriter

    with BagWriter(tmp_path / "bag", storage) as writer:
        known = set()
        for m in sorted(run.messages, key=lambda m: m.log_time):
            name = m.topic if bare == "type" else m.topic.lstrip("/")
            if name not in known:
                known.add(name)
                text, _ = STORE.generate_msgdef(m.type, ros_version=2)
                kind = m.type if bare == "topic" else m.type.replace("/msg/", "/")
                writer.add_topic(name, kind, text, "")
            writer.write(name, m.log_time, m.time, m.sequence, m.data)
    usual = as_dict(analyze(load(write(tmp_path / "usual", run.messages, storage))))
    found = as_dict(analyze(load(tmp_path / "bag")))
    assert found["valves"] == usual["valves"] and found["left_out"] == []
    assert found["bag"]["topics"] == usual["bag"]["topics"]
    mapped = load(tmp_path / "bag", ["arm/spool_position=spool_position"]).valves["arm"]
    assert np.array_equal(mapped.signals["spool_position"].value, run.readings)


# Mapping


@pytest.mark.parametrize(
    ("scale", "unit"),
    [
        ("*250", lambda v: v / 250.0),
        ("*1.25-15", lambda v: v / 1.25 + 12.0),
        ("@4..20mA", lambda v: 12.0 + 0.8 * v),
    ],
)
def test_any_number_can_play_a_part(run, tmp_path, scale, unit):
    """The LVDT in metres or mA in a JointState, the command under another name."""
    from made import STORE, T

    header = T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](0, 0), "")
    messages = []
    for m in run.messages:
        if m.topic == "/spool_position":
            value = unit(np.frombuffer(m.data[4:])[0])
            joints = T["sensor_msgs/msg/JointState"](
                header, ["arm", "spool"], np.array([9.0, value]), np.array([]), np.array([])
            )
            data = bytes(STORE.serialize_cdr(joints, "sensor_msgs/msg/JointState"))
            m = m._replace(topic="/joint_states", type="sensor_msgs/msg/JointState", data=data)
        elif m.topic == "/spool_command":
            m = m._replace(topic="/plc/wanted")
        messages.append(m)
    bag = write(tmp_path / "bag", messages)
    valve = load(
        bag, [f"spool_position=/joint_states.position[spool]{scale}", "spool_command=/plc/wanted"]
    ).valves["valve"]
    signals = align(valve)
    assert np.allclose(signals.measurement, run.readings, atol=1e-12)
    assert np.array_equal(signals.voltage, run.voltages) and np.all(np.isfinite(signals.command))


# Simulated again


def test_a_simulation_with_recorded_command_and_parameters_is_the_recorded_run(tmp_path):
    """A run from rest, whose noise is the simulator's: simulated again it is the same, bit for bit."""
    controller = {"controller": "oarc", "lockstep": True}
    simulator = {"lvdt.noise": 0.004, "friction.coulomb": 0.3, "seed": 5}
    made = Run(controller=controller, simulator=simulator)
    random = np.random.default_rng(5)

    class Noise:
        standard_normal = random.standard_normal

        @staticmethod
        def integers(low, high):
            return low

    made.random = Noise()
    command = 1.5 * np.sin(2.0 * np.pi * 2.0 * np.arange(1200) * 1e-3)
    for value in command:
        made.sample(float(value))
    valve = load(write(tmp_path / "bag", made.messages)).valves["valve"]
    signals, notes = align(valve), []
    values = parameters_of(valve, signals, notes)
    assert notes == [] and np.array_equal(command_of(valve, signals, values["controller"]), command)
    again = offline.simulate(values["controller"], values["valve_simulator"], command)
    assert np.array_equal(again.voltage, made.voltages)
    assert np.array_equal(again.measurement, made.readings)


def test_a_trajectory_plays_the_part_of_the_command_where_there_are_no_commands(tmp_path):
    run = Run(2)
    for k in range(400):
        t = k * 1e-3
        run.point(np.sin(6.0 * t), 6.0 * np.cos(6.0 * t), -36.0 * np.sin(6.0 * t))
        run.sample()
    run.flush()
    valve = load(write(tmp_path / "bag", run.messages)).valves["valve"]
    assert str(valve.topics.sources["spool_command"]) == "/spool_trajectory.positions[0]"
    assert valve.topics.plain
    signals = align(valve)
    assert np.allclose(signals.command, np.sin(6e-3 * np.arange(400)), atol=1e-9)
    both = Run(2)
    both.move(50)
    both.point(0.3)
    both.move(50)
    valve = load(write(tmp_path / "both", both.messages)).valves["valve"]
    assert str(valve.topics.sources["spool_command"]) == "/spool_command.data"
