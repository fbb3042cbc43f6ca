# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Print the messages of a topic without the `ros2` command, until Ctrl-C.

python echo.py /controller/state
"""

import argparse
import importlib
import signal
import sys
import time

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import Float64MultiArray


def text(value: object, indent: str = "") -> str:
    """Fields of a message, one in a line."""
    if hasattr(value, "get_fields_and_field_types"):
        names = value.get_fields_and_field_types()
        return "".join(f"\n{indent}{name}:{text(getattr(value, name), indent + '  ')}" for name in names)
    if isinstance(value, list) and value and hasattr(value[0], "get_fields_and_field_types"):
        return "".join(f"\n{indent}-{text(item, indent + '  ')}" for item in value)
    return f" {value}"


def show(message: object) -> None:
    """Print a message; numbers with labels, such as those of ~/state, each behind its label."""
    if isinstance(message, Float64MultiArray) and message.layout.dim:
        pairs = zip(message.layout.dim, message.data, strict=False)
        print("\n".join(f"{dimension.label}: {number:.6g}" for dimension, number in pairs))
    else:
        print(text(message).lstrip())
    print("---", flush=True)


def main() -> int:
    """0 after Ctrl-C or SIGTERM, 2 if nobody publishes the topic."""
    parser = argparse.ArgumentParser(description="Print the messages of a topic until Ctrl-C.")
    parser.add_argument("topic")
    topic = parser.parse_args().topic
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # `| head` ends it
    rclpy.init(args=[])
    try:
        node = rclpy.create_node("echo")
        end = time.monotonic() + 5.0
        while topic not in (topics := dict(node.get_topic_names_and_types())):
            if time.monotonic() > end:
                print(f"there is no topic {topic}", file=sys.stderr)
                return 2
            rclpy.spin_once(node, timeout_sec=0.1)
        package, _, name = topics[topic][0].split("/")
        kind = getattr(importlib.import_module(f"{package}.msg"), name)
        node.create_subscription(kind, topic, show, qos_profile_sensor_data)
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
