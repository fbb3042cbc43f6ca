# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Set parameters of a running node without the `ros2` command: all of them, or none.

python set_parameters.py /controller controller=oarc oarc.ks1=150.0
"""

import sys

import rclpy
from rcl_interfaces.msg import Parameter
from rclpy.parameter import get_parameter_value
from rclpy.parameter_client import AsyncParameterClient


def main() -> int:
    """0 if all were taken, 1 if they were refused, 2 if the node does not answer."""
    name, settings = (sys.argv + [""])[1], sys.argv[2:]
    if not settings or not all("=" in setting for setting in settings):
        print(
            "write: set_parameters.py NODE NAME=VALUE ..., a number with its point (150.0)", file=sys.stderr
        )
        return 2
    pairs = [setting.split("=", 1) for setting in settings]
    parameters = [Parameter(name=key, value=get_parameter_value(text)) for key, text in pairs]
    rclpy.init(args=[])
    try:
        node = rclpy.create_node("set_parameters")
        client = AsyncParameterClient(node, name)
        if not client.wait_for_services(timeout_sec=5.0):
            print(f"there is no node {name}", file=sys.stderr)
            return 2
        future = client.set_parameters_atomically(parameters)
        rclpy.spin_until_future_complete(node, future, timeout_sec=5.0)
        answer = future.result()
        if answer is None:
            print(f"{name} does not answer", file=sys.stderr)
            return 2
        print("set" if answer.result.successful else f"refused: {answer.result.reason}")
        return 0 if answer.result.successful else 1
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
