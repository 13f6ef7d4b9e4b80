# SPDX-License-Identifier: Apache-2.0
"""The manager of a run: drives the nodes through their lifecycle and follows the progress."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from collections.abc import Iterable
from contextlib import ExitStack
import time
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.msg import TransitionEvent
from lowsnr_bringup.plan.graph import Node as GraphNode
from lowsnr_bringup.ros.bringup_node import bringup_node
from lowsnr_bringup.ros.domain_guard import DomainGuard
from lowsnr_bringup.ros.node_watch import StateWatch
from lowsnr_bringup.ros.node_watch import StrangerWatch
from lowsnr_bringup.ros.transition import PendingTransition
from lowsnr_bringup.run.frame_ledger import FrameLedger
from lowsnr_bringup.run.processes import notify
from lowsnr_bringup.run.processes import ProcessGroup
from lowsnr_bringup.run.threads import Patience
from lowsnr_common.core.line import Line
from lowsnr_common.core.records import AlarmRate
from lowsnr_common.core.records import Malformed
from lowsnr_common.ros.bringup_line import CHANGE_STATE
from lowsnr_common.ros.bringup_line import DATA_TIME
from lowsnr_common.ros.bringup_line import LAST_FRAME
from lowsnr_common.ros.bringup_line import LIVE_PAGE
from lowsnr_common.ros.bringup_line import PARAMETERS
from lowsnr_common.ros.bringup_line import STATUS
from lowsnr_common.ros.messages import stamp_key
from lowsnr_common.ros.qos import reliable
from lowsnr_common.ros.run_records import ALARM_RATE
from lowsnr_common.ros.run_records import FrameScored
from lowsnr_common.ros.run_records import NodeRestarted
from lowsnr_common.ros.run_records import rate_from_message
from lowsnr_common.ros.run_records import RESTARTS
from lowsnr_common.ros.run_records import SCORED
from rcl_interfaces.msg import ParameterEvent
from rclpy.parameter import parameter_value_to_python
from rclpy.serialization import deserialize_message
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

CONFIGURE = Transition.TRANSITION_CONFIGURE
ACTIVATE = Transition.TRANSITION_ACTIVATE
DEACTIVATE = Transition.TRANSITION_DEACTIVATE


class GraphFailure(Exception):
    """A node died or refused a transition; the message says which and why."""


class Manager:
    """
    Changes the states of the nodes and follows their progress.

    It hears and asks the nodes over the lines of their processes.  It subscribes to nothing and
    calls no service: on a ROS domain anybody can write to a topic and answer a service.

    Parameters
    ----------
    group
        The processes of the run.
    nodes
        The nodes of the run.
    check
        Called repeatedly while waiting; raises to end the wait.
    on_scored
        Called with the number of the frame, and the totals of detections and tracks, for each
        frame that the evaluator has scored.

    """

    def __init__(
        self, group: ProcessGroup, nodes: Iterable[GraphNode], check: Callable[[], None],
        on_scored: Callable[[int, int, int], None],
    ) -> None:
        self._group, self._check, self._on_scored = group, check, on_scored
        self.scored = self._detections = self._tracks = 0
        self._handlers: dict[str, tuple[type, Callable[[Any], None]]] = {
            SCORED: (DiagnosticArray, self._count), DATA_TIME: (Clock, self._on_clock),
            STATUS: (DiagnosticArray, self._on_diagnostics),
            PARAMETERS: (ParameterEvent, self._on_parameters),
            ALARM_RATE: (DiagnosticArray, self._on_alarm_rate),
            LIVE_PAGE: (String, lambda page: notify(f'live page: {page.data}'))}
        self._pending: dict[Line, PendingTransition] = {}
        self._within = ExitStack()
        self._node = self._within.enter_context(bringup_node())
        self.guard = DomainGuard(self._node, (node.path for node in nodes))
        self._restarts = self._node.create_publisher(DiagnosticArray, RESTARTS, reliable(100))
        self.ledger = FrameLedger(told=any(node.source for node in nodes))
        self.newest_ns = -1
        self.restarted: Counter[str] = Counter()
        self.alarm_rates: dict[str, AlarmRate] = {}  # the newest, by the name of the node
        self.rejected: Counter[str] = Counter()  # unsound records, by reason
        self._labels = {node.path: node.label for node in nodes}
        self.heard: dict[str, tuple[str, float]] = {}  # process and time of the last sign
        self._active: dict[str, str] = {}  # process by node
        self.statuses: dict[str, DiagnosticStatus] = {}  # the newest while a node was active
        self._state_watch: StateWatch | None = StateWatch()
        self._strangers = StrangerWatch()
        # The faults of a camera are printed with all others of its node.
        self._cameras = {node.path for node in nodes if node.live}
        self._changed: dict[str, dict[str, Any]] = {}  # parameters set while it ran, by node

    def expect_changes(self) -> None:
        """Print no more changes of state: from here on bring-up asks for them."""
        self._state_watch = None

    def close(self) -> None:
        """Leave ROS."""
        self._within.close()

    def spin(self, seconds: float) -> None:
        """Take messages for a while, then check."""
        self._take(seconds)
        self._check()

    def hear(self, path: str, process: str) -> None:
        """Note a sign of life of a process of a node: a report, or an answer."""
        self.heard[path] = process, time.monotonic()

    def request(self, node: GraphNode, transition: int) -> PendingTransition:
        """Ask the process of a node for a transition."""
        line = self._group.member(node).line
        self._pending[line] = PendingTransition(line, transition)
        return self._pending[line]

    def change(
        self, node: GraphNode, transition: int, within_s: float,
        runs: Callable[[], bool] = lambda: True,
    ) -> None:
        """
        Ask a node for a transition, and wait until it has made it or does not run any more.

        Raises
        ------
        GraphFailure
            If the node rejects it, or gives no answer and is idle for so long [s].

        """
        pending = self.request(node, transition)
        patience = Patience(self._group.member(node).process.pid, within_s)
        while (made := pending.poll()) is None and runs():
            if patience.is_over():
                raise GraphFailure(f'{node.label} does not answer')
            self.spin(0.02)
        if made is False:
            raise GraphFailure(f'{node.label} rejected a change of its state')

    def _take(self, within_s: float = 0.0) -> None:
        """Wait for what the nodes say, for at most so long [s], and take it."""
        for line, subject, data in self._group.lines.heard(within_s):
            if subject == CHANGE_STATE:
                if pending := self._pending.pop(line, None):
                    pending.answer(deserialize_message(data, TransitionEvent))
            else:
                kind, handler = self._handlers[subject]
                handler(deserialize_message(data, kind))

    def is_active(self, node: GraphNode, process: int) -> bool:
        """Return whether a process of a node has reported that it is active."""
        return self._active.get(node.path) == str(process)

    def changed(self, node: GraphNode) -> dict[str, Any]:
        """Return the parameters of a node that were set while it ran, with their last values."""
        self._take()
        return self._changed.get(node.path, {})

    def catch_up(self) -> None:
        """Take all that the nodes have said."""
        self._take()

    def announce(self, node: GraphNode, death: str, started_s_ago: float) -> None:
        """Publish that a node is active again, so that no node waits for what its death lost."""
        self.restarted[node.label] += 1
        message = NodeRestarted(node.path, death, started_s_ago).to_message()
        for member in self._group.members:
            member.line.send(RESTARTS, serialize_message(message))
        self._restarts.publish(message)  # for people and bags; no node of the run believes it

    def end_frames(self) -> None:
        """Say that no frame comes after the newest: answers wait for none any more."""
        seconds, nanoseconds = divmod(max(self.newest_ns, 0), 1_000_000_000)
        last = serialize_message(Clock(clock=Time(sec=seconds, nanosec=nanoseconds)))
        for member in self._group.members:
            member.line.send(LAST_FRAME, last)

    def _count(self, message: DiagnosticArray) -> None:
        try:
            scored = FrameScored.from_message(message)
        except Malformed as error:
            self._reject(error, 'the evaluator reported a frame')
            return
        self.ledger.score(scored.stamp_ns, scored.frame)
        self.scored = max(self.scored, scored.frame)
        self._detections += sum(chain.detections for chain in scored.chains)
        self._tracks += sum(chain.tracks for chain in scored.chains)
        self._on_scored(self.scored, self._detections, self._tracks)

    def _reject(self, error: Malformed, what: str) -> None:
        """Count an unsound record, and name the first of each reason."""
        self.rejected[error.reason] += 1
        if self.rejected[error.reason] == 1:
            notify(f'{what} in a record that is rejected: {error}')

    def _on_alarm_rate(self, message: DiagnosticArray) -> None:
        try:
            path, rate = rate_from_message(message)
        except Malformed as error:
            self._reject(error, 'a detector reported its false-alarm rate')
            return
        self.alarm_rates[path.rpartition('/')[2]] = rate
        for member in self._group.members:
            if member.node.name == 'viewer':
                member.line.send(ALARM_RATE, serialize_message(message))

    def _on_clock(self, message: Clock) -> None:
        stamp = stamp_key(message.clock)
        self.ledger.publish(stamp)
        self.newest_ns = max(self.newest_ns, stamp)

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
            self.hear(status.name, process)
            if state == 'active':
                self._active[status.name] = process
            if state in ('active', 'deactivating'):
                self.statuses[status.name] = status
            if status.name not in self._cameras:
                self._strangers.update(status)
            if self._state_watch:
                self._state_watch.update(label, status.name, process, state)
