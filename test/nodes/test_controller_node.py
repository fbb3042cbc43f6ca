# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""One controller in the process of the test, over DDS: when it acts, what it waits for, its last word."""

import math
import time
from contextlib import contextmanager

import numpy as np
import pytest
import rclpy
from bench import LIMIT, wait_for_message
from rclpy.parameter import Parameter
from std_msgs.msg import Float64, Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectoryPoint

from valve_control.control.supervision.journal import Event, block
from valve_control.control.supervision.memory import Mode
from valve_control.nodes import controller_node, lockstep, telemetry
from valve_control.nodes.adapter import EVERYTHING, SAMPLES, encoded, encoded_point
from valve_control.nodes.controller_node import Controller
from valve_control.nodes.loop import Failure


class Upper:
    """LVDT and upper level beside a controller; one thread has both."""

    def __init__(self, ros, node):
        self.ros, self.node = ros, node
        self.voltages, self.states = [], []
        self.lvdt = ros.create_publisher(Float64, "spool_position", SAMPLES)
        self.commands = ros.create_publisher(Float64, "spool_command", SAMPLES)
        ros.create_subscription(Float64, "valve_voltage", lambda m: self.voltages.append(m.data), SAMPLES)
        ros.create_subscription(Float64MultiArray, "/controller/state", self.states.append, SAMPLES)

    def hear(self):
        for _ in range(5):
            rclpy.spin_once(self.ros, timeout_sec=0.002)

    def until(self, condition, what, work=True):
        end = time.monotonic() + LIMIT
        while not condition():
            assert time.monotonic() < end, what
            if work and self.node.work():
                self.node.report()
            self.hear()

    def meet(self):
        met = (self.lvdt, self.commands)
        self.until(lambda: all(p.get_subscription_count() >= 1 for p in met), "subscriptions", work=False)
        self.until(lambda: self.ros.count_publishers("valve_voltage") >= 1, "publisher", work=False)
        self.until(lambda: self.node._voltages.get_subscription_count() >= 1, "our subscription", work=False)

    def sample(self, reading, command=None):
        """The voltage that answers ``reading``; it is sent again if the process stood still meanwhile."""
        before = self.node._supervisor.memory.samples
        if command is not None:
            self.commands.publish(encoded(command))
        while self.node._supervisor.memory.samples == before:
            taken = len(self.node._timing.arrivals)
            self.lvdt.publish(encoded(reading))
            self.until(lambda taken=taken: len(self.node._timing.arrivals) > taken, "an answer")
        return self.node._supervisor.voltage


@contextmanager
def controller(ros, *settings):
    slow = (
        "lvdt.hold_samples:=2000",
        "lvdt.frozen_samples:=0",
        "lvdt.period_limit:=1000.0",
        "state_decimation:=1",
    )
    words = [word for text in (*slow, *settings) for word in ("-p", text)]
    node = Controller(cli_args=["--ros-args", *words])
    upper = Upper(ros, node)
    try:
        upper.meet()
        yield upper
    finally:
        node.destroy_node()


def test_from_the_first_reading_to_the_last_word(ros):
    with controller(ros) as upper:
        node = upper.node
        assert node.inputs() == (node._readings,) and math.isfinite(node.due())
        upper.sample(0.0)
        given = [upper.sample(0.001 * k, 0.1) for k in range(5)]
        upper.until(
            lambda: upper.voltages[-5:] == given and upper.states and upper.states[-1].data[0] == 6.0,
            "voltages and states",
        )
        assert [state.data[0] for state in upper.states[-6:]] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
        count = len(upper.voltages)
        node.trigger_deactivate()
        node.deliver()
        upper.until(lambda: len(upper.voltages) > count, "0 V")
        assert upper.voltages[count:] == [0.0]
        upper.lvdt.publish(encoded(0.0))
        assert not node.work() and node.inputs() == () and node.due() == math.inf
        wait_for_message(node, node._readings)
        node.trigger_activate()
        samples = node._supervisor.memory.samples
        node.work()
        assert node._supervisor.memory.samples == samples, "what came meanwhile is stale"
        node.finish()
        assert node._state_machine.current_state[1] == "finalized"


def test_readings_of_another_period_are_reported_and_refuse_a_change_of_it(ros):
    with controller(ros, "lvdt.period_limit:=0.1") as upper:
        supervisor, send = upper.node._supervisor, upper.lvdt.publish
        upper.until(lambda: send(encoded(0.5)) or "readings come every" in supervisor.reason, "a sentence")
        assert supervisor.mode is Mode.SAFE and set(upper.voltages) <= {0.0}
        supervisor.memory.pace = supervisor.memory.pace._replace(means=(0.001,))
        result = upper.node.set_parameters_atomically([Parameter("sample_period", value=0.002)])
        assert "sample_period cannot become 2 ms while LVDT readings come every 1 ms" in result.reason


