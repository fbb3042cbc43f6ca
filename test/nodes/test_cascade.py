# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Real nodes as processes, real DDS."""

import math
import time

import numpy as np
import pytest
import rclpy
from bench import (
    Bench,
    call,
    controller,
    get_double,
    run_tool,
    set_parameters,
    spin_until,
)
from rcl_interfaces.srv import DescribeParameters
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64, Float64MultiArray

from research.campaigns import demo
from research.campaigns.processes import process
from valve_control.control.supervision.memory import HEAD
from valve_control.nodes.adapter import SAMPLES


def test_parameters_are_taken_as_a_whole_or_not_at_all(ros, tmp_path):
    bench = Bench(ros)
    with controller(tmp_path):
        bench.connect()
        refused = [
            ({"arc__k1": -1.0, "arc__k2": 90.0}, "arc.k1"),
            ({"arc__k2": 90.0, "arc__theta_min": [5.0, 500.0, 3000.0, 0.0]}, "theta_min[2]"),
            ({"arc__k2": 90.0, "controller": "lqr"}, "lqr"),
            ({"arc__k2": 90.0, "arc__k1": math.nan}, "arc.k1"),
            ({"arc__k2": 90.0, "reshaping__natural_frequency": 5000.0}, "below"),
            ({"arc__k2": 90.0, "arc__gamma": [1.0, 2.0]}, "arc.gamma"),
        ]
        for values, word in refused:
            result = set_parameters(ros, **values)
            assert not result.successful and word in result.reason, result.reason
            assert get_double(ros, "arc.k2") == 120.0
        assert set_parameters(ros, arc__k1=100.0, arc__k2=90.0).successful
        assert get_double(ros, "arc.k2") == 90.0
        bench.command.publish(Float64(data=1.0))
        for _ in range(30):
            bench.sample(0.0)
        described = call(
            ros,
            DescribeParameters,
            "/controller/describe_parameters",
            DescribeParameters.Request(names=["arc.k1"]),
        ).descriptors[0]
        assert "1/s" in described.description and described.floating_point_range[0].to_value == 1e5


@pytest.mark.alone
@pytest.mark.campaign
def test_demo_over_dds_equals_offline(tmp_path):
    """`make demo` for one controller, as a user runs it; all four are what `make demo` itself shows.

    A pause that only the operating system made is not in the offline run: above 10 ms the demo leaves it out;
    below, the step of the command that comes of it changes e_M by up to a quarter. So one of several runs has
    to agree; a valve without its flow force, whose u_rms is far off, never does.
    """
    off = []
    for _ in range(5):
        (entry,) = run_tool("demo", tmp_path, "--only", "paper_oarc", timeout=120)
        off.append(
            {i: abs(entry["indices"][i] / entry["offline"][i] - 1.0) for i in ("e_rms", "u_rms", "c_u")}
        )
        if off[-1]["e_rms"] < 0.05 and off[-1]["u_rms"] < 0.01 and off[-1]["c_u"] < 0.08:
            break
    else:
        pytest.fail(f"no run was that of the offline simulation: {off}")
    assert (tmp_path / "demo_paper.png").exists()


def test_what_follows_a_pause_is_left_out_for_run_and_twin_alike():
    times = np.arange(6000) * 1e-3
    kept = demo.steady(times, [times, np.delete(times, range(1000, 1030))])
    assert np.array_equal(np.flatnonzero(~kept), np.arange(999, 1330 + 1))


def test_a_best_effort_driver_is_heard(ros, tmp_path):
    """But not in lockstep, where each reading is waited for."""
    lax = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    drivers = [ros.create_publisher(Float64, "/spool_position", qos) for qos in (lax, SAMPLES)]
    states = []
    ros.create_subscription(Float64MultiArray, "/controller/state", states.append, SAMPLES)

    def heard(driver, reading):
        driver.publish(Float64(data=reading))
        return any(s.data[HEAD.index("measurement")] == reading for s in states)

    def matched(*counts):
        return lambda: tuple(d.get_subscription_count() for d in drivers) == counts

    with controller(tmp_path):
        spin_until(ros, matched(1, 1), "both drivers")
        for driver, reading in zip(drivers, (0.01, 0.02), strict=True):
            spin_until(ros, lambda d=driver, r=reading: heard(d, r), f"reading {reading}")
    with controller(tmp_path, "-p", "lockstep:=true"):
        spin_until(ros, matched(0, 1), "the reliable driver alone")


def test_a_command_for_each_message_that_paces_it_also_when_that_node_begins_anew(ros, tmp_path):
    """Exactly one, and none for messages of the other topic."""
    got, paces, other = [], "valve_voltage", ros.create_publisher(Float64, "spool_position", 10)
    ros.create_subscription(Float64, "spool_command", lambda message: got.append(message.data), 1000)
    senders = [ros.create_publisher(Float64, paces, 10), other]

    def sent():
        """One message on both topics; whether a command came of it within half a second."""
        before = len(got)
        for one in senders:
            one.publish(Float64(data=0.0))
        end = time.monotonic() + 0.5
        while len(got) == before and time.monotonic() < end:
            rclpy.spin_once(ros, timeout_sec=0.05)
        return len(got) > before

    def paced():
        spin_until(ros, lambda: senders[0].get_subscription_count() == 1, "the source")
        spin_until(ros, sent, "the first command")  # both sides know each other now
        begin = len(got)
        assert all(sent() for _ in range(20))
        assert len(got) == begin + 20
        return got[begin - 1 :]

    settings = ("trigger:=valve_voltage", "scenario:=triangle", "frequency:=0.1", "start:=0.0", "delay:=0.0")
    with process("command_source", [w for s in settings for w in ("-p", s)], tmp_path / "source.log"):
        first = paced()
        refused = set_parameters(ros, "command_source", trigger="spool_position")
        assert not refused.successful and "trigger of a running node does not change" in refused.reason
        ros.destroy_publisher(senders[0])
        senders[0] = ros.create_publisher(Float64, paces, 10)
        second = paced()
    step = first[1] - first[0]  # V  from sample to sample
    assert step > 0.0
    for commands in (first, second):
        assert commands == pytest.approx([commands[0] + k * step for k in range(21)], abs=1e-9)
    assert second[0] == pytest.approx(first[-1] + step, abs=1e-9)
