import pytest
import rclpy


@pytest.fixture
def ros():
    rclpy.init()
    node = rclpy.create_node("test")
    yield node
    node.destroy_node()
    rclpy.shutdown()
