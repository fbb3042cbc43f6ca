# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Frames, histories, sliders, changes with undo and redo, the stop, the recorder, and a valve's signals."""

import asyncio
import json
import math
import sys
from concurrent.futures import Future

import numpy as np
import pytest
from frame import signals_of
from hypothesis import given
from hypothesis import strategies as st

from valve_control.control.analysis.indices import indices
from valve_control.control.parameters.ros_file import from_text
from valve_control.control.parameters.table import CONTROLLER
from valve_control.dashboard.changes import Change, Changes, differing
from valve_control.dashboard.form import shown
from valve_control.dashboard.frames import ViewError, frame, view
from valve_control.dashboard.history import LONGEST, ROOM, History, recent_indices
from valve_control.dashboard.machine import Answer, Machine
from valve_control.dashboard.recording import Recording
from valve_control.dashboard.slider import STEPS, scale
from valve_control.dashboard.valve import SIGNALS, NodeState, Valve
from valve_control.parameter import Parameter


def test_a_valve_pairs_readings_with_the_command_that_held():
    valve = Valve("/boom")
    t = 0.001 * np.arange(10)
    valve.add("command", np.array([-1.0, 0.0045]), np.array([1.0, 2.0]))
    valve.read(t, np.full(10, 3.0))
    _, error = valve.signals["error"].between(-1.0, 1.0)
    assert error.tolist() == [2.0] * 5 + [1.0] * 5
    silent = Valve("/arm")
    silent.read(t, np.full(10, 3.0))
    assert len(silent.signals["error"]) == 0  # without a command there is no error


def test_a_frame_has_what_was_asked_for():
    machine = Machine(None)
    valve = machine.valve("/")
    t = 1000.0 + 0.001 * np.arange(10_000)
    valve.add("command", t, np.sin(t))
    valve.mark(1008.0, "k1 1 → 2")
    text = (
        '{"valve": "/", "signals": ["command", "voltage", "term.none"], "span": 5, "end": 1009.0, '
        '"columns": 300}'
    )
    got = signals_of(frame(machine, view(text), 1010.0))
    assert set(got) == {"command", "voltage", "term.none"} and got["voltage"].shape == (3, 0)
    time_, low, high = got["command"]
    assert 290 <= len(time_) <= 302 and np.all(low <= high) and -0.1 < time_[0] < time_[-1] < 5.1
    assert low.min() == pytest.approx(np.sin(t[4000:9000]).min(), abs=1e-3)
    joints = [f"axis.position of {joint}" for joint in range(6)]  # as many as the node takes
    terms = [f"term.{number}" for number in range(6)]  # as many as plots.js shows
    every = [*SIGNALS, *terms, *joints, "axis.goal", "axis.pressure_a", "axis.pressure_b"]
    whole = text.replace('["command", "voltage", "term.none"]', json.dumps(every))
    assert list(signals_of(frame(machine, view(whole), 1010.0))) == every
    not_finite = text.replace("5,", "1e999,").replace("1009.0", "NaN")
    for wrong in ("", "[]", "{}", text.replace("300", '"x"'), not_finite):
        with pytest.raises(ViewError):
            view(wrong)


class SlowLink:
    """A node whose answers come when they are let go, in the order of the requests."""

    def __init__(self):
        self.asked = []

    def set_parameters(self, node, values):
        answer = Future()
        self.asked.append((values, answer))
        return answer


def test_changes_follow_one_another_while_an_answer_is_awaited():
    """Undo pressed while a redo is on its way takes back what is being redone, not the change before."""

    async def run():
        link = SlowLink()
        machine = Machine(link)
        valve = machine.valve("/")
        node = NodeState("/controller")
        fields = {name: Parameter(name, 1.0, "", "") for name in ("kp", "ki")}
        node.answered(fields, {"kp": 1.0, "ki": 20.0})

        async def answered(count, done=True):
            while len(link.asked) < count:
                await asyncio.sleep(0)
            link.asked[count - 1][1].set_result(Answer(done, "too large"))

        for count, values in enumerate(({"kp": 2.0}, {"ki": 0.0}), 1):
            await asyncio.gather(machine.change(valve, node, values), answered(count))
        await asyncio.gather(machine.act(valve, node, "undo"), answered(3))
        assert node.values == {"kp": 2.0, "ki": 20.0}
        redo = asyncio.create_task(machine.act(valve, node, "redo"))
        undo = asyncio.create_task(machine.act(valve, node, "undo"))
        await answered(4)
        await redo
        assert node.values == {"kp": 2.0, "ki": 0.0}
        await answered(5)
        assert await undo == "" and link.asked[4][0] == {"ki": 20.0}
        assert node.values == {"kp": 2.0, "ki": 20.0}
        assert len(node.changes.done) == 1 and len(node.changes.undone) == 1
        refused, _ = await asyncio.gather(machine.change(valve, node, {"kp": 1e9}), answered(6, False))
        assert refused == "too large" and node.values == {"kp": 2.0, "ki": 20.0}
        assert len(node.changes.done) == 1

    asyncio.run(asyncio.wait_for(run(), 10.0))


