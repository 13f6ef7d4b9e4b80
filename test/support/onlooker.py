"""A node of a test beside a graph, in a context of its own."""

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
    """Give a context on this host alone, on the domain of the test's graph or another."""
    gc.collect()  # until then, nodes that earlier tests destroyed are in the graph
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
def onlooker(
    name: str, domain_id: int | None = None,
) -> Iterator[tuple[Node, SingleThreadedExecutor]]:
    """Give a node and what spins it."""
    with ros_context(domain_id) as context:
        node = Node(name, context=context)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        try:
            yield node, executor
        finally:
            executor.shutdown()
            node.destroy_node()
