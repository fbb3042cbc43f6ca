# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Latencies, limits of commands, who writes, frames, programs, and a valve's signals."""

import asyncio
import json
import math
import time
from concurrent.futures import Future
from types import SimpleNamespace

import numpy as np
import pytest

from valve_control.control.commands.scenarios import SCENARIOS, command
from valve_control.control.parameters import build
from valve_control.control.parameters.table import COMMAND
from valve_control.dashboard.doing import RUNS
from valve_control.dashboard.entry import Field
from valve_control.dashboard.frames import ViewError, frame, sample, view
from valve_control.dashboard.generator import check, fastest, largest, paced
from valve_control.dashboard.latency import Latencies
from valve_control.dashboard.machine import Answer, Machine
from valve_control.dashboard.programs import Program
from valve_control.dashboard.tuning import Tuning
from valve_control.dashboard.valve import SIGNALS, NodeState, Valve
from valve_control.dashboard.writers import GONE, Writer, right
from valve_control.parameter import ParameterError, defaults, updated


def test_latencies_are_times_from_the_last_reading():
    latencies = Latencies()
    readings = 100.0 + 0.001 * np.arange(2000)
    voltages = readings + np.where(np.arange(2000) % 100 == 0, 0.0008, 0.0002)
    latencies.pair(readings, voltages)
    latencies.pair(readings, np.array([50.0, 500.0]))  # before all, and an hour after: no answers
    found = latencies.histogram()
    assert found.counts.sum() == 2000
    assert found.p50 == pytest.approx(0.2, rel=1e-3) and found.largest == pytest.approx(0.8, rel=1e-3)
    assert Latencies().histogram() is None


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_limits_of_a_command_bound_what_is_sent(scenario):
    changes = {"scenario": scenario, "amplitude": -1.5, "offset": 0.4, "steps": 3, "duration": 60.0}
    values = updated(COMMAND, defaults(COMMAND), changes)
    shape = build.shape(values)
    sent = np.array([command(shape, 0.0005 * k) for k in range(12_000)])
    assert np.max(np.abs(sent)) <= largest(shape) + 1e-12
    if scenario != "step":
        assert np.max(np.abs(np.diff(sent))) / 0.0005 <= fastest(shape) * (1.0 + 1e-6)
    if scenario == "step":
        assert math.isinf(fastest(shape))
    check(values, largest(shape), 1e9)
    with pytest.raises(ParameterError, match=f"the limit is {largest(shape) - 0.01:g} V"):
        check(values, largest(shape) - 0.01, 1e9)


@pytest.mark.parametrize(("known", "waited_for"), [(0, 1), (1, 1), (3, 3), (1000, 100)])
def test_a_command_waits_for_all_subscriptions_that_the_page_knows(known, waited_for):
    """Not for the first alone, which is the page itself: the controller would miss the beginning."""
    valve = Valve("/boom")
    valve.listeners = known
    valve.controller = NodeState("/boom/controller")
    valve.controller.values = {"sample_period": 0.002}
    values = updated(COMMAND, defaults(COMMAND), paced(valve))
    assert (values["listeners"], values["sample_period"], values["start"]) == (waited_for, 0.002, 0.0)


def test_rates_beyond_the_limit_are_refused():
    values = updated(COMMAND, defaults(COMMAND), {"scenario": "sine", "frequency": 10.0, "amplitude": 1.0})
    with pytest.raises(ParameterError, match="as fast as 62.83 V/s; the limit is 60 V/s"):
        check(values, 10.0, 60.0)


def test_one_window_writes_a_reload_keeps_it_and_a_closed_one_gives_it_up():
    writer = Writer()
    assert not writer.claim("", 0.0)  # a window that is not connected yet
    assert writer.claim("a", 0.0) and not writer.claim("b", 1.0)
    assert writer.claim("a", 2.0)
    assert not writer.claim("b", 2.0 + 0.9 * GONE)
    assert writer.claim("a", 2.0 + 0.95 * GONE)  # loaded anew
    assert not writer.claim("b", 2.0 + 1.9 * GONE)
    assert writer.claim("b", 2.0 + 2.0 * GONE) and not writer.writes("a")
    assert writer.claim("a", 3.0 + 2.0 * GONE, by_force=True) and not writer.writes("b")
    assert not writer.writes("") and right("x", "x") and not right("x", "") and not right("x", "é")


