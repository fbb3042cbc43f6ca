# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""valve-control commission over DDS: to its end, undone, stopped at random moments, killed."""

import itertools
import json
import os
import random
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager

import domains
import numpy as np
import pytest
import rclpy
from bench import call, set_parameters, spin_until
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python

from benchmarks import commissioned
from research.campaigns import strangers
from research.campaigns.processes import Listener, process
from valve_control.control.parameters import files
from valve_control.control.parameters.table import CONTROLLER
from valve_control.nodes import commissioning_client

VOLTAGE, TRAVEL = 3.5, 1.5  # V
PERIOD = 0.004  # s: four times the usual one, since a busy machine is late by some ms
# The simulated valve waits for its voltage, so that a busy machine is no dead time.
VALVE = ["-p", f"sample_period:={PERIOD}", "-p", "patience:=1.0", "-p", "disturbance.offset:=0.2"]
VALVE += ["-p", "friction.coulomb:=0.6", "-p", "lvdt.noise:=0.004"]
# On a busy machine readings are late and lost, which is not what is tested here.
PATIENT = [
    "-p",
    f"sample_period:={PERIOD}",
    "-p",
    "lvdt.hold_samples:=1000",
    "-p",
    "lvdt.period_limit:=1000.0",
]
PATIENT += ["-p", "command_timeout:=0.0", "-p", "lvdt.frozen_samples:=0"]
BEFORE = ["-p", "controller:=arc", "-p", "arc.k1:=77.0", "-p", "u_max:=9.0", "-p", "reshaping.lead:=0.004"]
QUICK = ["--budget", "60", "--valves", "3", "--unseen", "8", "--max-chatter", "0.4"]


NUMBERS = itertools.count(domains.RUN + 8 * domains.WORKER)


