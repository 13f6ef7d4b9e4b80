"""
Make nodes, each in the enclave that bears its name, and end.

Ends with 1 after one line that says which node was refused and why.
"""

from __future__ import annotations

import re
import sys

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

REFUSED = 1
_WHERE = re.compile(r', at \S+:\d+')  # the lines of source that errors of rcl end with


def make_node(path: str) -> None:
    """Make a node, with nothing beside it that its enclave might not permit, and drop it."""
    namespace, _, name = path.rpartition('/')
    context = rclpy.Context()
    rclpy.init(
        args=['--ros-args', '--enclave', path], context=context,
        signal_handler_options=SignalHandlerOptions.NO)
    try:
        Node(
            name, namespace=namespace, context=context, use_global_arguments=False,
            enable_rosout=False, start_parameter_services=False).destroy_node()
    finally:
        context.try_shutdown()


def main() -> int:
    """Make the nodes of the command line; return the exit code."""
    for path in sys.argv[1:]:
        try:
            make_node(path)
        except RuntimeError as error:  # what rclpy makes of all errors of rcl
            print(f'{path}: {_WHERE.sub("", str(error)).splitlines()[0]}')
            return REFUSED
    return 0


if __name__ == '__main__':
    sys.exit(main())
