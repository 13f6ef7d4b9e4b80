# SPDX-License-Identifier: Apache-2.0
"""The process of managed nodes, mostly of one: from its start to its exit status."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
import gc
import sys

from lowsnr_common.core.process_setup import end_with_starter
from lowsnr_common.core.process_setup import FAILED
from lowsnr_common.core.process_setup import INTERRUPTED
from lowsnr_common.core.process_setup import keep_freed_memory
from lowsnr_common.core.process_setup import SHUT_DOWN
from lowsnr_common.core.process_setup import StarterLine
from lowsnr_common.core.process_setup import TERMINATED
from lowsnr_common.core.process_setup import USAGE_ERROR
from lowsnr_common.ros.managed_node import ManagedNode
from lowsnr_common.ros.process.local_topics import LocalTopics
from lowsnr_common.ros.process.node_executor import NodeExecutor
import rclpy
from rclpy.executors import ExternalShutdownException


def run(make_node: Callable[[], ManagedNode], args: list[str] | None = None) -> None:
    """Run one node, see :func:`run_together`."""
    run_together([make_node], args)


def run_together(
    make_nodes: Sequence[Callable[[], ManagedNode]], args: list[str] | None = None,
) -> None:
    """
    Start ROS, spin nodes, and end when one is done, by Ctrl-C or by SIGTERM.

    Nodes that start themselves do so in the order given: subscribers before publishers.

    The exit status is 0 of a node that is done, 1 of one that cannot become active, 2 after one
    line about a setting out of its bounds, 3 of a node that its lifecycle shut down, 130 after
    Ctrl-C, and 143 after SIGTERM.
    """
    starters = end_with_starter(len(make_nodes))
    keep_freed_memory()
    rclpy.init(args=args)
    nodes: list[ManagedNode] = []
    try:
        executor = NodeExecutor()
        nodes.extend(_made(make_nodes, starters, executor))
        if not all(node.autostart() for node in nodes):
            sys.exit(FAILED)
        gc.freeze()  # so that no collection looks through all that was imported
        executor.spin()
    except ValueError as error:
        if len(nodes) == len(make_nodes):
            raise
        print(error, file=sys.stderr)
        sys.exit(USAGE_ERROR)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except ExternalShutdownException:
        pass
    except RuntimeError:
        if rclpy.ok():  # otherwise SIGTERM came while something was being published
            raise
    finally:
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
    if not any(node.done for node in nodes):
        sys.exit(SHUT_DOWN if any(node.shut_down for node in nodes) else TERMINATED)


def _made(
    make_nodes: Sequence[Callable[[], ManagedNode]], starters: Sequence[StarterLine],
    executor: NodeExecutor,
) -> Iterator[ManagedNode]:
    """Make nodes that share topics, and yield each once it is connected to its starter."""
    local = LocalTopics(executor.call_soon)
    for make, starter in zip(make_nodes, starters, strict=True):
        node = make()
        node.share(local)
        node.bringup.connect(starter)
        executor.add_node(node)
        yield node