@pytest.fixture
def ros(monkeypatch):
    """A node in a domain that no other test uses: what was killed stays in its graph for a while."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(215 + next(NUMBERS) % 17))
    rclpy.init()
    node = rclpy.create_node("test")
    yield node
    node.destroy_node()
    rclpy.shutdown()


class Everything:
    """Every voltage and reading, and services of the controller."""

    def __init__(self, ros, namespace=""):
        self.ros = ros
        self.node = f"{namespace}/controller"
        self.topic = f"{namespace}/valve_voltage"
        self.listener = Listener(
            f"listener{namespace.replace('/', '_')}", (self.topic, f"{namespace}/spool_position")
        )
        self.limited = []  # times [ns] and values [V] of u_max
        ros.create_subscription(ParameterEvent, "/parameter_events", self._note, 100)

    def _note(self, event):
        for changed in event.changed_parameters:
            if event.node == self.node and changed.name == "u_max":
                stamp = event.stamp.sec * 10**9 + event.stamp.nanosec
                self.limited.append((stamp, changed.value.double_value))

    def fetch(self):
        self.listener.fetch()
        return True

    def largest(self):
        """The largest voltage [V] while the controller had its limit."""
        assert self.limited[0][1] == VOLTAGE
        stamps = np.array(self.listener.stamps[self.topic])
        since, limits = np.array([(0, 0.0), *self.limited]).T
        during = limits[np.searchsorted(since, stamps) - 1] == VOLTAGE
        given = np.abs(self.listener.values[self.topic])[during]
        assert len(given) > 100  # an end in the noise at rest comes after 200
        return np.max(given)

    @property
    def voltages(self):
        self.listener.fetch()
        return self.listener.values[self.topic]

    def parameters(self):
        names = [p.name for p in CONTROLLER]
        got = call(
            self.ros, GetParameters, f"{self.node}/get_parameters", GetParameters.Request(names=names)
        ).values
        return {
            name: value if isinstance(value, (bool, int, float, str)) else list(value)
            for name, value in zip(names, map(parameter_value_to_python, got), strict=True)
        }

    def active(self):
        answer = call(self.ros, GetState, f"{self.node}/get_state", GetState.Request())
        return answer.current_state.id == State.PRIMARY_STATE_ACTIVE


@contextmanager
def running(ros, tmp_path, *more):
    with (
        process("valve_simulator", VALVE, tmp_path / "sim.log") as simulator,
        process("controller", [*BEFORE, *PATIENT, *more], tmp_path / "c.log") as controller,
    ):
        seen = Everything(ros)
        seen.processes = [simulator, controller]
        try:
            spin_until(ros, lambda: len(seen.voltages) > 100, "voltages")
            yield seen
        finally:
            seen.listener.destroy_node()


@contextmanager
def commission(tmp_path, *arguments):
    command = [sys.executable, "-m", "valve_control.cli", "commission", "--folder", str(tmp_path / "kept")]
    if "--undo" not in arguments:
        command += ["--yes", "--max-voltage", str(VOLTAGE), "--travel", str(TRAVEL)]
    with (tmp_path / "said.log").open("w") as said:
        child = subprocess.Popen(
            [*command, *arguments],
            stdout=said,
            stderr=said,
            stdin=subprocess.DEVNULL,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
        try:
            yield child
        finally:
            child.kill()
            child.wait()


def ended(seen, child, limit=60.0):
    """Exit status, with every message fetched meanwhile."""
    spin_until(seen.ros, lambda: seen.fetch() and child.poll() is not None, "end of commission", limit)
    return child.returncode


def begun(seen, tmp_path, child):
    """The parameters from before are kept."""
    state = tmp_path / "kept" / "state.json"
    spin_until(seen.ros, lambda: state.exists() or child.poll() is not None, "the backup", 60.0)
    assert child.poll() is None, (tmp_path / "said.log").read_text()


# Of each step: what commission says when it begins, within how many seconds from then on it is ended, and
# what makes it long enough for that, or those before it short. A commissioning has the whole tests of those
# before it, so that only the first two of a valve take longer than the step in which they are ended.
SEARCH = ["--controller", "dcarc", "--budget", "5000", "--valves", "6"]
STEPS = {
    "noise at rest": ("next: 0 V; the controller gets its limits", 2.0, SEARCH),
    "slow triangle": ("next: a slow triangle", 5.0, SEARCH),
    "stepped sine": (" s of sines of", 18.0, SEARCH),
    "model": ("model …", 0.6, SEARCH),
    "tuning": (" sets of gains of", 4.0, SEARCH),
    "verification": ("the valve moves for", 2.0, ["--controller", "dcarc", *QUICK]),
}
FIRST = 0.8  # s  of each step at least, but of the model's; until then the controller has its limits
HOWS = ["SIGINT", "SIGTERM", "silent", "not_finite", "second_publisher", "no simulator"]


def moments():
    """How and when (step, share of its seconds) the commissionings of each of three valves are ended."""
    chosen = random.Random(395)
    hows = iter(chosen.sample(HOWS, len(HOWS)))
    valves = ["noise at rest", "stepped sine", "verification"], ["slow triangle", "model", "tuning"]
    last = [("no controller", chosen.choice(["noise at rest", "slow triangle"]), chosen.random())]
    return [*([(next(hows), step, chosen.random()) for step in steps] for steps in valves), last]


def step_of(said):
    """The step that commission said last."""
    return max(STEPS, key=lambda step: said.rfind(STEPS[step][0]))


def together(ros, *flows):
    """Goes on with each flow, a generator, when the condition that it gave last holds.

    When one fails the others are closed, so that what they have started does not meet the next try.
    """

    def next_of(flow):
        condition, what, limit = next(flow)
        return condition, what, time.monotonic() + limit

    with ExitStack() as stack:
        for flow in flows:
            stack.callback(flow.close)
        waits = {flow: next_of(flow) for flow in flows}
        while waits:
            rclpy.spin_once(ros, timeout_sec=0.02)
            for flow, (condition, what, end) in list(waits.items()):
                if condition():
                    try:
                        waits[flow] = next_of(flow)
                    except StopIteration:
                        del waits[flow]
                else:
                    assert time.monotonic() < end, f"{what} not in time"


def aborted(ros, stack, folder, namespace, planned, reached):
    """Flow of one valve whose commissioning is ended as ``planned``; ``reached`` gets the steps."""
    folder.mkdir()
    place, node = ["-r", f"__ns:={namespace}"], f"{namespace[1:]}/controller"
    simulator = stack.enter_context(process("valve_simulator", [*VALVE, *place], folder / "sim.log"))
    controller = stack.enter_context(process("controller", [*BEFORE, *PATIENT, *place], folder / "c.log"))
    seen = Everything(ros, namespace)
    stack.callback(seen.listener.destroy_node)
    yield lambda: len(seen.voltages) > 100, "voltages", 60.0
    assert set_parameters(ros, node, arc__k2=88.0).successful  # which no file and no option has
    before = seen.parameters()
    log, others = folder / "said.log", stack.enter_context(ExitStack())
    for how, step, share in planned:
        words, longest, settings = STEPS[step]
        kept = folder / "kept"
        resumed = ["--resume", str(kept)] if (kept / "tests.npz").exists() else []
        with commission(folder, "--node", f"/{node}", *settings, *resumed) as child:

            def over(child=child):
                return seen.fetch() and child.poll() is not None

            yield lambda: over() or words in log.read_text(), f"the step {step}", 300.0  # noqa: B023
            first = 0.0 if step == "model" else FIRST
            until = len(seen.voltages) + (first + share * (longest - first)) / PERIOD
            yield lambda: over() or len(seen.voltages) >= until, "voltages", 120.0  # noqa: B023
            said = log.read_text()
            assert child.poll() is None, said
            reached.append(step_of(said))
            count = len(seen.voltages)
            if how.startswith("SIG"):
                child.send_signal(getattr(signal, how))
            elif how == "no simulator":
                simulator.kill()
            elif how == "no controller":
                controller.kill()
            elif how == "second_publisher":
                others.enter_context(strangers.rival(ros, f"{namespace}/spool_position"))
            else:
                assert set_parameters(ros, f"{namespace[1:]}/valve_simulator", fault__lvdt=how).successful
            yield over, "end of commission", 60.0
        said = log.read_text()
        print(f"{how} in {step}, {share:.2f}: {len(seen.voltages) - count} more voltages")
        assert child.returncode == (130 if how.startswith("SIG") else 1), said
        assert "Traceback" not in said
        if step == "tuning":  # after a test that was whole
            assert STEPS["slow triangle"][0] not in said and STEPS["stepped sine"][0] not in said
        assert seen.largest() <= VOLTAGE
        if how == "no controller":
            break
        assert "the controller was switched to 0 V" in said
        assert "all its parameters are as before" in said
        assert seen.active() and ("it is active, as before" in said) == how.startswith(("SIG", "second"))
        if step in ("tuning", "verification"):
            valve = files.load(str(folder / "kept" / "valve.yaml"))["valve_simulator"]
            assert valve["friction.coulomb"] == pytest.approx(0.6, abs=0.06), "the model stays"
        assert seen.parameters() == before, said
        if how == "no simulator":
            simulator.wait()
            # What was killed stays in the graph for a while, as a second LVDT.
            topic = f"{namespace}/spool_position"
            yield lambda: ros.count_publishers(topic) == 0, "its end", 60.0  # noqa: B023
            simulator = stack.enter_context(process("valve_simulator", [*VALVE, *place], folder / "s2.log"))
        elif how == "second_publisher":
            others.close()
        elif not how.startswith("SIG"):
            target = f"{namespace[1:]}/valve_simulator"
            assert set_parameters(ros, target, fault__lvdt="none").successful
    else:
        return
    assert "its previous parameters are in" in said and "--undo restores them" in said
    # The valve is without a voltage, and its spring has centred it: where 0 V and the offset put it.
    seen.fetch()
    position = np.median(seen.listener.values[f"{namespace}/spool_position"][-3:])
    assert position == pytest.approx(0.2 * 0.829, abs=0.4)
    controller.wait()
    stack.enter_context(process("controller", [*BEFORE, *PATIENT, *place], folder / "c2.log"))
    with commission(folder, "--node", f"/{node}", "--undo") as child:
        yield lambda: seen.fetch() and child.poll() is not None, "undo", 60.0
    assert child.returncode == 0, log.read_text()
    assert seen.parameters() == before


@pytest.mark.alone
@pytest.mark.campaign
def test_aborted_at_random_moments(ros, tmp_path):
    """By Ctrl-C, SIGTERM, faults of the LVDT, and the death of either node, in every step.

    Three valves are commissioned beside each other, each on one pair of nodes.
    """
    reached, planned = [], moments()
    with ExitStack() as stack:
        together(
            ros,
            *(
                aborted(ros, stack, tmp_path / side, f"/{side}", part, reached)
                for side, part in zip("abc", planned, strict=True)
            ),
        )
    assert sorted(reached) == sorted(step for part in planned for _, step, _ in part)
    assert set(reached) == set(STEPS)


@pytest.mark.alone
@pytest.mark.campaign
def test_to_its_end_and_undone_while_its_processes_pause(ros, tmp_path):
    """One of the three stands still for 5 to 60 ms every 5 to 15 s; 20 ms are 0 V."""
    with running(ros, tmp_path, "-p", "lvdt.hold_samples:=4") as seen:
        before = seen.parameters()
        with (
            commission(tmp_path, "--controller", "dcarc", *QUICK) as child,
            commissioned.pausing([*seen.processes, child], 44) as stood,
        ):
            status = ended(seen, child, 400.0)
        log = tmp_path / "said.log"
        assert status == 0, log.read_text()
        after = seen.parameters()
        found = json.loads((tmp_path / "kept" / "commission.json").read_text())
        assert len(stood) > 3 and sum(found["pauses"].values()) >= 1, found["pauses"]
        assert any("paused" in note for note in found["notes"])
        assert seen.largest() <= VOLTAGE and seen.active()
        assert after == {**before, **found["applied"]} and after["controller"] == "dcarc"
        told = files.load(str(tmp_path / "kept" / "tuned.yaml"))["controller"]
        assert told.items() >= found["applied"].items() and told["u_max"] == 9.0
        assert found["valve"]["friction"]["coulomb"] == pytest.approx(0.6, abs=0.06)
        assert found["valve"]["static_gain"] == pytest.approx(0.829, rel=0.03)
        assert found["valve"]["offset"] == pytest.approx(0.2, abs=0.03)
        with commission(tmp_path, "--undo") as child:
            assert ended(seen, child) == 0, log.read_text()
        assert seen.parameters() == before and seen.active()


@pytest.mark.campaign
def test_killed_it_leaves_the_valve_at_neutral_and_can_be_undone(ros, tmp_path):
    with running(ros, tmp_path) as seen:
        before = seen.parameters()
        with commission(tmp_path) as child:
            begun(seen, tmp_path, child)
            log, sought = tmp_path / "said.log", STEPS["slow triangle"][0]
            spin_until(ros, lambda: sought in log.read_text() or child.poll() is not None, "triangle", 60.0)
            spin_until(ros, lambda: abs(seen.voltages[-1]) > 1.0 or child.poll() is not None, "motion", 60.0)
            child.send_signal(signal.SIGKILL)
            ended(seen, child)
            # The controller keeps the limits, and leads to neutral by itself.
            spin_until(ros, lambda: np.max(np.abs(seen.voltages[-100:])) == 0.0, "0 V")
        assert seen.parameters() != before
        assert seen.largest() <= VOLTAGE
        with commission(tmp_path) as child:  # not with the parameters of a commissioning as those from before
            assert ended(seen, child) == 2
        assert "--undo restores them" in (tmp_path / "said.log").read_text()
        with commission(tmp_path, "--undo") as child:
            assert ended(seen, child) == 0
        assert seen.parameters() == before and seen.active()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--undo", "--folder", "nowhere"], "there is no commissioning in nowhere"),
        (["--max-voltage", "4", "--travel", "2"], "there is no controller /controller"),
        (["--max-voltage", "-1"], "--max-voltage: -1 is no number from 0.1"),
        (["--activate"], "commission without --undo takes no --activate"),
        (["--node", "a b"], "--node a b is no full name of a node"),
        (["--controller", "pidd"], "did you mean 'pid'"),
    ],
)
def test_what_cannot_be_is_one_sentence(run, tmp_path, arguments, words, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "102")
    monkeypatch.setattr(commissioning_client, "MEET", 0.5)  # nobody comes
    done = run("commission", "--yes", *arguments)
    assert done.status == 2 and words in done.err, done.err
    assert len(done.err.strip().splitlines()) == 1 and not list(tmp_path.iterdir())
    assert not rclpy.ok()
