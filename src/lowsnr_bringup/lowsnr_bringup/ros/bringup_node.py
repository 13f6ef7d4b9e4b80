# SPDX-License-Identifier: Apache-2.0
"""Bring-up's own ROS node, in a context of its own and in its own enclave."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from lowsnr_bringup.plan.graph import MANAGER
from lowsnr_bringup.plan.node_command import NO_OTHER_LOGS
import rclpy
from rclpy.logging import LoggingSeverity
from rclpy.logging import set_logger_level
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions


@contextmanager
def bringup_node(name: str = MANAGER, rosout: bool = True) -> Iterator[Node]:
    """Make bring-up's node, which leaves ROS at the end of the ``with`` block."""
    context = rclpy.Context()
    rclpy.init(
        args=['--ros-args', '--enclave', f'/{name}', NO_OTHER_LOGS], context=context,
        signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = Node(
            name, context=context, use_global_arguments=False, enable_rosout=rosout,
            start_parameter_services=False)  # it takes messages, and answers no service
        try:
            yield node
        finally:
            node.destroy_node()
    finally:
        context.try_shutdown()


def check_security(name: str = MANAGER) -> None:
    """
    Make and drop bring-up's node of a name, with security as the environment asks for it.

    Raises
    ------
    ValueError
        One line with the reason of the middleware, if it has no security or rejects the enclave.

    """
    set_logger_level('rcl', LoggingSeverity.WARN)  # it would print where the enclave is
    try:
        with bringup_node(name, rosout=False):  # rclpy warns of it when the node is rejected
            pass
    except RuntimeError as error:  # rclpy raises it for every error of the middleware
        reason = str(error).splitlines()[0].partition(', at /')[0]
        raise ValueError(
            f'--secure: the middleware does not start a node in its enclave (/{name}: '
            f'{reason}): source an installed ROS 2 Jazzy, whose middleware has security, or make '
            'the enclave again') from None
