# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Through real processes over DDS, sample by sample, bit for bit as offline."""

import signal
import time
from contextlib import ExitStack

import pytest
import sizes
from bench import run_tool, spin_until, wait_for_message
from std_msgs.msg import Float64

from research.campaigns.lockstep import CONFIG, run_lockstep
from research.campaigns.processes import process
from valve_control.control.laws.registry import LAWS
from valve_control.nodes.adapter import SAMPLES, NumberSubscription, encoded
from valve_control.nodes.lockstep import Lockstep


@pytest.mark.campaign
def test_the_motion_equals_offline_for_every_controller(tmp_path):
    entries = run_tool("lockstep", tmp_path, "--duration", str(sizes.LOCKSTEP))
    assert [e["controller"] for e in entries] == list(LAWS)
    for entry in entries:
        assert entry["equal"] and entry["samples"] == round(1000 * sizes.LOCKSTEP)
        assert entry["voltage_at_end_V"] == entry["offline_voltage_at_end_V"]


SOLENOID = {
    "valve": "solenoid", "solenoid.hysteresis": 0.2, "solenoid.dead_time": 0.0007, "solenoid.bits": 12,
    "friction.coulomb": 0.3, "friction.presliding": 0.02, "lvdt.delay": 0.0004, "lvdt.resolution": 0.0,
    "solenoid.hum": 0.003,
}  # fmt: skip


@pytest.mark.parametrize(
    ("law", "settings"),
    [
        ("dcarc", {"controller": {"reshaping.lead": 0.006}}),
        # A trajectory is taken for the reading that it was sent for; this law has no use for derivatives.
        ("open_loop", {"command_source": {"message": "trajectory"}}),
        ("pid", {"valve_simulator": SOLENOID}),
    ],
    ids=["lead", "trajectory", "solenoid"],
)
def test_other_commands_and_valves_equal_offline(ros, tmp_path, law, settings):
    settings = {
        **settings,
        "controller": {"controller": law, **settings.get("controller", {})},
        "command_source": {"duration": 0.5, **settings.get("command_source", {})},
    }
    run = run_lockstep("short", CONFIG, settings, tmp_path)
    assert run.result["equal"] and run.result["samples"] == 500, run.result["first_difference"]


class Disturbance:
    """Stops a node for a while in the middle of a run, when the command moves (from 0.25 s on)."""

    def __init__(self, node, seconds, at=400):
        self.node, self.seconds, self.at = node, seconds, at
        self.stopped = None
        self.over = False

    def __call__(self, children, done):
        if self.stopped is None and done >= self.at:
            children[self.node].send_signal(signal.SIGSTOP)
            self.stopped = time.monotonic()
        elif self.stopped is not None and not self.over and time.monotonic() > self.stopped + self.seconds:
            children[self.node].send_signal(signal.SIGCONT)
            self.over = True


@pytest.mark.parametrize(
    "node, seconds", [("controller", 2.5), pytest.param("command_source", 6.0, marks=pytest.mark.campaign)]
)
def test_a_process_that_stands_still_is_waited_for(ros, tmp_path, node, seconds):
    """No reading comes twice, and no sample goes without its command, however long it takes."""
    stop = Disturbance(node, seconds)
    run = run_lockstep("still", CONFIG, {"command_source": {"duration": 1.0}}, tmp_path, stop)
    assert stop.over
    assert run.result["equal"], run.result["first_difference"]
    assert run.samples["valve_voltage"][-1] == run.twin.voltage[-1]
    simulator = (tmp_path / "lockstep_still_valve_simulator.log").read_text()
    assert "waits" in simulator


def test_a_simulator_waits_for_a_controller(ros, tmp_path):
    """A listener that is no controller is not enough."""
    readings = []
    ros.create_subscription(Float64, "spool_position", lambda m: readings.append(m.data), SAMPLES)
    with ExitStack() as stack:
        log = tmp_path / "valve.log"
        stack.enter_context(process("valve_simulator", ["-p", "clock:=lockstep", "-p", "listeners:=1"], log))
        spin_until(ros, lambda: ros.count_publishers("spool_position") == 1, "the simulator")
        begun = time.monotonic()
        spin_until(ros, lambda: time.monotonic() > begun + 1.0, "a second")
        assert not readings
        stack.enter_context(process("controller", ["-p", "lockstep:=true"], tmp_path / "first.log"))
        spin_until(ros, lambda: readings, "the first reading")


def test_what_is_lost_moves_no_command_to_another_reading(ros):
    """Command 1 was sent before anybody heard it, and reading 3 is taken away."""
    sent = ros.create_publisher(Float64, "spool_command", SAMPLES)
    sent.publish(encoded(1.0))
    commands = NumberSubscription(ros, "spool_command", SAMPLES)
    readings = NumberSubscription(ros, "spool_position", SAMPLES)
    lvdt, used = ros.create_publisher(Float64, "spool_position", SAMPLES), []
    spin_until(ros, lambda: sent.get_subscription_count() == lvdt.get_subscription_count() == 1, "match")
    lockstep = Lockstep(ros, [commands], used.append, lambda: True)
    assert lockstep.next(readings) is None
    sent.publish(encoded(2.0))
    wait_for_message(ros, commands)
    for number, wanted in ((1, []), (2, [2.0])):
        lvdt.publish(encoded(0.1 * number))
        wait_for_message(ros, readings)
        assert lockstep.next(readings)[0] == 0.1 * number
        assert used == wanted
    lvdt.publish(encoded(0.3))
    wait_for_message(ros, readings)
    assert len([*readings.take()]) == 1
    for data in (3.0, 4.0):
        sent.publish(encoded(data))
    lvdt.publish(encoded(0.4))
    spin_until(ros, lambda: lockstep.next(readings), "reading 4")
    assert used == [2.0, 3.0, 4.0]
