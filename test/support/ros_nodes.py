# SPDX-License-Identifier: Apache-2.0
"""ROS contexts and nodes of a test, in its own process."""

from collections.abc import Iterator
from contextlib import contextmanager
import gc

from graph_runs import own_domain
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

_NODES = -1  # which of the process's domains


def node_domain() -> int:
    """Return the domain for nodes of tests, where those that stay longer meet no graph."""
    return own_domain(_NODES)


@contextmanager
def ros_context(domain_id: int) -> Iterator[rclpy.Context]:
    """Yield a context that sees this host alone."""
    gc.collect()  # nodes that earlier tests destroyed stay in the graph until they are collected
    context = rclpy.Context()
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        rclpy.init(
            context=context, domain_id=domain_id,
            signal_handler_options=SignalHandlerOptions.NO)
        try:
            yield context
        finally:
            context.try_shutdown()


@contextmanager
def spun_node(name: str, domain_id: int) -> Iterator[tuple[Node, SingleThreadedExecutor]]:
    """Yield a node in a context of its own, and the executor that spins it."""
    with ros_context(domain_id) as context:
        node = Node(name, context=context)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        try:
            yield node, executor
        finally:
            executor.shutdown()
            node.destroy_node()
