# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Print the messages of a topic without the `ros2` command, until Ctrl-C.

python echo.py /controller/state
"""

import importlib
import sys
import time

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import Float64MultiArray


def show(message: object) -> None:
    """Print a message; numbers with labels, such as those of ~/state, one in a line."""
    if isinstance(message, Float64MultiArray) and message.layout.dim:
        for dimension, number in zip(message.layout.dim, message.data, strict=False):
            print(f"{dimension.label}: {number:.6g}")
        print("---", flush=True)
    else:
        print(message, flush=True)


def main() -> int:
    """0 after Ctrl-C or SIGTERM, 2 if nobody publishes the topic."""
    topic = (sys.argv + [""])[1]
    rclpy.init(args=[])
    try:
        node = rclpy.create_node("echo")
        end = time.monotonic() + 5.0
        while topic not in (topics := dict(node.get_topic_names_and_types())):
            if time.monotonic() > end:
                print(f"there is no topic {topic or '(write: echo.py TOPIC)'}", file=sys.stderr)
                return 2
            rclpy.spin_once(node, timeout_sec=0.1)
        package, _, name = topics[topic][0].split("/")
        kind = getattr(importlib.import_module(f"{package}.msg"), name)
        node.create_subscription(kind, topic, show, qos_profile_sensor_data)
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
