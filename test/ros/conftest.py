# SPDX-License-Identifier: Apache-2.0
"""A ROS context for each test, so that tests do not discover each other's nodes."""

from node_client import NodeClient
import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.parameter import Parameter
from ros_nodes import node_domain
from ros_nodes import ros_context


@pytest.fixture
def context():
    """Return an initialised context on the domain of this test process."""
    with ros_context(node_domain()) as own:
        yield own


@pytest.fixture
def spin(context):
    """Return a function that spins nodes until a condition holds, and fails where it does not."""
    executor = SingleThreadedExecutor(context=context)

    def until(condition, *nodes, within=1600):
        for node in nodes:
            executor.add_node(node)
        for _ in range(within):
            if condition():
                return
            executor.spin_once(timeout_sec=0.05)
        raise AssertionError('the condition did not come true')

    yield until
    executor.shutdown()


@pytest.fixture
def started(context, spin, tmp_path, monkeypatch):
    """Return a function that starts a node and returns a client of it."""
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    nodes = []

    def start(kind, *arguments, **values):
        given = [Parameter(name.replace('__', '.'), value=value) for name, value in values.items()]
        node = kind(*arguments, context=context, parameter_overrides=given)
        nodes.append(node)
        node.autostart()
        client = NodeClient(context, spin, node)
        nodes.append(client.own)
        return client

    yield start
    for node in nodes:
        node.destroy_node()


@pytest.fixture
def log(monkeypatch):
    """Return the messages that nodes log."""
    lines = []
    monkeypatch.setattr(
        RcutilsLogger, 'log', lambda self, message, *_, **__: lines.append(message) or True)
    return lines
