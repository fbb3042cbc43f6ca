# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Shadow replay against the controller that made the recording."""

import re
from pathlib import Path
from tempfile import TemporaryDirectory

import changed
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made import ARRAY, BEGIN, STORE, Run, array, in_file_order, write

from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.supervision.journal import COLUMNS, HEAD
from valve_control.parameter import ParameterError, defaults
from valve_control.recordings import shadow_replay
from valve_control.recordings.bags.bag import Bag
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.mapping import find_valves
from valve_control.recordings.recording import load


def shadowed(path, valve="valve", **overrides):
    return shadow_replay.replay(load(path, journals=True).valves[valve], changed.dotted(overrides))


@pytest.mark.parametrize("law", ["arc", "oarc", "dcarc", "pid", "compensator", "open_loop"])
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_the_recorded_controller_once_more_bit_for_bit(tmp_path, law, storage):
    run = Run(controller={"controller": law})
    run.move(800)
    result = shadowed(write(tmp_path / "bag", run.messages, storage))
    assert result.faithful and result.differing == 0 and result.left_out == []
    assert np.array_equal(result.voltage, run.voltages)


def test_a_remapped_command_that_is_named_leaves_the_replay_exact(tmp_path):
    """The journal has the commands; a scaled one, or a reading of another topic, did not come from there."""
    run = Run()
    run.move(300)
    lever = [m._replace(topic="/lever") if m.topic == "/spool_command" else m for m in run.messages]
    path = write(tmp_path / "bag", lever)
    for maps, exact in (
        ([], True),
        (["spool_command=/lever.data"], True),
        (["spool_command=/lever.data*0.5"], False),
        (["spool_command=/lever", "spool_position=/valve_voltage"], False),
    ):
        result = shadow_replay.replay(load(path, maps, journals=True).valves["valve"], {})
        assert (result.differing == 0 and result.left_out == []) is exact, maps


def test_events_on_parameters_are_not_needed(tmp_path):
    """The controller's accounts tell them, at the row from which they count."""
    run = Run(controller={"arc.k2": 70.0})
    run.move(250)
    run.change(arc__k1=60.0)
    run.move(120)
    run.change(controller="oarc")
    run.move(500)
    result = shadowed(write(tmp_path / "bag", run.messages, keep=lambda m: m.topic != "/parameter_events"))
    assert result.faithful and result.differing == 0 and np.array_equal(result.voltage, run.voltages)


def test_a_row_that_was_not_so_shows(tmp_path):
    """The comparison can fail, and the next account brings it back."""
    run = Run(memory_every=300)
    run.move(1000)
    notes = [m for m in run.messages if m.topic.endswith("journal")]
    message = STORE.deserialize_cdr(notes[4].data, ARRAY)
    data = message.data.copy()
    row = data[HEAD:].reshape(-1, len(COLUMNS))[20]
    row[COLUMNS.index("reading")] = np.nextafter(row[COLUMNS.index("reading")], 1.0)
    wrong = array(data)
    messages = [m._replace(data=wrong) if m is notes[4] else m for m in run.messages]
    result = shadowed(write(tmp_path / "bag", messages))
    found = np.flatnonzero(result.voltage != result.recorded)
    assert found[0] == result.differences[0] and 0 < len(found) <= 300
    assert np.array_equal(result.voltage[found[0] + 300 :], run.voltages[found[0] + 300 :])
    assert any("went on from its account" in text for text in result.left_out)


def drop_out(run, stalled):
    """The LVDT is silent for long, or the process stands still and finds readings that are stale."""
    for _ in range(3):
        run.time += 40_000_000
        run.answer(
            run.time,
            lambda: (
                run.supervisor.skip(0.1, run.counts["spool_position"], 0.04)
                if stalled
                else run.supervisor.silence(0.04)
            ),
        )


def wrong_reading(run, value):
    run.time += 1_000_000
    run.put("spool_position", run.time, value)
    run.answer(
        run.time + 150_000, lambda: run.supervisor.sample(value, run.counts["spool_position"], 0.0010031)
    )


