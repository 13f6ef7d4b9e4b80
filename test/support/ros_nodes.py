# SPDX-License-Identifier: Apache-2.0
"""ROS contexts and nodes of a test, on a domain that only this test process uses."""

from collections.abc import Iterator
from contextlib import contextmanager
import gc

from graph_runs import own_domain
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions


@contextmanager
def ros_context(domain_id: int | None = None) -> Iterator[rclpy.Context]:
    """Yield a context that sees this host alone, on the process's own domain or the one given."""
    gc.collect()  # nodes that earlier tests destroyed stay in the graph until they are collected
    context = rclpy.Context()
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        rclpy.init(
            context=context, domain_id=own_domain() if domain_id is None else domain_id,
            signal_handler_options=SignalHandlerOptions.NO)
        try:
            yield context
        finally:
            context.try_shutdown()


@contextmanager
def spun_node(
    name: str, domain_id: int | None = None,
) -> Iterator[tuple[Node, SingleThreadedExecutor]]:
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