def test_a_stop_asks_controllers_that_are_said_to_rest_too():
    """One was activated elsewhere since its diagnostics, one does rest and refuses, one is not heard of."""
    answers = {
        "/a/controller": Answer(True, ""),
        "/b/controller": Answer(False, "refused"),
        "/c/controller": Answer(False, "no answer", heard=False),
    }
    asked = []

    class Link:
        def transition(self, node, name):
            asked.append(node)
            answer = Future()
            answer.set_result(answers[node])
            return answer

    machine = Machine(Link())
    for space in ("/a", "/b", "/c"):
        node = machine.valve(space).nodes["controller"] = NodeState(f"{space}/controller")
        node.state = "inactive"
    assert asyncio.run(machine.stop()) == ["/c/controller was not stopped: no answer"]
    assert asked == list(answers)
    assert [len(machine.valve(space).marks) for space in ("/a", "/b", "/c")] == [1, 0, 1]


def test_the_recorder_ends_with_the_page_and_its_last_word_is_shown(tmp_path, monkeypatch):
    """In place of the recorder a process that is deaf to Ctrl-C."""
    script = tmp_path / "python"
    deaf = (
        "import signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); print('[INFO] [1.0] [r]: begins'"
    )
    script.write_text(f'#!/bin/sh\nexec {sys.executable} -c "{deaf}, flush=True); time.sleep(60)"\n')
    script.chmod(0o755)
    monkeypatch.setattr("valve_control.dashboard.recording.sys.executable", str(script))
    monkeypatch.setattr("valve_control.dashboard.recording.PATIENCE", 0.2)
    recording = Recording(tmp_path / "made")
    assert recording.text == "" and not recording.running
    recording.start()
    while not recording.text.endswith(": begins"):
        assert recording.running
    recording.interrupt()
    recording.end()
    assert not recording.running and "status -15" in recording.text


NAMES = ("a", "b", "c")


@given(
    st.lists(
        st.one_of(
            st.dictionaries(st.sampled_from(NAMES), st.integers(0, 5), min_size=1),
            st.sampled_from(["undo", "redo"]),
        ),
        max_size=40,
    )
)  # fmt: skip
def test_undo_and_redo_lead_through_all_states(acts):
    changes, values = Changes(), dict.fromkeys(NAMES, 0)
    past, future = [dict(values)], []
    for k, act in enumerate(acts):
        if act in ("undo", "redo"):
            if (change := changes.newest(act)) is not None:
                values.update(change.before if act == "undo" else change.after)
                changes.acted(act, change)
                source, target = (past, future) if act == "undo" else (future, past)
                target.append(source.pop())
        elif after := differing(values, act):
            changes.add(Change(10.0 * k, {n: values[n] for n in after}, after, "here"), 10.0 * k)
            values.update(after)
            past.append(dict(values))
            future.clear()
        assert values == past[-1]


def test_a_slider_that_is_drawn_is_one_change():
    changes = Changes()

    def add(time, before, after, asked=None):
        changes.add(Change(time, before, after, "here"), time if asked is None else asked)

    for k in range(20):
        add(0.1 * k, {"k1": float(k)}, {"k1": k + 1.0})
    assert len(changes.done) == 1 and changes.newest("undo").before == {"k1": 0.0}
    # A node that takes long to answer tears no gesture apart: the pause counts, not the wait.
    add(5.0, {"k1": 20.0}, {"k1": 21.0}, asked=2.0)
    assert len(changes.done) == 1 and changes.newest("undo").before == {"k1": 0.0}
    add(6.5, {"k2": 1.0}, {"k2": 2.0})
    add(9.0, {"k2": 2.0}, {"k2": 3.0})
    assert [change.after for change in changes.done] == [{"k1": 21.0}, {"k2": 2.0}, {"k2": 3.0}]
    add(9.5, {"k2": 3.0}, {"k2": 2.0})  # and back: undo has nothing to take back
    assert len(changes.done) == 2


START = 1.8e9  # s, a time of today


def filled(count, period=0.001, values=None, parts=7):
    history = History()
    time = START + period * np.arange(count)
    values = np.sin(time - START) if values is None else values
    for t, v in zip(np.array_split(time, parts), np.array_split(values, parts), strict=True):
        history.append(t, v)
    return history, time, values


