# SPDX-License-Identifier: Apache-2.0
"""The process of a managed node: from its start to its exit status."""

from __future__ import annotations

from collections.abc import Callable
import gc
import sys

from lowsnr_common.core.process_setup import end_with_starter
from lowsnr_common.core.process_setup import FAILED
from lowsnr_common.core.process_setup import INTERRUPTED
from lowsnr_common.core.process_setup import keep_freed_memory
from lowsnr_common.core.process_setup import SHUT_DOWN
from lowsnr_common.core.process_setup import TERMINATED
from lowsnr_common.core.process_setup import USAGE_ERROR
from lowsnr_common.ros.managed_node import ManagedNode
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.executors import SingleThreadedExecutor


def run(make_node: Callable[[], ManagedNode], args: list[str] | None = None) -> None:
    """
    Start ROS, spin one node, and end when it is done, by Ctrl-C or by SIGTERM.

    The exit status is 0 of a node that is done, 1 of one that cannot become active, 2 after one
    line about a setting out of its bounds, 3 of a node that its lifecycle shut down, 130 after
    Ctrl-C, and 143 after SIGTERM.
    """
    starter = end_with_starter()
    keep_freed_memory()
    rclpy.init(args=args)
    node = None
    try:
        node = make_node()
        node.bringup.connect(starter)
        (executor := SingleThreadedExecutor()).add_node(node)
        if not node.autostart():
            sys.exit(FAILED)
        gc.freeze()  # so that no collection looks through all that was imported
        executor.spin()
    except ValueError as error:
        if node is not None:
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
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    if node is None or not node.done:
        sys.exit(SHUT_DOWN if node is not None and node.shut_down else TERMINATED)
