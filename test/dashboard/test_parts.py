# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Frames, changes, the stop, the recorder, and a valve's signals."""

import asyncio
import json
import sys
from concurrent.futures import Future

import numpy as np
import pytest
from frame import signals_of

from valve_control.dashboard.frames import ViewError, frame, view
from valve_control.dashboard.machine import Answer, Machine
from valve_control.dashboard.recording import Recording
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
        await asyncio.gather(machine.undo(valve, node), answered(3))
        assert node.values == {"kp": 2.0, "ki": 20.0}
        redo = asyncio.create_task(machine.redo(valve, node))
        undo = asyncio.create_task(machine.undo(valve, node))
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
