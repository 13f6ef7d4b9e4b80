"""ROS contexts of their own, so that tests do not see each other's nodes."""

from graph_runs import own_domain
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions


@pytest.fixture
def context(monkeypatch):
    """Return an initialised context on a domain of this test process."""
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    context = rclpy.Context()
    rclpy.init(
        context=context, domain_id=own_domain(),
        signal_handler_options=SignalHandlerOptions.NO)
    yield context
    context.try_shutdown()


@pytest.fixture
def spin(context):
    """Return a function that spins nodes until a condition holds, and fails where it does not."""
    executor = SingleThreadedExecutor(context=context)

    def until(condition, *nodes, within=400):
        for node in nodes:
            executor.add_node(node)
        for _ in range(within):
            if condition():
                return
            executor.spin_once(timeout_sec=0.05)
        raise AssertionError('the condition did not come true')

    yield until
    executor.shutdown()
