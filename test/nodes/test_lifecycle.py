# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Managed nodes: states, transitions, and 0 V as the last word."""

import math
import signal

import pytest
import rclpy
from bench import Motion, call, controller, spin_until
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.parameter import Parameter
from std_msgs.msg import Float64

from research.campaigns.processes import process
from valve_control.nodes.controller_node import Controller


def state(ros, node):
    return call(ros, GetState, f"/{node}/get_state", GetState.Request()).current_state.label


def change(ros, node, transition):
    request = ChangeState.Request(transition=Transition(id=transition))
    return call(ros, ChangeState, f"/{node}/change_state", request).success


def test_inactive_controller_says_0_v_once_and_then_nothing(ros, tmp_path):
    """And transitions that its state does not have are refused."""
    motion = Motion(ros)
    bench = motion.bench
    with controller(tmp_path):
        for wrong in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_CLEANUP, 250):
            assert not change(ros, "controller", wrong)
        assert state(ros, "controller") == "active"
        bench.connect()
        motion.move(100)
        before = len(bench.voltages)
        assert change(ros, "controller", Transition.TRANSITION_DEACTIVATE)
        spin_until(ros, lambda: len(bench.voltages) > before, "0 V")
        for _ in range(50):
            bench.lvdt.publish(Float64(data=0.1))
        bench.settle()
        assert list(bench.voltages[before:]) == [0.0]
        assert change(ros, "controller", Transition.TRANSITION_ACTIVATE)
        assert abs(bench.sample(0.0)) <= 10.0
        assert change(ros, "controller", Transition.TRANSITION_DEACTIVATE)
        assert change(ros, "controller", Transition.TRANSITION_CLEANUP)
        spin_until(ros, lambda: ros.count_publishers("valve_voltage") == 0, "cleanup")
        assert change(ros, "controller", Transition.TRANSITION_CONFIGURE)
        assert change(ros, "controller", Transition.TRANSITION_ACTIVATE)
        spin_until(ros, lambda: ros.count_publishers("valve_voltage") == 1, "configuration")
        spin_until(ros, lambda: bench.lvdt.get_subscription_count() == 1, "subscription")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_last_word_is_0_v(ros, tmp_path, number):
    motion = Motion(ros)
    with controller(tmp_path) as child:
        motion.bench.connect()
        motion.move(120)
        assert motion.bench.voltages[-1] != 0.0
        child.send_signal(number)
        assert child.wait(10.0) == 0
        spin_until(ros, lambda: motion.bench.voltages[-1] == 0.0, "0 V")
    assert "Traceback" not in (tmp_path / "c.log").read_text()


def test_simulator_centres_itself_when_the_voltage_stops(ros, tmp_path):
    readings = []
    ros.create_subscription(Float64, "spool_position", lambda m: readings.append(m.data), 10)
    voltage = ros.create_publisher(Float64, "valve_voltage", 10)
    with process("valve_simulator", ["-p", "voltage_timeout:=0.05"], tmp_path / "log"):
        spin_until(ros, lambda: voltage.get_subscription_count() == 1, "simulator")

        def pushed():
            voltage.publish(Float64(data=5.0))
            return bool(readings) and readings[-1] > 3.0

        spin_until(ros, pushed, "motion")
        spin_until(ros, lambda: abs(readings[-1]) < 0.01, "the spring")
    assert "no voltage for 0.05 s" in (tmp_path / "log").read_text()


@pytest.mark.parametrize("configured", [False, True])
def test_a_node_that_does_not_work_shuts_down_without_a_voltage(ros, configured):
    heard = []
    ros.create_subscription(Float64, "valve_voltage", lambda m: heard.append(m.data), 10)
    node = Controller(cli_args=["--ros-args", "-p", "autostart:=false"])
    try:
        if configured:
            node.trigger_configure()
            spin_until(ros, lambda: node._voltages.get_subscription_count() == 1, "the subscription")
        node.trigger_shutdown()
        assert node._state_machine.current_state[1] == "finalized"
        node.finish()
        node.deliver()
        assert not node.work() and node.inputs() == () and node.due() == math.inf
        for _ in range(10):
            rclpy.spin_once(ros, timeout_sec=0.01)
        assert heard == []
    finally:
        node.destroy_node()


def test_a_cleanup_leaves_the_clock_to_rclpy(ros):
    """A subscription that rclpy made meanwhile is not the node's to destroy."""
    node = Controller(cli_args=["--ros-args", "-p", "autostart:=false"])
    try:
        node.trigger_configure()
        node.set_parameters([Parameter("use_sim_time", value=True)])
        node.trigger_cleanup()
        topics = {subscription.topic_name for subscription in node.subscriptions}
        assert "/clock" in topics and not topics & {"/spool_position", "/spool_command", "/spool_trajectory"}
    finally:
        node.destroy_node()
