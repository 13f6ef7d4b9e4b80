"""The manager of a run: drives the nodes through their lifecycle and follows the progress."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from collections.abc import Iterable
from contextlib import ExitStack
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from lifecycle_msgs.srv import GetState
from lowsnr_bringup.plan.graph import Node as GraphNode
from lowsnr_bringup.ros.bringup_node import bringup_node
from lowsnr_bringup.ros.node_watch import StateWatch
from lowsnr_bringup.ros.transition import PendingTransition
from lowsnr_bringup.run.frame_ledger import FrameLedger
from lowsnr_bringup.run.processes import notify
from lowsnr_common.core.records import Malformed
from lowsnr_common.core.timeline import StampOrder
from lowsnr_common.core.timeline import Timeline
from lowsnr_common.ros.inputs import drain
from lowsnr_common.ros.messages import stamp_key
from lowsnr_common.ros.qos import reliable
from lowsnr_common.ros.run_records import FrameScored
from lowsnr_common.ros.run_records import NodeRestarted
from lowsnr_common.ros.run_records import RESTARTS
from lowsnr_common.ros.run_records import SCORED
from rcl_interfaces.msg import ParameterEvent
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import qos_profile_parameter_events
from rosgraph_msgs.msg import Clock

CONFIGURE = Transition.TRANSITION_CONFIGURE
ACTIVATE = Transition.TRANSITION_ACTIVATE
DEACTIVATE = Transition.TRANSITION_DEACTIVATE
_EVALUATOR_WITHIN_S = 30.0


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
        Called repeatedly while waiting; raises to end the wait.
    on_scored
        Called with the number of the frame, and the totals of detections and tracks, for each
        frame that the evaluator has scored.

    """

    def __init__(
        self, nodes: Iterable[GraphNode], check: Callable[[], None],
        on_scored: Callable[[int, int, int], None],
    ) -> None:
        self._check, self._on_scored = check, on_scored
        self.scored = self._detections = self._tracks = 0
        self._within = ExitStack()
        self._node = self._within.enter_context(bringup_node())
        self._executor = SingleThreadedExecutor(context=self._node.context)
        self._within.callback(self._executor.shutdown)
        self._executor.add_node(self._node)
        self._services = {
            node: (self._node.create_client(ChangeState, f'{node.path}/change_state'),
                   self._node.create_client(GetState, f'{node.path}/get_state'))
            for node in nodes}
        self._scored = self._node.create_subscription(
            DiagnosticArray, SCORED, self._count, reliable(10_000))
        self.ledger, self.newest_ns, self._timeline = FrameLedger(), -1, Timeline()
        self.rejected: Counter[str] = Counter()  # unsound messages about scored frames by reason
        self.restarted: Counter[str] = Counter()
        self._clock = None
        if any(node.source for node in self._services):  # otherwise a clock is not of this run
            self._clock = self._node.create_subscription(
                Clock, 'clock', self._on_clock, reliable(10_000))
        self._labels = {node.path: node.label for node in nodes}
        self._active: dict[str, str] = {}  # process by node
        self.statuses: dict[str, DiagnosticStatus] = {}  # the newest while a node was active
        self._state_watch: StateWatch | None = StateWatch()
        self._diagnostics = self._node.create_subscription(
            DiagnosticArray, '/diagnostics', self._on_diagnostics, reliable(100))
        self._changed: dict[str, dict[str, Any]] = {}  # parameters set while it ran, by node
        self._parameters = self._node.create_subscription(
            ParameterEvent, '/parameter_events', self._on_parameters, qos_profile_parameter_events)
        self._restarts = self._node.create_publisher(DiagnosticArray, RESTARTS, reliable(100))

    def expect_changes(self) -> None:
        """Print no more changes of state: from here on bring-up asks for them."""
        self._state_watch = None

    def close(self) -> None:
        """Leave ROS."""
        self._within.close()

    def wait_for_evaluator(self) -> None:
        """Wait until this manager and the evaluator have discovered each other."""
        until = time.monotonic() + _EVALUATOR_WITHIN_S
        while not self._scored.get_publisher_count():
            if time.monotonic() > until:
                raise GraphFailure(
                    f'the evaluator was not discovered within {_EVALUATOR_WITHIN_S:g} s')
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
        waiting = {node: PendingTransition(*self._services[node], transition) for node in nodes}
        while waiting:
            for node, pending in list(waiting.items()):
                if (made := pending.poll()) is False:
                    raise GraphFailure(f'{node.label} rejected a change of its state')
                if made:
                    del waiting[node]
            if waiting and time.monotonic() > until:
                raise GraphFailure(
                    f'{next(iter(waiting)).label} did not answer within {within_s:g} s')
            if waiting:
                self.spin(0.02)

    def is_active(self, node: GraphNode, process: int) -> bool:
        """Return whether a process of a node has reported that it is active."""
        return self._active.get(node.path) == str(process)

    def changed(self, node: GraphNode) -> dict[str, Any]:
        """Return the parameters of a node that were set while it ran, with their last values."""
        drain(self._parameters)
        return self._changed.get(node.path, {})

    def catch_up(self) -> None:
        """Take all waiting messages about published and scored frames, and about nodes."""
        if self._clock is not None:
            drain(self._clock)
        drain(self._scored)
        drain(self._diagnostics)

    def announce(self, node: GraphNode, death: str, started_s_ago: float) -> None:
        """Publish that a node is active again, so that no node waits for what its death lost."""
        self.restarted[node.label] += 1
        self._restarts.publish(NodeRestarted(node.path, death, started_s_ago).to_message())

    def _count(self, message: DiagnosticArray) -> None:
        try:
            scored = FrameScored.from_message(message)
        except Malformed as error:
            self._reject(error)
            return
        if self._clock is None:  # of a camera only what the evaluator sees is known
            self.ledger.publish(scored.stamp_ns)
        self.ledger.score(scored.stamp_ns, scored.frame)
        self.scored = max(self.scored, scored.frame)
        self._detections += sum(chain.detections for chain in scored.chains)
        self._tracks += sum(chain.tracks for chain in scored.chains)
        self._on_scored(self.scored, self._detections, self._tracks)

    def _reject(self, error: Malformed) -> None:
        """Count a message that is not from the evaluator of the run, and name the first."""
        self.rejected[error.reason] += 1
        if self.rejected[error.reason] == 1:
            notify(f'{self._scored.topic_name}: rejected ({error.reason}): {error}; another '
                   'program than the evaluator publishes there')

    def _on_clock(self, message: Clock) -> None:
        stamp = stamp_key(message.clock)
        self.ledger.publish(stamp)
        if self._timeline.classify(stamp) is not StampOrder.LATE:
            self.newest_ns = stamp

    def _on_parameters(self, event: ParameterEvent) -> None:
        if event.node in self._labels:
            self._changed.setdefault(event.node, {}).update(
                {item.name: parameter_value_to_python(item.value)
                 for item in event.changed_parameters})

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {item.key: item.value for item in status.values}
            if (label := self._labels.get(status.name)) is None:
                continue
            process, state = values.get('process', ''), values.get('state', '')
            if state == 'active':
                self._active[status.name] = process
            if state in ('active', 'deactivating'):
                self.statuses[status.name] = status
            if self._state_watch:
                self._state_watch.update(label, status.name, process, state)