@given(
    count=st.integers(1, 60_000),
    columns=st.integers(10, 900),
    part=st.tuples(st.floats(0.0, 1.0), st.floats(0.001, 1.0)),
    seed=st.integers(0, 100),
)
def test_the_course_has_the_extremes_of_what_it_shows(count, columns, part, seed):
    values = np.random.default_rng(seed).standard_normal(count)
    history, time, _ = filled(count, values=values)
    span = part[1] * (time[-1] - time[0] + 0.01)
    start = time[0] + part[0] * (time[-1] - time[0])
    course = history.course(start, start + span, columns)
    assert len(course.time) <= 2 * columns + 2
    assert np.all(course.low <= course.high) and np.all(np.diff(course.time) >= 0.0)
    margin = 2.0 * span / columns + 0.001  # whole columns may reach over the ends
    inside = values[(time > start + margin) & (time < start + span - margin)]
    around = values[(time >= start - margin) & (time <= start + span + margin)]
    if len(inside):
        assert course.low.min() <= inside.min() and course.high.max() >= inside.max()
    if len(course.low):
        assert course.low.min() >= around.min() and course.high.max() <= around.max()


def test_the_longest_plot_is_there_at_1_khz_and_what_is_older_is_forgotten():
    history = History()
    for k in range(600):
        time = START + 0.001 * np.arange(k * 1000, (k + 1) * 1000)
        history.append(time, time - START)
        assert len(history) <= ROOM
    end = START + 0.001 * 599_999
    time, values = history.between(end - LONGEST, end)
    assert len(time) == pytest.approx(120_000, abs=1)
    assert values[0] == pytest.approx(end - LONGEST - START, abs=0.0011)
    history.append(end + 0.001 * np.arange(1, ROOM), np.zeros(ROOM - 1))  # more at once than there is room
    assert len(history) <= ROOM and history.newest == pytest.approx(end + 0.001 * (ROOM - 1))


def test_indices_over_the_last_seconds_are_those_of_the_analysis():
    error, time, e = filled(9000, values=np.random.default_rng(1).standard_normal(9000))
    voltage, _, u = filled(9000, values=np.random.default_rng(2).standard_normal(9000))
    found = recent_indices(error, voltage, 5.0, 0.001, time[-1] + 0.9)
    expected = indices(e[-5001:], u[-5001:], 0.001)
    assert found == pytest.approx(expected)
    late, _, _ = filled(9000)
    late.append(time[-1:] + 10.0, np.zeros(1))
    assert recent_indices(late, voltage, 5.0, 0.001, time[-1]) is None  # they do not belong together
    assert recent_indices(History(), voltage, 5.0, 0.001, time[-1]) is None
    assert recent_indices(error, voltage, 5.0, 0.001, time[-1] + 1.1) is None  # the loop has fallen silent


GAIN = Parameter("k", 1.0, "", "", 0.001, 1e5)
FROM_ZERO = Parameter("ki", 1.0, "", "", 0.0, 1e9)
NARROW = Parameter("share", 0.0, "", "", -1.0, 1.0)


@pytest.mark.parametrize("parameter", CONTROLLER, ids=lambda p: p.name)
def test_what_is_shown_is_read_as_the_same_value(parameter):
    assert from_text(parameter, shown(parameter.default)) == parameter.default


@given(place=st.integers(0, STEPS))
@pytest.mark.parametrize("parameter", [GAIN, FROM_ZERO, NARROW], ids=lambda p: p.name)
def test_a_slider_stays_where_it_is_put(parameter, place):
    s = scale(parameter)
    assert parameter.low <= s.value(place) <= parameter.high
    assert s.place(s.value(place)) == place


@pytest.mark.parametrize("high", [99, 999])
def test_a_slider_of_whole_numbers_gives_the_number_at_which_it_stands(high):
    s = scale(Parameter("n", 1, "", "", 0, high))
    found = [s.value(s.place(n)) for n in range(100)]
    assert found == list(range(100)) and all(isinstance(n, int) for n in found)


def test_ranges_over_decades_are_logarithmic_and_reach_both_ends():
    assert scale(GAIN).value(500) == pytest.approx(math.sqrt(0.001 * 1e5), rel=1e-3)
    for parameter in (GAIN, FROM_ZERO, NARROW):
        s = scale(parameter)
        assert (s.value(0), s.value(STEPS)) == (parameter.low, parameter.high)
    assert 0.0 < scale(FROM_ZERO).value(1) < 2.0 and scale(NARROW).value(500) == 0.0
    assert scale(Parameter("n", 1, "", "", 0, 100_000)).value(1) < 1.1  # not thousands at once
    assert scale(Parameter("x", 1.0, "", "")) is None and scale(Parameter("s", "a", "", "")) is None
