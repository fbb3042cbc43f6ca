# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
import forked
import pytest
import rclpy

from valve_control.nodes.harness import processes

processes.start = forked.start


@pytest.fixture
def ros():
    rclpy.init()
    node = rclpy.create_node("test")
    yield node
    node.destroy_node()
    rclpy.shutdown()
