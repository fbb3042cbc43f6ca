# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python strangers.py WHICH``: nodes that publish a valve's topics and are no controller of this version.

older: has parameters of its own, no law, no life cycle, no files, and a state whose numbers have no names.
unknown: a driver that offers no parameters at all.
"""

import math
import sys

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import Float64, Float64MultiArray

PERIOD = 0.02  # s


class Stranger(Node):
    def __init__(self, which):
        super().__init__(which, namespace=which, start_parameter_services=which == "older")
        self._state = None
        if which == "older":
            self.declare_parameter("kp", 1.0)
            self._state = self.create_publisher(Float64MultiArray, "~/state", 10)
        self._position = self.create_publisher(Float64, "spool_position", 10)
        self._voltage = self.create_publisher(Float64, "valve_voltage", 10)
        self._samples = 0
        self.create_timer(PERIOD, self._sample)

    def _sample(self):
        self._samples += 1
        reading = math.sin(self._samples * PERIOD)
        self._position.publish(Float64(data=reading))
        self._voltage.publish(Float64(data=-reading))
        if self._state is not None:
            self._state.publish(Float64MultiArray(data=[reading, -reading, 0.5]))


def main():
    rclpy.init()
    try:
        rclpy.spin(Stranger(sys.argv[1]))
    except (KeyboardInterrupt, ExternalShutdownException):
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