STEPS = {
    "move": lambda run: run.move(30),
    "late commands": lambda run: run.move(7, late=True),
    "no commands": lambda run: [run.sample() for _ in range(9)],
    "NaN command": lambda run: run.sample(np.nan),
    "two commands": lambda run: run.sample(0.1, before=lambda supervisor: supervisor.command(-0.2)),
    "lost readings": lambda run: run.move(3, lost=True),
    "many lost readings": lambda run: run.move(25, lost=True),
    "NaN reading": lambda run: wrong_reading(run, np.nan),
    "jump": lambda run: wrong_reading(run, 5.0),
    "silence": lambda run: drop_out(run, False),
    "stall": lambda run: drop_out(run, True),
    "reset": lambda run: run.move(1, before=lambda supervisor: supervisor.reset()),
    "begin anew": lambda run: run.move(1, before=lambda supervisor: supervisor.start()),
    "command gone": lambda run: run.move(1, before=lambda supervisor: supervisor.command_gone()),
    "two LVDTs": lambda run: run.move(
        1, before=lambda supervisor: supervisor.publishers("spool_position", 2)
    ),
    "one LVDT": lambda run: run.move(1, before=lambda supervisor: supervisor.publishers("spool_position", 1)),
    "arc": lambda run: run.change(controller="arc"),
    "oarc": lambda run: run.change(controller="oarc"),
    "pid": lambda run: run.change(controller="pid"),
    "gains": lambda run: run.change(arc__k1=float(run.random.uniform(60.0, 120.0))),
    "lag": lambda run: run.change(command__lag=0.002),
    "slow upper level": lambda run: [run.move(1) or [run.sample() for _ in range(7)] for _ in range(6)],
    "lead": lambda run: run.change(reshaping__lead=0.006),
    "trajectory": lambda run: [run.sample(before=lambda _, i=i: run.point(0.1 * i, 10.0)) for i in range(12)],
    "slow trajectory": lambda run: [
        run.point(0.1 * i, 10.0, 3.0) or [run.sample() for _ in range(8)] for i in range(4)
    ],
    "refused points": lambda run: [
        run.point(np.nan),
        run.point((0.1, 0.2), 2, 0),
        run.point(0.3, ago=10**9),
        run.sample(0.2),
    ],
    "trajectory gone": lambda run: run.move(1, before=lambda supervisor: supervisor.trajectory_gone()),
    "two trajectories": lambda run: run.move(1, before=lambda j: j.publishers("spool_trajectory", 2)),
    "u_max": lambda run: run.change(u_max=float(run.random.uniform(0.5, 5.0))),
}


@settings(max_examples=40, deadline=None)
@given(steps=st.lists(st.sampled_from(list(STEPS)), min_size=4, max_size=16), seed=st.integers(0, 99))
def test_whatever_happens(steps, seed):
    """Events that no other topic tells of included."""
    run = Run(seed, memory_every=150, stamped=seed % 2 == 0)
    run.move(20)
    for name in steps:
        STEPS[name](run)
    run.move(20)
    with TemporaryDirectory() as folder:
        result = shadowed(write(Path(folder) / "bag", run.messages))
    assert result.faithful and result.differing == 0
    assert np.array_equal(result.voltage, run.voltages)
    assert not any("account" in text for text in result.left_out)


@settings(max_examples=40, deadline=None)
@given(
    steps=st.lists(st.sampled_from(list(STEPS)), min_size=6, max_size=16),
    begin=st.floats(0.0, 0.5),
    lost=st.sets(st.integers(0, 12), max_size=3),
)
def test_with_gaps_and_from_the_middle(steps, begin, lost):
    """What is compared is equal even so; the rest is said."""
    run = Run(7, memory_every=50)
    run.move(120)
    for name in steps:
        STEPS[name](run)
    run.move(300)
    notes = [m for m in run.messages if m.topic.endswith(("journal", "memory"))]
    # After the last loss an account comes within 50 samples.
    hidden = [notes[i] for i in lost if i < len(notes) and notes[i].time < run.time - 200_000_000]
    first = BEGIN + round(begin * (run.time - BEGIN))
    with TemporaryDirectory() as folder:
        bag = write(
            Path(folder) / "bag",
            run.messages,
            keep=lambda m: m.topic == "/parameter_events" or (m.time > first and m not in hidden),
        )
        result = shadowed(bag)
    assert result.faithful and result.differing == 0
    assert 80 <= len(result.voltage) <= len(run.voltages)
    assert np.array_equal(result.voltage[-80:], run.voltages[-80:])
    heard = sum(m.time > first for m in run.messages if m.topic == "/valve_voltage")
    assert heard <= len(result.voltage) or any("not in the part" in text for text in result.left_out)


@pytest.mark.parametrize("missing", [0.3, 0.6, 0.9])
def test_how_much_of_the_journal_is_missing_is_said(tmp_path, missing):
    run = Run(memory_every=50)
    run.move(2000)
    last = run.time - round(missing * 1e9)
    kept = write(tmp_path / "bag", run.messages, keep=lambda m: "journal" not in m.topic or m.time < last)
    (note,) = [text for text in shadowed(kept).left_out if "not in the part" in text]
    assert float(re.search(r"ends ([\d.]+) s before the last", note)[1]) == pytest.approx(missing, abs=0.11)


def test_a_controller_that_was_restarted_with_other_parameters(tmp_path):
    run = Run()
    run.move(300)
    run.change(arc__k1=80.0)
    run.move(200)
    voltages, messages = run.voltages, run.messages
    again = Run(controller={"arc.k2": 70.0}, begin=run.time + 2_000_000_000)
    again.move(300)
    result = shadowed(write(tmp_path / "bag", [*messages, *again.messages]))
    assert result.faithful and result.differing == 0
    assert np.array_equal(result.voltage, [*voltages, *again.voltages])


def test_voltages_without_source_times_are_compared_with_the_journal(tmp_path):
    """As sqlite3 bags of `ros2 bag record` are: messages delayed by more than a sample."""
    run = Run()
    run.move(500)
    late = [m._replace(time=m.log_time + 3_000_000, log_time=m.log_time + 3_000_000) for m in run.messages]
    result = shadowed(write(tmp_path / "bag", late))
    assert result.faithful and result.differing == 0 and np.array_equal(result.recorded, run.voltages)


