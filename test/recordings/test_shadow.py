"""Shadow replay against the controller that made the recording."""

import numpy as np
import pytest
from made import Run, write

from valve_control.recordings import shadow
from valve_control.recordings.recording import load


def shadowed(path, valve="valve", **overrides):
    return shadow.replay(load(path).valves[valve], overrides)


@pytest.mark.parametrize("law", ["arc", "oarc", "pid", "compensator", "open_loop"])
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_the_recorded_controller_once_more_bit_for_bit(tmp_path, law, storage):
    run = Run(controller={"controller": law})
    run.move(800)
    result = shadowed(write(tmp_path / "bag", run.messages, storage))
    assert result.faithful and result.differing == 0 and result.inferred == [] and result.left_out == []
    assert np.array_equal(result.voltage, run.voltages)


def test_live_changes_of_parameters_included(tmp_path):
    run = Run()
    run.move(300)
    run.change(arc__k1=80.0, arc__gamma=[1.0, 50.0, 60.0, 100.0])
    run.move(200)
    run.change(controller="oarc")
    run.move(200)
    run.change(oarc__ks1=150.0)
    run.change(transfer_time=0.02)
    run.move(100)
    run.change(controller="pid", pid__form="plain")
    run.move(200)
    run.change(u_max=1.0)
    run.move(200)
    result = shadowed(write(tmp_path / "bag", run.messages))
    assert result.faithful and result.differing == 0
    assert np.array_equal(result.voltage, run.voltages)


def test_a_change_that_is_not_in_the_bag_shows(tmp_path):
    """The comparison can fail."""
    run = Run()
    run.move(300)
    run.change(arc__k1=80.0)
    run.move(300)
    changed = [m for m in run.messages if m.topic == "/parameter_events"][-1]
    result = shadowed(write(tmp_path / "bag", run.messages, keep=lambda m: m is not changed))
    assert 298 <= result.first_difference <= 301 and result.differing > 250


@pytest.mark.parametrize("seed", range(4))
def test_commands_that_arrive_while_a_reading_is_answered(tmp_path, seed):
    """Source times do not tell whether they were taken; the recorded voltage does."""
    run = Run(seed)
    for _ in range(300):
        run.move(1, late=bool(run.random.integers(2)))
    result = shadowed(write(tmp_path / "bag", run.messages))
    assert result.differing == 0 and np.array_equal(result.voltage, run.voltages)


def test_readings_lost_on_their_way_to_the_controller(tmp_path):
    run = Run()
    for _ in range(20):
        run.move(20)
        run.move(int(run.random.integers(1, 5)), lost=True)
    run.move(20)
    result = shadowed(write(tmp_path / "bag", run.messages))
    assert result.differing == 0 and np.array_equal(result.voltage, run.voltages)
    assert any("not seen" in text for text in result.left_out)


def test_events_that_no_topic_tells_are_inferred_and_said(tmp_path):
    run = Run(controller={"arc.theta_initial": [25.0, 1300.0, 1300.0, 10.0]})
    run.move(400)
    run.move(1, before=lambda supervisor: supervisor.reset())
    run.move(200)
    result = shadowed(write(tmp_path / "bag", run.messages))
    assert result.differing == 0
    assert len(result.inferred) == 1 and "reset" in result.inferred[0]


def test_first_commands_that_the_controller_did_not_hear(tmp_path):
    run = Run()
    for _ in range(200):
        run.put("spool_command", run.time + 700_000, 0.0)
        run.sample()
    run.move(300)
    result = shadowed(write(tmp_path / "bag", run.messages))
    assert result.differing == 0


