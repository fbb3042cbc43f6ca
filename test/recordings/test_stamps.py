# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Times by the stamps in headers, and by a simulated clock that was recorded."""

import numpy as np
import pytest
from made import BEGIN, STORE, Message, Run, T, write

from valve_control.recordings.analysis import analyze, as_dict
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.recording import align, load

JOINTS, CLOCK = "sensor_msgs/msg/JointState", "rosgraph_msgs/msg/Clock"
AHEAD = 100_000_000_000  # ns by which the clock of the headers is ahead
MAPS = ["spool_position=/joints.position[0]"]


@pytest.fixture(scope="module")
def run():
    made = Run()
    made.move(1500)
    return made


def moment(stamp):
    return T["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))


def joints(stamp, position):
    empty = np.array([])
    header = T["std_msgs/msg/Header"](moment(stamp), "")
    message = T[JOINTS](header, ["spool"], np.array([position]), empty, empty)
    return bytes(STORE.serialize_cdr(message, JOINTS))


def stamped(run, ahead=AHEAD):
    """The readings as joint states, with a stamp each; sent late and irregularly."""
    readings = [m for m in run.messages if m.topic == "/spool_position"]
    late = np.random.default_rng(1).integers(0, 400_000, len(readings)).tolist()
    told = [
        Message(
            "/joints", JOINTS, m.time + delay, m.sequence, joints(m.time + ahead, value), m.log_time + delay
        )
        for m, value, delay in zip(readings, run.readings, late, strict=True)
    ]
    return [*(m for m in run.messages if m.topic != "/spool_position"), *told]


def simulated(run, speed, step=10_000_000):
    """The messages with /clock every ``step`` [ns] of real time, which goes on at ``speed``."""
    times = range(BEGIN - step, max(m.log_time for m in run.messages) + 2 * step, step)
    clock = [
        Message(
            "/clock", CLOCK, t, i + 1, bytes(STORE.serialize_cdr(T[CLOCK](moment(sim)), CLOCK)), t + 50_000
        )
        for i, t in enumerate(times)
        for sim in (5_000_000_000 + round(speed * (t - BEGIN)),)
    ]
    return [*run.messages, *clock]


def test_readings_have_the_times_of_their_headers(run, tmp_path):
    path = write(tmp_path / "bag", stamped(run))
    loaded = load(path, MAPS, clock="header")
    valve = loaded.valves["valve"]
    assert loaded.clock.name == "header.stamp" and as_dict(analyze(loaded))["bag"]["clock"] == "header.stamp"
    own = [m.time + AHEAD for m in run.messages if m.topic == "/spool_position"]
    assert np.array_equal(valve.signals["spool_position"].time, own)
    # What has no header is moved as far as its neighbours that have one.
    command = valve.signals["spool_command"].time - AHEAD
    assert np.max(np.abs(command - valve.signals["spool_command"].log_time)) < 900_000
    assert any("/spool_command has no header" in note for note in loaded.problems)
    aligned = align(valve)
    assert np.array_equal(aligned.measurement, run.readings[-len(aligned.measurement) :])
    jitter = as_dict(analyze(load(path, MAPS)))["valves"]["valve"]["timing"]["spool_position"]["jitter_s"]
    exact = as_dict(analyze(loaded))["valves"]["valve"]["timing"]["spool_position"]["jitter_s"]
    assert exact["max"] < 1e-8 < jitter["p99"]


def test_a_part_is_cut_by_the_clock_of_the_headers(run, tmp_path):
    part = load(write(tmp_path / "bag", stamped(run)), MAPS, start=0.5, end=1.0, clock="header")
    time = part.valves["valve"].signals["spool_position"].time
    assert len(time) == pytest.approx(500, abs=1) and time[0] - AHEAD - BEGIN == pytest.approx(5e8, abs=3e6)


@pytest.mark.parametrize("speed", [0.3, 1.0, 4.0])
def test_a_simulated_clock_gives_the_time_of_the_simulation(run, tmp_path, speed):
    path = write(tmp_path / "bag", simulated(run, speed))
    loaded = load(path, clock="/clock")
    valve = loaded.valves["valve"]
    assert loaded.clock.name == "/clock"
    sent = np.array([m.time for m in run.messages if m.topic == "/spool_position"])
    wanted = 5_000_000_000 + speed * (sent - BEGIN)
    assert np.max(np.abs(valve.signals["spool_position"].time - wanted)) < 10.0
    about = as_dict(analyze(loaded))["valves"]["valve"]
    assert about["lvdt_period"]["measured_s"] == pytest.approx(speed * 1e-3, rel=1e-4)
    part = load(path, start=0.3, end=0.6, clock="/clock").valves["valve"].signals["spool_position"].time
    assert len(part) == pytest.approx(min(1500, 0.6e3 / speed) - 0.3e3 / speed, abs=2)


def test_clocks_that_are_not_there_are_refused(run, tmp_path):
    bare = write(tmp_path / "bare", run.messages)
    with pytest.raises(BagError, match=r"no signal with a header; it has /spool_command \(std_msgs/msg/Fl"):
        load(bare, clock="header")
    with pytest.raises(BagError, match=r"has no /clock \(rosgraph_msgs/Clock\)"):
        load(bare, clock="/clock")
    readings = [m._replace(data=joints(0, 0.0)) for m in stamped(run) if m.topic == "/joints"]
    with pytest.raises(BagError, match="stamps on /joints are 0"):
        load(write(tmp_path / "zero", readings), MAPS, clock="header")
