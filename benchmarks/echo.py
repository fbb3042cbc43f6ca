# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What the loop's latency is measured against: a process that answers each LVDT reading with itself.

``plain`` waits in a wait set of its own on one subscription, with the QoS of the controller: best effort for
readings, reliable for voltages; ``raw`` does so with serialized messages, the least that rclpy can do.
``reliable`` is ``plain`` with reliable readings; ``executor``, reliable too, is the node of a tutorial;
``events`` is the same node with rclpy's experimental EventsExecutor.
"""

import contextlib
import gc
import signal
import sys

import rclpy
from rclpy._rclpy_pybind11 import WaitSet
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64

from valve_control.nodes.adapter import NEWEST, SAMPLES, PolledSubscription


def plain(node: Node, qos: QoSProfile = NEWEST, raw: bool = False) -> None:
    """Wait, take, publish."""
    publisher = node.create_publisher(Float64, "valve_voltage", SAMPLES)
    readings = PolledSubscription(node, Float64, "spool_position", qos, raw)
    wait_set = WaitSet(1, 0, 0, 0, 0, 0, rclpy.get_default_context().handle)
    gc.collect()
    gc.freeze()
    while rclpy.ok():
        wait_set.clear_entities()
        wait_set.add_subscription(readings.handle)
        wait_set.wait(100_000_000)
        for message, _ in readings.take():
            publisher.publish(message)


def raw(node: Node) -> None:
    """The same with bytes."""
    plain(node, raw=True)


def reliable(node: Node) -> None:
    """The same with a reliable subscription."""
    plain(node, SAMPLES)


def executor(node: Node) -> None:
    """A callback and ``rclpy.spin``."""
    publisher = node.create_publisher(Float64, "valve_voltage", SAMPLES)
    node.create_subscription(Float64, "spool_position", publisher.publish, SAMPLES)
    rclpy.spin(node)


def events(node: Node) -> None:
    """A callback and the EventsExecutor; its ``spin`` runs no callback in rclpy 7.1.6, ``spin_once`` does."""
    publisher = node.create_publisher(Float64, "valve_voltage", SAMPLES)
    node.create_subscription(Float64, "spool_position", publisher.publish, SAMPLES)
    waiting = EventsExecutor()
    waiting.add_node(node)
    while rclpy.ok():
        waiting.spin_once(timeout_sec=0.1)


ECHOES = {"plain": plain, "reliable": reliable, "raw": raw, "executor": executor, "events": events}


def main() -> None:
    """``python -m benchmarks.echo plain --ros-args ...``."""
    rclpy.init(args=sys.argv)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        ECHOES[sys.argv[1]](Node("echo"))


if __name__ == "__main__":
    main()