@pytest.mark.parametrize(
    "text", [b"", b"\0\1\0\0", array([1.0, 2.0, 3.0, 4.0]), array([0.0, 1.0, 0.0, *[77.0] * 7])]
)
def test_what_is_no_journal_is_left_out_and_said(tmp_path, text):
    run = Run()
    run.move(400)
    messages = run.messages
    notes = [m for m in messages if m.topic.endswith("journal")]
    damaged = [m._replace(data=text) if m is notes[1] else m for m in messages]
    recording = load(write(tmp_path / "bag", damaged), journals=True)
    assert any("are no journal" in problem for problem in recording.valves["valve"].problems)
    result = shadow_replay.replay(recording.valves["valve"], {})
    assert result.differing == 0 and 280 < len(result.voltage) < 400


def test_without_a_journal_times_must_do_and_that_is_said(tmp_path):
    run = Run(stamped=True)
    run.move(500)
    bag = write(tmp_path / "bag", run.messages, keep=lambda m: not m.topic.endswith("journal"))
    result = shadowed(bag)
    assert len(result.voltage) == 500 and any(
        "without a controller's ~/journal" in text for text in result.left_out
    )
    # Commands came well before their readings here.
    assert np.array_equal(result.recorded, run.voltages)
    assert np.max(np.abs(result.voltage - result.recorded)) < 1e-9


def test_another_controller_in_shadow(tmp_path):
    run = Run()
    run.move(500)
    bag = write(tmp_path / "bag", run.messages)
    result = shadowed(bag, controller="oarc")
    assert not result.faithful and result.controller == "oarc" and result.differing > 400
    assert np.array_equal(result.recorded, run.voltages)
    # On the same readings an adaptive law asks for about the same voltage.
    assert np.corrcoef(result.voltage[100:], result.recorded[100:])[0, 1] > 0.8


def test_a_part_begins_where_it_was_asked_for(tmp_path):
    run = Run(memory_every=400)
    run.move(1500)
    bag = write(tmp_path / "bag", run.messages)
    valve = load(bag, start=0.95, end=1.15, journals=True).valves["valve"]
    result = shadow_replay.replay(valve, {})
    assert result.faithful and result.differing == 0 and 100 <= len(result.voltage) <= 201
    # Of the part's last rows the message had not come yet.
    first = run.voltages.index(result.voltage[0])
    assert 948 <= first <= 951 and np.array_equal(
        result.voltage, run.voltages[first : first + len(result.voltage)]
    )


def test_without_an_account_nothing_is_made_up(tmp_path):
    run = Run(memory_every=10**9)
    run.move(1000)
    notes = [m for m in run.messages if m.topic.endswith("memory")]
    half = BEGIN + 500_000_000
    odd = [m._replace(time=half + 1, log_time=half + 1) if m is notes[0] else m for m in run.messages]
    bag = write(tmp_path / "bag", odd, keep=lambda m: m.time > half)
    with pytest.raises(BagError, match="no account on ~/memory"):
        shadowed(bag)


def test_other_gains_across_a_gap_of_the_journal(tmp_path):
    run = Run()
    run.move(1500)
    notes = [m for m in run.messages if m.topic.endswith(("journal", "memory"))]
    result = shadowed(
        write(tmp_path / "bag", run.messages, keep=lambda m: m not in notes[8:14]), arc__k1=100.0
    )
    assert not any("did not reach" in text for text in result.left_out)
    assert any("missing in 1 places" in text for text in result.left_out)
    assert np.count_nonzero(result.voltage == 0.0) == 0


def test_overrides_are_checked_with_the_recorded_parameters(tmp_path):
    theta = [18.0, 1200.0, 1200.0, 0.0]
    run = Run(controller={"arc.theta_initial": theta})
    run.move(200)
    bag = write(tmp_path / "bag", run.messages)
    upper = list(defaults(CONTROLLER)["arc.theta_max"])
    result = shadowed(bag, arc__theta_max=[19.0, *upper[1:]])
    assert len(result.voltage) == 200
    with pytest.raises(ParameterError, match="theta"):
        shadowed(bag, arc__theta_max=[17.0, *upper[1:]])


def test_state_and_journal_are_those_of_one_controller(tmp_path):
    """Of two controllers in a namespace the first topic of each kind was taken, in the order of the file."""
    run = Run()
    run.move(50)
    other = [m._replace(topic=m.topic.replace("/controller/", "/a_shadow/")) for m in run.messages]
    firsts = {m.topic: m for m in [*other, *run.messages] if m.topic.endswith(("/state", "/journal"))}
    order = ("/controller/state", "/a_shadow/journal", "/a_shadow/state", "/controller/journal")
    readings = [m for m in run.messages if m.topic == "/spool_position"]
    path = in_file_order(tmp_path / "bag", [*(firsts[name] for name in order), *readings])
    found = find_valves(Bag(path))["valve"]
    assert (found.state, found.journal) == ("/controller/state", "/controller/journal")
