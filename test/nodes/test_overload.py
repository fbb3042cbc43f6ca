# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Nodes that get more than they can work on still hear signals and services."""

import subprocess
import sys
import time
from contextlib import contextmanager, nullcontext

import pytest
from bench import LIMIT, get_double, spin_until
from std_msgs.msg import Float64

from research.campaigns.processes import process
from valve_control.control.supervision.record import Mode
from valve_control.nodes.adapter import SAMPLES, NumberSubscription, encoded
from valve_control.nodes.controller_node import TURNS, Controller

PROMPT = 2.0  # s for the end of a process, most of it Python's
FLOOD = """
import sys, rclpy
from std_msgs.msg import Float64
from valve_control.nodes.adapter import SAMPLES, encoded
rclpy.init()
publisher = rclpy.create_node("flood").create_publisher(Float64, sys.argv[1], SAMPLES)
while True:
    publisher.publish(encoded(0.0))
"""


@contextmanager
def flood(topic):
    """Messages on ``topic`` as fast as one process can send them."""
    child = subprocess.Popen([sys.executable, "-c", FLOOD, topic])
    try:
        yield
    finally:
        child.kill()
        child.wait()


def test_what_waits_is_taken_and_not_what_comes_meanwhile(ros):
    numbers = NumberSubscription(ros, "number", SAMPLES)
    publisher = ros.create_publisher(Float64, "number", SAMPLES)
    spin_until(ros, lambda: publisher.get_subscription_count() == 1, "match")
    publisher.publish(encoded(0.0))
    taken = []
    for number, _ in numbers.take():
        taken.append(number)
        publisher.publish(encoded(number + 1.0))
        assert len(taken) <= SAMPLES.depth
    assert taken == [float(i) for i in range(SAMPLES.depth)]


ANY_PACE = ("-p", "lvdt.period_limit:=1000.0")  # the tests give readings as fast as they are answered


def test_valves_that_fall_silent_at_once_do_not_wait_for_their_next_reminder(ros):
    """One that is held up acts again when it is its turn, 2 ms later, and not in 0.1 s."""
    valves = [
        Controller(warms=False, alone=False, cli_args=["--ros-args", "-r", f"__ns:=/w{i}", *ANY_PACE])
        for i in range(3)
    ]
    try:
        lvdts = [ros.create_publisher(Float64, f"/w{i}/spool_position", SAMPLES) for i in range(3)]

        for safe in (False, True):  # with readings as fast as they are answered, then without
            end = time.monotonic() + LIMIT
            while not all((valve._supervisor.mode is Mode.SAFE) == safe for valve in valves):
                assert time.monotonic() < end
                for valve, lvdt in zip(valves, lvdts, strict=True):
                    if not safe:
                        lvdt.publish(encoded(0.0))
                    valve.work()
        assert all(valve._supervisor.samples for valve in valves)
        Controller.told = time.monotonic()
        waiting, held_up = list(valves), 0
        while waiting:
            for valve in waiting:
                valve.report()
            waiting = [valve for valve in waiting if valve._supervisor.changed]
            held_up += len(waiting)
            for valve in waiting:
                assert valve.due() <= Controller.told + TURNS[True]
            while waiting and not any(valve.due() <= time.monotonic() and valve.work() for valve in waiting):
                pass
        assert held_up > 0 and all(valve._said[0] is Mode.SAFE for valve in valves)
    finally:
        for valve in valves:
            valve.destroy_node()


@pytest.mark.alone
@pytest.mark.parametrize(
    ("node", "topic", "arguments"),
    [
        ("controller", "spool_position", []),
        ("valve_simulator", None, ["-p", "sample_period:=0.00001"]),
        pytest.param("controller", "spool_command", [], marks=pytest.mark.campaign),
    ],
)
def test_overloaded_node_answers_a_service_and_ends_at_once(ros, tmp_path, node, topic, arguments):
    period = 0.00001 if topic is None else 0.001
    with process(node, arguments, tmp_path / "log") as child, flood(topic) if topic else nullcontext():
        if topic:
            spin_until(ros, lambda: ros.count_publishers(topic) > 0, "flood")
        assert get_double(ros, "sample_period", node) == period
        child.terminate()
        began = time.monotonic()
        assert child.wait(20.0) == 0
        assert time.monotonic() - began < PROMPT
