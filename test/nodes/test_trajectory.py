# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""`spool_trajectory` over DDS: the controller, the command source, the recorder."""

import math
import time

import numpy as np
import pytest
import rclpy
from bench import Bench, controller, spin_until
from diagnostic_msgs.msg import DiagnosticArray
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64
from trajectory_msgs.msg import JointTrajectoryPoint

from research.campaigns.processes import process
from valve_control.control.parameters import build
from valve_control.control.parameters.table import COMMAND
from valve_control.control.supervision.watch import BOTH
from valve_control.nodes.adapter import decoded_point
from valve_control.parameter import defaults, updated

NUMBERS = st.lists(st.floats(-1e6, 1e6), max_size=4)


@given(NUMBERS, NUMBERS, NUMBERS, NUMBERS, st.integers(0, 10**6), st.integers(0, 10**9 - 1))
def test_points_are_read_as_ros_writes_them(positions, velocities, accelerations, effort, sec, nanosec):
    message = JointTrajectoryPoint(
        positions=positions, velocities=velocities, accelerations=accelerations, effort=effort
    )
    message.time_from_start.sec, message.time_from_start.nanosec = sec, nanosec
    data = serialize_message(message)
    point = decoded_point(data)
    assert [list(part) for part in point[:3]] == [positions, velocities, accelerations]
    assert point.time == sec * 10**9 + nanosec
    for length in range(len(data)):  # what is cut off may be padding
        assert decoded_point(data[:length]) in (None, point)
    assert decoded_point(data[:19]) is None


def point(position, *derivatives, seconds=0.0):
    message = JointTrajectoryPoint(positions=[position])
    if derivatives:
        message.velocities, message.accelerations = [derivatives[0]], [derivatives[1]]
    message.time_from_start.sec = int(seconds)
    message.time_from_start.nanosec = round((seconds - int(seconds)) * 1e9)
    return message


@pytest.mark.parametrize("law", ["arc", pytest.param("open_loop", marks=pytest.mark.campaign)])
def test_the_controller_follows_refuses_and_tells(ros, tmp_path, law):
    said = []
    with controller(tmp_path, "-p", f"controller:={law}"):
        bench = Bench(ros)
        trajectory = ros.create_publisher(JointTrajectoryPoint, "spool_trajectory", 10)
        ros.create_subscription(DiagnosticArray, "/diagnostics", said.append, 50)
        bench.connect()
        spin_until(ros, lambda: trajectory.get_subscription_count() == 1, "subscription")

        def reasons():
            return {s.message for a in said for s in a.status if s.name == "controller"}

        def told(text):
            spin_until(ros, lambda: any(text in reason for reason in reasons()), f"'{text}', not {reasons()}")

        def state():
            return bench.states[-1].data[2]

        def wait_for_command(wanted):
            end = time.monotonic() + 10.0
            while not bench.states or abs(state() - wanted) > 1e-9:
                assert time.monotonic() < end, f"{state()} is not {wanted}"
                bench.sample(0.0)
                rclpy.spin_once(ros, timeout_sec=0.01)

        for k in range(20):
            trajectory.publish(point(0.05, 0.0, 0.0, seconds=1.0 + 0.001 * k))
            time.sleep(0.005)
            bench.sample(0.0)
        wait_for_command(0.05)
        trajectory.publish(point(0.2, seconds=1.1))
        trajectory.publish(point(math.nan, 0.0, 0.0, seconds=1.1))
        time.sleep(0.05)
        bench.sample(0.0)
        told("1 position, 0 velocities and 0 accelerations refused")
        wait_for_command(0.05)
        for k in range(1100):
            trajectory.publish(point(0.05, 0.0, 0.0, seconds=2.0 + 0.001 * k))
            bench.sample(0.0)
        trajectory.publish(point(0.3, 0.0, 0.0, seconds=0.5))
        time.sleep(0.05)
        bench.sample(0.0)
        told("before that of the last one")
        wait_for_command(0.05)
        bench.command.publish(Float64(data=0.4))
        time.sleep(0.05)
        bench.sample(0.0)
        told(BOTH)
        wait_for_command(0.05)
        ros.destroy_publisher(trajectory)
        spin_until(ros, lambda: ros.count_publishers("spool_trajectory") == 0, "its end")
        time.sleep(0.5)  # a look at the graph every 0.1 s
        bench.command.publish(Float64(data=0.04))
        time.sleep(0.05)
        wait_for_command(0.04)


def test_the_command_source_sends_trajectories_every_few_samples(ros, tmp_path):
    got = []
    ros.create_subscription(JointTrajectoryPoint, "spool_trajectory", got.append, 100)
    words = (
        "message:=trajectory",
        "every:=10",
        "scenario:=sine",
        "frequency:=1.0",
        "delay:=0.1",
        "start:=0.0",
    )
    settings = [word for w in words for word in ("-p", w)]
    with process("command_source", settings, tmp_path / "s.log"):
        spin_until(ros, lambda: len(got) >= 60, "60 points")
    values = updated(COMMAND, defaults(COMMAND), {"scenario": "sine", "frequency": 1.0, "start": 0.0})
    commands = build.commands(values)
    rates, accels = build.derivatives(commands, 0.001)
    sent = set(zip(commands.tolist(), rates.tolist(), accels.tolist(), strict=True))
    assert all((m.positions[0], m.velocities[0], m.accelerations[0]) in sent for m in got)
    times = [m.time_from_start.sec + 1e-9 * m.time_from_start.nanosec for m in got]
    steps = np.diff(times) / 0.01
    assert np.all(steps > 0.5) and np.median(steps) == pytest.approx(1.0, abs=1e-3)
    w = 2.0 * math.pi
    k = np.arange(1, 999)
    assert np.allclose(rates[k], w * 2.92 * np.cos(w * k * 1e-3), atol=1e-3)
    assert np.allclose(accels[k], -w * w * 2.92 * np.sin(w * k * 1e-3), atol=1e-2)
