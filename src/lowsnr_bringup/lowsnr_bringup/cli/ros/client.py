# SPDX-License-Identifier: Apache-2.0
"""The node of a ``ros2`` command: what it discovers, and the services that it calls."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from collections.abc import Iterator
from contextlib import contextmanager
import os
import time
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.topic_or_service_is_hidden import topic_or_service_is_hidden

_STEP_S = 0.1
_EVERY_NODES, _UNNAMED = ('/rosout', '/parameter_events'), '_NODE_NAME_UNKNOWN_'
# A name that was asked for is waited for, and the graph may change, this many times longer than
# it must stand still to be known.
_LONGEST = 10
_ANSWER_WITHIN_S, _ASKED = 5.0, 3


def add_graph_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of every verb that looks at the graph."""
    parser.add_argument(
        '--spin-time', type=float, default=1.0, metavar='SPIN_TIME',
        help='the graph is known when nothing new was discovered for this time [s] (default: '
        '1.0); a name is waited for ten times as long')
    parser.add_argument(
        '-s', '--use-sim-time', action='store_true', help='take the time from /clock')
    parser.add_argument(
        '--no-daemon', action='store_true', help='accepted: there is never a daemon')


class Client:
    """A node that looks at the graph."""

    def __init__(self, node: Node, executor: SingleThreadedExecutor, spin_time_s: float) -> None:
        self.node = node
        self._executor = executor
        self._quiet_s = spin_time_s

    def spin_until(self, done: Callable[[], bool], within_s: float = float('inf')) -> bool:
        """Handle what arrives until a condition holds, for a time [s]; return whether it does."""
        until = time.monotonic() + within_s
        while not done():
            if (left := until - time.monotonic()) <= 0.0:
                return False
            self._executor.spin_once(timeout_sec=min(left, _STEP_S))
        return True

    def discover(self) -> None:
        """Wait until nothing new has been discovered for a while, and all nodes have names."""
        until = time.monotonic() + _LONGEST * self._quiet_s
        before: Any = None
        while (before != (before := self._known()) or self._has_unnamed()) and (
                time.monotonic() < until):
            self.spin_until(lambda: self._known() != before, self._quiet_s)

    def _known(self) -> Any:
        return (sorted(self.node.get_node_names_and_namespaces()),
                sorted(self.node.get_topic_names_and_types()),
                sorted(self.node.get_service_names_and_types()))

    def _has_unnamed(self) -> bool:
        """Return whether an endpoint was discovered before the name of its node."""
        return any(_UNNAMED in (each.node_name, each.node_namespace) for topic in _EVERY_NODES
                   for each in self.node.get_publishers_info_by_topic(topic))

    def appears(self, done: Callable[[], bool]) -> bool:
        """Wait until something that was asked for has been discovered; return whether it was."""
        return self.spin_until(done, _LONGEST * self._quiet_s)

    def node_names(self, hidden: bool = False) -> list[str]:
        """Return the full names of all nodes that were discovered, but for those of this tool."""
        return sorted(
            f'{space.rstrip("/")}/{name}'
            for name, space in self.node.get_node_names_and_namespaces()
            if hidden or (name and not name.startswith('_')))

    def topics(self, hidden: bool = False) -> dict[str, list[str]]:
        """Return the types of all topics that were discovered, by name."""
        return {name: list(types) for name, types in self.node.get_topic_names_and_types()
                if hidden or not topic_or_service_is_hidden(name)}

    def find_node(self, name: str, hidden: bool = True) -> str:
        """Return the full name of a node, or raise LookupError where it does not appear."""
        full = name if name.startswith('/') else f'/{name}'
        if not self.appears(lambda: full in self.node_names(hidden)):
            raise LookupError(f'Node not found: {full} {where()}')
        return full

    def with_service(self, service: str, kind: str) -> list[str]:
        """Return the full names of the nodes that have a service of a type."""
        services = dict(self.node.get_service_names_and_types())
        return [name for name in self.node_names()
                if kind in services.get(f'{name}/{service}', ())]

    def call(self, kind: Any, service: str, request: Any, asked: int = _ASKED) -> Any:
        """
        Return the answer of a service, or raise TimeoutError.

        An answer is lost where the server has not discovered this client, so that it is
        ``asked`` several times, unless that has another effect than asking once.
        """
        client = self.node.create_client(kind, service)
        if self.spin_until(client.service_is_ready, _ANSWER_WITHIN_S):
            for _ in range(asked):
                future = client.call_async(request)
                if self.spin_until(future.done, _ASKED * _ANSWER_WITHIN_S / asked):
                    return future.result()
        raise TimeoutError(f'{service} does not answer')


def where() -> str:
    """Return where this process looks, for what is not found."""
    reach = os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE') or 'SUBNET'
    return (f'in ROS domain {os.environ.get("ROS_DOMAIN_ID") or 0} (ROS_DOMAIN_ID), discovery '
            f'range {reach}')


@contextmanager
def graph_client(options: argparse.Namespace) -> Iterator[Client]:
    """Start ROS and the node of this command; both end with the ``with`` block."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = Node(
            f'_ros2_{os.getpid()}', context=context, use_global_arguments=False,
            enable_rosout=False, start_parameter_services=False,
            parameter_overrides=[Parameter('use_sim_time', value=options.use_sim_time)])
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        try:
            yield Client(node, executor, options.spin_time)
        finally:
            executor.shutdown()
            node.destroy_node()
    finally:
        context.try_shutdown()