def test_silence_is_answered_again_and_again(ros, monkeypatch):
    with controller(ros) as upper:
        node = upper.node
        upper.sample(0.0)
        monkeypatch.setattr(controller_node, "REMIND", 0.0)
        node._silent_at = 0.0
        assert node.work() and node._supervisor.mode is Mode.SAFE
        node.report()
        count = len(upper.voltages)
        assert node.work()
        upper.until(
            lambda: len(upper.voltages) > count and upper.voltages[-1] == 0.0, "0 V once more", work=False
        )


def test_what_waited_while_the_process_stood_still_is_not_answered_as_new(ros):
    with controller(ros) as upper:
        node = upper.node
        upper.sample(0.0)
        upper.lvdt.publish(encoded(0.5))
        node._silent_at = time.monotonic() - 1.0
        samples, count = node._supervisor.memory.samples, len(node._journal)
        upper.until(lambda: len(node._journal) > count, "the stale reading")
        assert node._supervisor.memory.samples == samples and node._catching_up
        node._timing.arrivals[-1] -= 1.0
        upper.sample(0.0)
        assert not node._catching_up


def test_a_reader_of_the_journal_gets_every_row_and_an_account(ros, monkeypatch):
    monkeypatch.setattr(telemetry, "MOST_ROWS", 8)
    blocks, accounts = [], []
    ros.create_subscription(
        Float64MultiArray, "/controller/journal", lambda m: blocks.append(block(m.data)), EVERYTHING
    )
    ros.create_subscription(String, "/controller/memory", lambda m: accounts.append(m.data), EVERYTHING)
    with controller(ros, "memory_period:=1000.0") as upper:
        upper.until(lambda: upper.node._journal_topics._count_readers() == 2, "the readers", work=False)
        upper.node._watch_graph()
        for k in range(40):
            upper.sample(0.001 * (k % 2), 0.1)
        upper.node.trigger_deactivate()
        upper.until(lambda: blocks and blocks[-1].rows[-1, 1] == Event.STOP, "the last row", work=False)
        assert all(later.follows(sooner) for sooner, later in zip(blocks, blocks[1:], strict=False))
        events = np.concatenate([one.rows[:, 1] for one in blocks])
        assert np.count_nonzero(events == Event.READING) == 40 and len(accounts) >= 1


def test_an_upper_level_or_a_trajectory_that_leaves_is_known(ros):
    points = ros.create_publisher(JointTrajectoryPoint, "spool_trajectory", SAMPLES)
    with controller(ros) as upper:
        node = upper.node
        upper.until(lambda: points.get_subscription_count() >= 1, "the subscription")
        node._watch_graph()
        points.publish(encoded_point(0.1, 0.0, 0.0))
        upper.until(
            lambda: upper.sample(0.0) is not None and node._supervisor.memory.trajectory, "the trajectory"
        )
        refused = JointTrajectoryPoint(positions=[0.1, 0.2])
        points.publish(refused)
        upper.until(
            lambda: upper.sample(0.0) is not None and node._supervisor.memory.counts["command_refused"] == 1,
            "a refusal",
        )
        ros.destroy_publisher(points)
        upper.until(lambda: node.count_publishers("spool_trajectory") == 0, "its end")
        node._watch_graph()
        assert node._supervisor.memory.trajectory is None and not node._supervisor.memory.command.gone_since
        ros.destroy_publisher(upper.commands)
        upper.until(lambda: node.count_publishers("spool_command") == 0, "its end")
        node._watch_graph()
        assert node._supervisor.memory.command.gone_since
        node.trigger_deactivate()
        node.trigger_cleanup()
        node._watch_graph()


def test_in_lockstep_a_reading_waits_for_its_command(ros, monkeypatch, capfd):
    with controller(ros, "lockstep:=true", "controller:=open_loop") as upper:
        node = upper.node
        monkeypatch.setattr(lockstep, "REMIND", 0.0)
        upper.lvdt.publish(encoded(0.0))
        upper.until(lambda: node._lockstep.waiting and node.inputs() != (), "the reading")
        assert not node.work() and node.inputs() == (node._commands, node._trajectories)
        assert node.due() <= time.monotonic() + lockstep.LOOK and not node._timing.arrivals
        assert "lockstep: reading 1 waits for its command" in capfd.readouterr().err
        for number, wanted in enumerate((1.0, -1.0), start=1):
            upper.commands.publish(encoded(wanted))
            upper.until(lambda number=number: len(node._timing.arrivals) == number, "the answer")
            assert node._supervisor.voltage * wanted > 0.0
            upper.lvdt.publish(encoded(0.0))
        result = node.set_parameters_atomically([Parameter("lockstep", value=False)])
        assert not result.successful and "lockstep of a running node does not change" in result.reason


def test_lockstep_without_numbers_ends_in_one_sentence(ros):
    with controller(ros, "lockstep:=true") as upper:
        unnumbered = {"publication_sequence_number": 2**64 - 1, "source_timestamp": 0}
        upper.node._lockstep.waiting = (0.0, unnumbered)
        with pytest.raises(Failure, match="lockstep needs a middleware that numbers messages"):
            upper.node.work()
