import pytest
import rclpy


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """The tests of commissioning share a set of domains: one worker has them all."""
    for item in items:
        if item.path.name == "test_commission.py":
            item.add_marker(pytest.mark.xdist_group("commission"))
            if item.originalname == "test_an_invented_valve":  # in three minutes of the clock
                item.add_marker(pytest.mark.alone)


@pytest.fixture
def ros():
    rclpy.init()
    node = rclpy.create_node("test")
    yield node
    node.destroy_node()
    rclpy.shutdown()
