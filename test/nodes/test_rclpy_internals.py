# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What nodes use of rclpy beyond its public interface is there; each line names what broke if it is not."""

import ast
from pathlib import Path

import pytest
import rclpy
from bench import spin_until
from rcl_interfaces.srv import SetParameters
from std_msgs.msg import Float64

from valve_control.nodes import rclpy_internals
from valve_control.nodes.adapter import SAMPLES, NumberSubscription, encoded
from valve_control.nodes.rclpy_internals import FirstList, MessageFunctions


def private(tree):
    """Modules of rclpy that are imported, and attributes of other objects, whose names begin with _."""
    for node in ast.walk(tree):
        named = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        named += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        yield from (name for name in named if name.startswith("rclpy.") and "._" in name)
        if (
            isinstance(node, ast.Attribute)
            and ast.unparse(node.value) not in OWN
            and node.attr.startswith("_")
            and node.attr not in PUBLIC
            and not node.attr.endswith("__")
        ):
            yield ast.unparse(node)


OWN = ("self", "super()", "cls", "os")
PUBLIC = ("_asdict", "_fields", "_replace")  # of every NamedTuple


def test_one_file_alone_knows_private_names_of_rclpy():
    """So that another version of rclpy is met in that file."""
    folder = Path(rclpy_internals.__file__).parent
    found = {
        path.name: list(private(ast.parse(path.read_text(encoding="utf-8")))) for path in folder.rglob("*.py")
    }
    assert {"rclpy._rclpy_pybind11", "node._parameter_overrides"} <= set(found.pop("rclpy_internals.py"))
    assert {name: names for name, names in found.items() if names} == {}


def test_a_timer_is_run_without_the_executor_once_a_period(ros):
    ran = []
    timer = ros.create_timer(1e-9, lambda: ran.append(1))
    assert timer.is_ready()
    rclpy_internals.call_timer(timer)
    assert ran == [1], "timer.handle.call_timer, timer.callback: nodes/loop.py"
    timer.timer_period_ns = 10**12
    timer.reset()
    assert not timer.is_ready()
    ros.destroy_timer(timer)


def test_serialized_messages_are_sent_by_the_handle(ros):
    heard = NumberSubscription(ros, "sent", SAMPLES)
    publisher = ros.create_publisher(Float64, "sent", SAMPLES)
    send = rclpy_internals.sender(publisher)
    spin_until(ros, lambda: publisher.get_subscription_count() == 1, "the subscription")
    send(encoded(2.5))
    came = []
    spin_until(ros, lambda: came or came.extend(heard.take()), "the message")
    assert [number for number, _ in came] == [2.5], "publisher.handle.publish_raw: nodes/controller_node.py"
    heard.destroy()
    ros.destroy_publisher(publisher)
    with pytest.raises(rclpy_internals.RCLError):
        send(encoded(2.5))


def test_messages_go_to_c_and_back():
    functions = MessageFunctions(SetParameters.Request)
    message = functions.create()
    request = SetParameters.Request(parameters=[rclpy.parameter.Parameter("a", value=2.5).to_parameter_msg()])
    assert functions.from_python(request, message)
    assert FirstList.from_address(message).size == 1
    assert functions.to_python(message) == request
    functions.destroy(message)
