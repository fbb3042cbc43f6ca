# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Publish a number (std_msgs/Float64) on a topic without the `ros2` command, until Ctrl-C.

python publish.py /valve_voltage 0.5 --rate 50
"""

import argparse
import sys

import rclpy
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import Float64


def main() -> int:
    """0 after Ctrl-C or SIGTERM."""
    parser = argparse.ArgumentParser(description="Publish a number (std_msgs/Float64) until Ctrl-C.")
    parser.add_argument("topic")
    parser.add_argument("value", type=float)
    parser.add_argument("--rate", type=float, default=50.0, help="messages a second (50)")
    arguments = parser.parse_args()
    if not 0.0 < arguments.rate <= 1000.0:
        parser.error(f"--rate is {arguments.rate:g}; it must be above 0 and at most 1000")
    rclpy.init(args=[])
    try:
        node = rclpy.create_node("publish")
        publisher = node.create_publisher(Float64, arguments.topic, 10)
        message = Float64(data=arguments.value)
        node.create_timer(1.0 / arguments.rate, lambda: publisher.publish(message))
        print(f"{arguments.topic}: {arguments.value:g}, {arguments.rate:g} times a second", flush=True)
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception:  # of rclpy, if Ctrl-C comes while the node is made
        if rclpy.ok():
            raise
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
