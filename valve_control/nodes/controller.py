# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs the node `controller` (controller_node.py): for each LVDT reading one step of the law and one voltage.

With the parameter driver (one of `valve_driver`) it has the device itself: the reading comes from it and the
voltage goes to it in one thread, and the topics follow. It then has the parameters of `valve_driver` too.
"""

import sys
from typing import Any

from valve_control.nodes.adapter import has_override
from valve_control.nodes.controller_node import Controller
from valve_control.nodes.loop import run


def make() -> list[Any]:
    """Create the node: with the device if the command line or its files have the parameter driver."""
    if not has_override("controller", "driver"):
        return [Controller()]
    from valve_control.nodes.device_controller import DeviceController  # which brings all drivers

    return [DeviceController()]


def main() -> int:
    """Entry point of `ros2 run valve_control controller`."""
    return run(make)


if __name__ == "__main__":
    sys.exit(main())
