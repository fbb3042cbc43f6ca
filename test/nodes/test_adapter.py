# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Numbers as bytes are what rclpy makes of them."""

import math
from struct import pack

import pytest
from bench import spin_until
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Float64, Float64MultiArray, MultiArrayDimension, MultiArrayLayout
from trajectory_msgs.msg import JointTrajectoryPoint

from valve_control.control.parameters.table import CONTROLLER
from valve_control.nodes.adapter import (
    SAMPLES,
    NumberSubscription,
    PolledSubscription,
    encoded,
    encoded_point,
    head,
    with_numbers,
)

NUMBERS = [0.0, -0.0, 1.0, -9.87654321, 5e-324, 1.7e308, math.inf, -math.inf]


@pytest.mark.parametrize("number", NUMBERS)
def test_a_number_travels_as_rclpy_sends_it(number):
    assert encoded(number) == serialize_message(Float64(data=number))


def test_numbers_arrive_whoever_sends_them(ros):
    """From messages, from bytes, and in the byte order of the sender; what is too short is passed over."""
    numbers = NumberSubscription(ros, "number", SAMPLES)
    publisher = ros.create_publisher(Float64, "number", SAMPLES)
    spin_until(ros, lambda: publisher.get_subscription_count() == 1, "match")
    big_endian = b"\x00\x00\x00\x00" + bytes(reversed(encoded(2.5)[4:]))
    for message in (Float64(data=1.5), encoded(-3.5), encoded(7.0)[:8], big_endian):
        publisher.publish(message)
    found = []
    spin_until(ros, lambda: found.extend(numbers.take()) or len(found) == 3, "three numbers")
    assert [number for number, _ in found] == [1.5, -3.5, 2.5]
    assert [info["publication_sequence_number"] for _, info in found] == [1, 2, 4]


@pytest.mark.parametrize("labels", [(), ("x",), ("sample", "mode"), ("a", "bb", "ccc", "dddd", "eeeee")])
def test_numbers_after_the_head_of_an_array_are_what_rclpy_reads(labels):
    dim = [MultiArrayDimension(label=label, size=1, stride=1) for label in labels]
    numbers = NUMBERS[: len(labels)]
    message = Float64MultiArray(layout=MultiArrayLayout(dim=dim), data=numbers)
    begin = head(Float64MultiArray(layout=MultiArrayLayout(dim=dim)), len(labels))
    assert deserialize_message(begin + pack(f"<{len(labels)}d", *numbers), Float64MultiArray) == message


def test_a_number_that_came_as_a_word_is_a_number_and_other_words_stay():
    sent = {"arc.epsilon": "1e-05", "arc.k1": "fast", "save_file": "1e-05"}
    taken = with_numbers(CONTROLLER, [Parameter(name, value=value) for name, value in sent.items()])
    assert [one.value for one in taken] == [1e-05, "fast", "1e-05"]


def test_what_is_no_point_is_passed_over(ros):
    whole = encoded_point(0.5, 1.0, 2.0, 3 * 10**9 + 4)
    many = whole[:4] + b"\xff\xff\xff\x7f" + whole[8:]  # 2147483647 positions
    points = PolledSubscription(ros, JointTrajectoryPoint, "point", SAMPLES)
    publisher = ros.create_publisher(JointTrajectoryPoint, "point", SAMPLES)
    spin_until(ros, lambda: publisher.get_subscription_count() == 1, "match")
    for data in (whole[:20], many, whole):
        publisher.publish(data)
    found = []
    spin_until(ros, lambda: found.extend(points.take()) or found, "the point")
    ((point, _),) = found
    assert [*point.positions, *point.velocities, *point.accelerations] == [0.5, 1.0, 2.0]
    assert (point.time_from_start.sec, point.time_from_start.nanosec) == (3, 4)
