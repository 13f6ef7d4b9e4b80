"""The manager of a run: drives the nodes through their lifecycle and follows the progress."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterable
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from lowsnr_eval.graph import Node as GraphNode
from lowsnr_sensor.ros.runtime import reliable
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

CONFIGURE = Transition.TRANSITION_CONFIGURE
ACTIVATE = Transition.TRANSITION_ACTIVATE
DEACTIVATE = Transition.TRANSITION_DEACTIVATE


class GraphFailure(Exception):
    """A node died or refused a transition; the message says which and why."""


class Manager:
    """
    A client of every node's lifecycle, in a ROS context of its own.

    Parameters
    ----------
    nodes
        The nodes of the run.
    check
        Called again and again while waiting; raises to end the wait.
    on_scored
        Called with the number of the frame, and the totals of detections and tracks, for each
        frame that the evaluator has scored.

    """

    def __init__(
        self, nodes: Iterable[GraphNode], check: Callable[[], None],
        on_scored: Callable[[int, int, int], None],
    ) -> None:
        self._check = check
        self._on_scored = on_scored
        self.scored = self._detections = self._tracks = 0
        self._context = rclpy.Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node('bringup', context=self._context, use_global_arguments=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._clients = {
            node: self._node.create_client(ChangeState, f'{node.path}/change_state')
            for node in nodes}
        self._scored = self._node.create_subscription(
            DiagnosticArray, 'scored', self._count, reliable(10_000))

    def close(self) -> None:
        """Leave ROS."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def wait_for_evaluator(self) -> None:
        """Wait until the evaluator's word of scored frames reaches this manager."""
        while not self._scored.get_publisher_count():
            self.spin(0.01)

    def spin(self, seconds: float) -> None:
        """Take messages for a while, then check."""
        self._executor.spin_once(timeout_sec=seconds)
        self._check()

    def change(self, transition: int, nodes: Iterable[GraphNode], within_s: float) -> None:
        """
        Ask nodes for a transition, all at once, and wait until they have made it.

        Raises
        ------
        GraphFailure
            If a node refuses or does not answer in time.

        """
        until = time.monotonic() + within_s
        request = ChangeState.Request(transition=Transition(id=transition))
        asked: dict[GraphNode, Any] = {}
        waiting = list(nodes)
        while waiting:
            for node in waiting:
                if node not in asked and self._clients[node].service_is_ready():
                    asked[node] = self._clients[node].call_async(request)
            waiting = [n for n in waiting if n not in asked or not asked[n].done()]
            if waiting and time.monotonic() > until:
                raise GraphFailure(
                    f'{waiting[0].label} did not answer within {within_s:g} s')
            if waiting:
                self.spin(0.02)
        for node, future in asked.items():
            if not future.result().success:
                raise GraphFailure(f'{node.label} refused to change its state')

    def _count(self, message: DiagnosticArray) -> None:
        self.scored += 1
        for status in message.status:
            values = {item.key: item.value for item in status.values}
            self._detections += int(values['detections'])
            self._tracks += int(values['tracks'])
        self._on_scored(self.scored, self._detections, self._tracks)
