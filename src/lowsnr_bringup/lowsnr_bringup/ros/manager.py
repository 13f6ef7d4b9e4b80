# SPDX-License-Identifier: Apache-2.0
"""The manager of a run: drives the nodes through their lifecycle and follows the progress."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.msg import TransitionEvent
from lowsnr_bringup.plan.graph import Node as GraphNode
from lowsnr_bringup.plan.parts import Part
from lowsnr_bringup.ros.bringup_node import bringup_node
from lowsnr_bringup.ros.domain_guard import DomainGuard
from lowsnr_bringup.ros.heard.node_reports import NodeReports
from lowsnr_bringup.ros.heard.other_parts import OtherParts
from lowsnr_bringup.ros.heard.part_report import ACTIVE
from lowsnr_bringup.ros.heard.part_report import AWAY
from lowsnr_bringup.ros.heard.part_report import ELSEWHERE
from lowsnr_bringup.ros.heard.part_report import ENDED
from lowsnr_bringup.ros.heard.part_report import NodeReport
from lowsnr_bringup.ros.heard.part_report import PartReport
from lowsnr_bringup.ros.heard.part_report import PARTS
from lowsnr_bringup.ros.heard.part_report import STARTING
from lowsnr_bringup.ros.heard.run_frames import RunFrames
from lowsnr_bringup.ros.transition import PendingTransition
from lowsnr_bringup.run.processes import notify
from lowsnr_bringup.run.processes import ProcessGroup
from lowsnr_bringup.run.results_folder import Account
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
from lowsnr_common.ros.qos import reliable
from lowsnr_common.ros.run_records import ALARM_RATE
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

    It hears and asks the nodes over the lines of their processes.  It calls no service, and
    subscribes to nothing unless parts of the run are on other hosts: on a ROS domain anybody can
    write to a topic and answer a service.

    Parameters
    ----------
    group
        The processes of the run.
    part
        The nodes of this run, or of the part of it that runs here.
    check
        Called repeatedly while waiting; raises to end the wait.
    on_scored
        Called with the number of the frame, and the totals of detections and tracks, for each
        frame that the evaluator has scored.

    """

    def __init__(
        self, group: ProcessGroup, part: Part, check: Callable[[], None],
        on_scored: Callable[[int, int, int], None],
    ) -> None:
        self._group, self._check, self._part = group, check, part
        self.frames = RunFrames(any(node.source for node in part.nodes), on_scored)
        self.reports = NodeReports(part.own)
        self._handlers: dict[str, tuple[type, Callable[[Any], None]]] = {
            SCORED: (DiagnosticArray, self.frames.score), DATA_TIME: (Clock, self.frames.publish),
            STATUS: (DiagnosticArray, self.reports.take),
            PARAMETERS: (ParameterEvent, self._on_parameters),
            ALARM_RATE: (DiagnosticArray, self._on_alarm_rate),
            LIVE_PAGE: (String, lambda page: notify(f'live page: {page.data}'))}
        self._pending: dict[Line, PendingTransition] = {}
        self._within = ExitStack()
        self._node = self._within.enter_context(bringup_node(part.manager))
        self.guard = DomainGuard(self._node, (node.path for node in part.own))
        self._restarts = self._node.create_publisher(DiagnosticArray, RESTARTS, reliable(100))
        self.parts = OtherParts(self._node, part)
        self._topics: dict[str, Callable[[Any], None]] = {
            PARTS: self.parts.hear, RESTARTS: self._on_restart_elsewhere,
            ALARM_RATE: self._on_alarm_rate_elsewhere,
            SCORED: self.frames.score, DATA_TIME: self.frames.publish}
        self.stage, self.states = STARTING, {node.path: AWAY for node in part.own}
        self.restarted: Counter[str] = Counter()
        self.alarm_rates: dict[str, AlarmRate] = {}  # the newest, by the name of the node
        self.rejected: Counter[str] = Counter()  # unsound records, by reason
        self._labels = {node.path: node.label for node in part.nodes}
        self._changed: dict[str, dict[str, Any]] = {}  # parameters set while it ran, by node

    def close(self) -> None:
        """Leave ROS, once the other parts know the end of this one, if it was one of the run."""
        if self.stage == ENDED:
            self.report_part()
        self.parts.leave()
        self._within.close()

    def account(self) -> Account:
        """Return what is known of the run at its end."""
        self.frames.ledger.publish_unheard(self.parts.published)
        return Account(self.frames.ledger, self.restarted, self.alarm_rates)

    def report_part(self) -> None:
        """Tell the other parts of the run how this one is."""
        self.parts.report(PartReport(
            self._node.get_fully_qualified_name(), self._part.options, self.stage,
            self.frames.ledger.published, max(self.newest_ns, 0), {
                path: NodeReport(self.states.get(path, ELSEWHERE), self.restarted[label])
                for path, label in self._labels.items()}))

    @property
    def newest_ns(self) -> int:
        """Return the latest stamp of a published frame, -1 before the first [ns]."""
        return max(self.frames.newest_ns, self.parts.newest_ns)

    def spin(self, seconds: float) -> None:
        """Take messages for a while, then check."""
        self._take(seconds)
        self.report_part()
        self._check()

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
        for subject, message in self.parts.take():
            self._handle(subject, self._topics[subject], message)
        for line, subject, data in self._group.lines.heard(within_s):
            if subject == CHANGE_STATE:
                if pending := self._pending.pop(line, None):
                    pending.answer(deserialize_message(data, TransitionEvent))
            else:
                kind, handler = self._handlers[subject]
                message = deserialize_message(data, kind)
                self._handle(subject, handler, message)
                if subject == ALARM_RATE:
                    self.parts.publish(subject, message)

    def _handle(self, subject: str, handler: Callable[[Any], None], message: Any) -> None:
        """Use a message; count an unsound record, and name the first of each reason."""
        try:
            handler(message)
        except Malformed as error:
            self.rejected[error.reason] += 1
            if self.rejected[error.reason] == 1:
                notify(f'a record of {subject} is rejected: {error}')

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
        self.states[node.path] = ACTIVE
        message = NodeRestarted(node.path, death, started_s_ago).to_message()
        self._tell(RESTARTS, message)
        self._restarts.publish(message)  # for people, bags and other parts; no node believes it

    def end_frames(self) -> None:
        """Say that no frame comes after the newest: answers wait for none any more."""
        seconds, nanoseconds = divmod(max(self.newest_ns, 0), 1_000_000_000)
        self._tell(LAST_FRAME, Clock(clock=Time(sec=seconds, nanosec=nanoseconds)))

    def _tell(self, subject: str, message: Any) -> None:
        """Tell all own nodes; each takes what it listens for."""
        data = serialize_message(message)
        for member in self._group.members:
            member.line.send(subject, data)

    def _on_restart_elsewhere(self, message: DiagnosticArray) -> None:
        """Tell the own nodes, so that none waits for what a node of another part lost."""
        restarted = NodeRestarted.from_message(message)
        if self.parts.is_expected(restarted.node):
            self.restarted[self._labels[restarted.node]] += 1
            notify(f'{self._labels[restarted.node]} is back on its host: it {restarted.death}')
            self._tell(RESTARTS, message)

    def _on_alarm_rate(self, message: DiagnosticArray) -> None:
        path, rate = rate_from_message(message)
        self.alarm_rates[path.rpartition('/')[2]] = rate
        self._tell(ALARM_RATE, message)

    def _on_alarm_rate_elsewhere(self, message: DiagnosticArray) -> None:
        """Take the rate of a detector of another part; the own ones tell it over their lines."""
        if self.parts.is_expected(rate_from_message(message)[0]):
            self._on_alarm_rate(message)

    def _on_parameters(self, event: ParameterEvent) -> None:
        if event.node in self._labels:
            self._changed.setdefault(event.node, {}).update(
                {item.name: parameter_value_to_python(item.value)
                 for item in event.changed_parameters})