def test_nan_readings_and_a_jump_are_refused_as_they_were(tmp_path):
    run = Run()
    run.move(100)
    for value in (np.nan, 5.0, np.inf):
        run.time += 1_000_000
        run.put("spool_position", run.time, value)
        voltage = run.supervisor.sample(value, run.counts["spool_position"], 0.001)
        run.put("valve_voltage", run.time + 150_000, voltage)
        run.voltages.append(voltage)
        run.move(60)
    result = shadowed(write(tmp_path / "bag", run.messages))
    assert result.differing == 0 and np.array_equal(result.voltage, run.voltages)


@pytest.mark.parametrize("length", [100, 1500])
def test_a_long_time_at_0_v_leaves_few_ways(tmp_path, length):
    """Readings lost while nothing tells which: it must end soon, and be exact afterwards."""
    run = Run()
    run.move(300)
    for k in range(length):
        run.time += 1_000_000
        run.put("spool_position", run.time, 99.0)
        if k not in (40, 41, 60):
            voltage = run.supervisor.sample(99.0, run.counts["spool_position"], 0.001)
            run.put("valve_voltage", run.time + 150_000, voltage)
            run.voltages.append(voltage)
    run.move(400)
    result = shadowed(write(tmp_path / "bag", run.messages))
    assert result.differing == 0 and np.array_equal(result.voltage[-300:], run.voltages[-300:])


def test_another_controller_in_shadow(tmp_path):
    run = Run()
    run.move(500)
    bag = write(tmp_path / "bag", run.messages)
    result = shadowed(bag, controller="oarc")
    assert not result.faithful and result.controller == "oarc" and result.differing > 400
    assert np.array_equal(result.recorded, run.voltages)
    # On the same readings an adaptive law asks for about the same voltage.
    assert np.corrcoef(result.voltage[100:], result.recorded[100:])[0, 1] > 0.8


def from_the_middle(tmp_path, run, seconds):
    """The bag of a recorder that came when the controller had run for a while."""
    later = run.time - round(seconds * 1e9)
    return write(
        tmp_path / "bag", run.messages, keep=lambda m: m.topic == "/parameter_events" or m.time > later
    )


@pytest.mark.parametrize("law", ["arc", "oarc", "pid", "compensator"])
def test_a_recording_that_begins_in_the_middle_begins_with_an_account(tmp_path, law):
    run = Run(controller={"controller": "pid" if law == "arc" else "arc"})
    run.move(200)
    run.change(controller=law)
    run.move(800)
    result = shadowed(from_the_middle(tmp_path, run, 0.55))
    assert result.differing == 0 and 450 <= len(result.voltage) <= 550
    assert np.array_equal(result.voltage, run.voltages[-len(result.voltage) :])
    assert any("first account" in text for text in result.left_out)


def test_without_an_account_the_middle_is_not_known_and_said(tmp_path):
    run = Run(memory_every=10**9)
    run.move(300)
    result = shadowed(from_the_middle(tmp_path, run, 0.15))
    assert any("not known" in text for text in result.left_out)
    assert result.differing > 0


def test_after_something_unknown_an_account_brings_it_back(tmp_path):
    """Parameters that were changed and changed back while the recorder did not listen."""
    run = Run()
    run.move(250)
    run.change(arc__k1=60.0)
    run.move(120)
    run.change(arc__k1=120.0)
    run.move(500)
    hidden = [m for m in run.messages if m.topic == "/parameter_events"][-2:]
    result = shadowed(write(tmp_path / "bag", run.messages, keep=lambda m: m not in hidden))
    wrong = np.flatnonzero(result.voltage != result.recorded)
    assert 100 < len(wrong) <= 252 and wrong[0] >= 249 and wrong[-1] < 502


def test_without_voltages_the_shadow_still_says_what_it_would_give(tmp_path):
    run = Run()
    run.move(200)
    bag = write(tmp_path / "bag", run.messages, keep=lambda m: not m.topic.endswith("voltage"))
    result = shadowed(bag)
    assert not result.faithful and len(result.voltage) == 200 and np.all(np.isnan(result.recorded))
    assert np.array_equal(result.voltage, run.voltages)