def test_a_valve_pairs_readings_with_the_command_that_held():
    valve = Valve("/boom")
    t = 0.001 * np.arange(10)
    valve.commanded(np.array([-1.0, 0.0045]), np.array([1.0, 2.0]))
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
    valve.commanded(t, np.sin(t))
    valve.mark(1008.0, "k1 1 → 2")
    text = (
        '{"valve": "/", "signals": ["command", "voltage", "term.none"], "span": 5, "end": 1009.0, '
        '"columns": 300}'
    )
    got = sample(frame(machine, view(text), 1010.0))
    assert set(got) == {"command", "voltage", "term.none"} and got["voltage"].shape == (3, 0)
    time_, low, high = got["command"]
    assert 290 <= len(time_) <= 302 and np.all(low <= high) and -0.1 < time_[0] < time_[-1] < 5.1
    assert low.min() == pytest.approx(np.sin(t[4000:9000]).min(), abs=1e-3)
    joints = [f"axis.position of {joint}" for joint in range(6)]  # as many as the node takes
    terms = [f"term.{number}" for number in range(6)]  # as many as plots.js shows
    every = [*SIGNALS, *terms, *joints, "axis.goal", "axis.pressure_a", "axis.pressure_b"]
    whole = text.replace('["command", "voltage", "term.none"]', json.dumps(every))
    assert list(sample(frame(machine, view(whole), 1010.0))) == every
    for wrong in (
        "",
        "[]",
        "{}",
        text.replace("300", '"x"'),
        text.replace("5,", "1e999,").replace("1009.0", "NaN"),
    ):
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
        node.answered({name: Field(name, "double", "") for name in ("kp", "ki")}, {"kp": 1.0, "ki": 20.0})

        async def answered(count):
            while len(link.asked) < count:
                await asyncio.sleep(0)
            link.asked[count - 1][1].set_result("")

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

    asyncio.run(asyncio.wait_for(run(), 10.0))


def test_a_stop_asks_controllers_that_are_said_to_rest_too():
    """One was activated elsewhere since its diagnostics; the other one refuses, for it does rest."""
    answers = {
        "/a/controller": Answer(True, ""),
        "/b/controller": Answer(False, "/b/controller refused to deactivate"),
    }
    asked = []

    class Link:
        def transition(self, node, name):
            asked.append(node)
            answer = Future()
            answer.set_result(answers[node])
            return answer

    machine = Machine(Link())
    for space in ("/a", "/b"):
        machine.valve(space).controller = NodeState(f"{space}/controller")
        machine.valve(space).controller.state = "inactive"
    assert asyncio.run(machine.stop()) == [] and asked == list(answers)
    assert len(machine.valve("/a").marks) == 1 and not machine.valve("/b").marks


def test_a_value_of_a_slider_goes_to_no_other_valve():
    """It waits for the answer of its own node, and meanwhile another valve was chosen."""
    form = Tuning.__new__(Tuning)
    form._page = SimpleNamespace(
        valve=Valve("/b"), controller=NodeState("/b/controller"), allowed=lambda: True
    )
    asyncio.run(form.enter(Field("kp", "double"), "2.0", NodeState("/a/controller")))
    assert not form._page.controller.drafts and not form._page.controller.version


def test_a_command_tells_which_files_it_wrote(tmp_path):
    words = ["simulate", "--controller", "pid", "--duration", "0.1", "--csv", "a: b.csv", "--figure", "f.svg"]
    program = Program("simulate", ["valve_control.cli", *words], tmp_path)
    end = time.monotonic() + 60.0
    while not program.ended:
        assert time.monotonic() < end, list(program.lines)
        time.sleep(0.01)
    assert program.status == 0 and sorted(program.wrote) == ["a: b.csv", "f.svg"], list(program.lines)
    assert "wrote a: b.csv" in program.lines


def test_a_long_search_tells_how_much_is_done(tmp_path):
    words = ["study", "--controller", "pid", "--valves", "20000", "--folder", "study"]
    program = Program("study", ["valve_control.cli", *words], tmp_path)
    try:
        end = time.monotonic() + 100.0
        while math.isnan(program.share):
            assert time.monotonic() < end and program.running, list(program.lines)
            time.sleep(0.01)
        assert 0.0 < program.share < 1.0
    finally:
        program.end()


def test_the_page_offers_runs_that_the_command_has():
    from valve_control.cli.command import Commands

    assert set(RUNS) <= set(Commands().parsers)


def test_a_program_shows_its_progress_and_ends_when_it_is_told(tmp_path):
    script = tmp_path / "busy.py"
    script.write_text(
        "import sys, time\n"
        "print('begins', flush=True)\n"
        "sys.stderr.write('10 %\\r20 %'); sys.stderr.flush()\n"
        "time.sleep(60)\n"
    )
    program = Program("busy", ["busy"], tmp_path)
    try:
        end = time.monotonic() + 20.0
        while program.progress != "20 %":
            assert time.monotonic() < end, list(program.lines)
            time.sleep(0.01)
        assert program.running and list(program.lines) == ["begins"]
    finally:
        program.end()
    assert not program.running and program.state == "cancelled"


@pytest.mark.parametrize("word", ["nan", "inf", "-1.0", "0.0", "none", ""])
def test_a_period_that_is_none_leaves_the_last_one(word):
    """With NaN the indices of the page raised, once a second."""
    valve = Valve("/")
    valve.status("info", "ok", "", {"period_ms": "2.0"}, 0.0)
    valve.status("info", "ok", "", {"period_ms": word}, 1.0)
    assert valve.period == 0.002
