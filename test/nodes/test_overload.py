# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Nodes that get more than they can work on still hear signals and services."""

import subprocess
import sys
import time
from contextlib import contextmanager, nullcontext

import pytest
from bench import get_double, spin_until
from std_msgs.msg import Float64

from research.campaigns.processes import process
from valve_control.nodes.adapter import SAMPLES, NumberSubscription, encoded

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
