# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""An upper level of a few lines: a command for each reading, none while the controller is in `safe`."""

import signal
import threading

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64


class UpperLevel(Node):
    """Publishes `spool_command`, paced by `spool_position`."""

    def __init__(self) -> None:
        super().__init__("upper_level")
        self.controller = self.resolve_topic_name("controller").lstrip("/")  # as diagnostics name it
        self.safe = False  # the controller gives 0 V
        self.command = self.create_publisher(Float64, "spool_command", 10)
        self.create_subscription(Float64, "spool_position", self.on_reading, qos_profile_sensor_data)
        self.create_subscription(DiagnosticArray, "/diagnostics", self.on_diagnostics, 10)

    def on_reading(self, reading: Float64) -> None:
        """One command [V] for each reading [V]."""
        if not self.safe:
            self.command.publish(Float64(data=1.0 - 0.2 * reading.data))

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Take the level of the controller, which comes at once when it changes."""
        for status in message.status:
            if status.name == self.controller:
                self.safe = status.level == DiagnosticStatus.ERROR


def main() -> None:
    """Run until SIGINT or SIGTERM; no exception comes into the middle of a callback."""
    stopped = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopped.set())
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = UpperLevel()
    while not stopped.is_set():
        rclpy.spin_once(node, timeout_sec=0.1)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
