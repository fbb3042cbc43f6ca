# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Call a service of a running node without the `ros2` command, or change its lifecycle state.

python call_service.py /controller/reset
python call_service.py /controller/change_state deactivate
"""

import argparse
import sys
import time

import rclpy
from lifecycle_msgs.srv import ChangeState, GetState
from std_srvs.srv import Trigger

TYPES = {kind.__name__: kind for kind in (ChangeState, GetState, Trigger)}


def main() -> int:
    """0 if the node did it, 1 if it refused, 2 if there is no such service."""
    parser = argparse.ArgumentParser(description="Call a service, or change the state of a managed node.")
    parser.add_argument("service")
    parser.add_argument("transition", nargs="?", default="", help="of change_state, such as deactivate")
    arguments = parser.parse_args()
    name, transition = arguments.service, arguments.transition
    rclpy.init(args=[])
    try:
        node = rclpy.create_node("call_service")
        end = time.monotonic() + 5.0
        while name not in (services := dict(node.get_service_names_and_types())):
            if time.monotonic() > end:
                print(f"there is no service {name}", file=sys.stderr)
                return 2
            rclpy.spin_once(node, timeout_sec=0.1)
        kind = TYPES.get(services[name][0].split("/")[-1])
        if kind is None:
            print(f"{name} is a {services[name][0]}; this script calls {', '.join(TYPES)}", file=sys.stderr)
            return 2
        request = kind.Request()
        if kind is ChangeState:
            request.transition.label = transition
        client = node.create_client(kind, name)
        client.wait_for_service(timeout_sec=5.0)
        future = client.call_async(request)
        rclpy.spin_until_future_complete(node, future, timeout_sec=5.0)
        print(future.result() or f"{name} does not answer")
        return 0 if getattr(future.result(), "success", future.result() is not None) else 1
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
