# SPDX-License-Identifier: Apache-2.0
"""
The other parts of a run, whose bring-ups run on other hosts.

What the lines carry between bring-up and its own nodes, ROS topics of the same names carry
between hosts.  Nothing here compares the clocks of two hosts: stamps are those of the frames, and
how long ago something was heard is measured by the own steady clock.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from lowsnr_bringup.plan.graph import Node as GraphNode
from lowsnr_bringup.plan.parts import Part
from lowsnr_bringup.ros.heard.part_report import ELSEWHERE
from lowsnr_bringup.ros.heard.part_report import ENDED
from lowsnr_bringup.ros.heard.part_report import NodeReport
from lowsnr_bringup.ros.heard.part_report import PartReport
from lowsnr_bringup.ros.heard.part_report import PARTS
from lowsnr_bringup.ros.heard.part_report import RUNNING
from lowsnr_bringup.run.processes import notify
from lowsnr_common.ros.bringup_line import DATA_TIME
from lowsnr_common.ros.inputs import take_waiting
from lowsnr_common.ros.qos import reliable
from lowsnr_common.ros.run_records import ALARM_RATE
from lowsnr_common.ros.run_records import RESTARTS
from lowsnr_common.ros.run_records import SCORED
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy
from rosgraph_msgs.msg import Clock

_REPORT_EVERY_S = 1.0
# A part that has not been heard for so long is away.
AWAY_AFTER_S = 5.0
# Bring-ups that were there before are heard within this time.
_HEARD_WITHIN_S, _LOOK_EVERY_S = 1.0, 0.02
_FRAMES = 1000
_ACKNOWLEDGED = Duration(seconds=2)
# Whoever comes late gets the newest report of each part.  A reader has one queue for all parts,
# itself included: a report must not push that of another part out of it.
_NEWEST, _OF_ALL = (
    QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE,
               durability=DurabilityPolicy.TRANSIENT_LOCAL) for depth in (1, _FRAMES))


class OtherParts:
    """
    Reports the own part to others, and keeps what they report.

    A run that is whole on this host has no other parts: nothing is published or heard then.

    Parameters
    ----------
    node
        Bring-up's node.
    part
        The own part.
    clock
        A steady clock [s].

    """

    def __init__(
        self, node: Node, part: Part, clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._part, self._clock = part, clock
        self._expected = {each.path for each in part.expected}
        self._name = node.get_fully_qualified_name()
        self._heard: dict[str, tuple[PartReport, float]] = {}
        self._refused: dict[str, str] = {}  # why, by the name of a part
        self._named: set[str] = set()  # parts whose absence, and reasons that have been printed
        self._sent: tuple[PartReport | None, float] = None, 0.0
        self._publishers: dict[str, Any] = {}
        self._subscriptions: dict[str, Any] = {}
        if not part.expected:
            return
        names = {each.name for each in part.expected}
        topics: dict[str, tuple[type, QoSProfile]] = {
            PARTS: (DiagnosticArray, _NEWEST), ALARM_RATE: (DiagnosticArray, reliable(_FRAMES)),
            RESTARTS: (DiagnosticArray, reliable(_FRAMES))}
        self._publishers = {
            topic: node.create_publisher(kind, topic, qos)
            for topic, (kind, qos) in topics.items() if topic != RESTARTS}  # it has one already
        if any(each.source for each in part.expected):
            topics[DATA_TIME] = Clock, reliable(_FRAMES)
        if 'evaluator' in names:
            topics[SCORED] = DiagnosticArray, reliable(_FRAMES)
        self._subscriptions = {
            topic: node.create_subscription(
                kind, topic, lambda _: None, _OF_ALL if topic == PARTS else qos)
            for topic, (kind, qos) in topics.items()}

    def take(self) -> Iterator[tuple[str, Any]]:
        """Yield topic and message of all that was said about other parts."""
        for topic, subscription in self._subscriptions.items():
            for message, _ in take_waiting(subscription):
                yield topic, message

    def hear(self, message: DiagnosticArray) -> None:
        """Take the report of a part, unless it is not one of this run; Malformed if unsound."""
        report = PartReport.from_message(message)
        first = report.part not in self._heard
        if report.part == self._name or (first and report.stage == ENDED):  # of an earlier run
            return
        if fault := self._conflict(report):
            self._refused[report.part] = fault
            return
        self._refused.pop(report.part, None)
        if report.part in self._named:
            self._named.discard(report.part)
            notify(f'{_labels(report)}: heard again')
        self._heard[report.part] = report, self._clock()

    def is_expected(self, path: str) -> bool:
        """Return whether a node runs in another part."""
        return path in self._expected

    def publish(self, topic: str, message: Any) -> None:
        """Tell the other parts what a node of this one said."""
        if topic in self._publishers:
            self._publishers[topic].publish(message)

    def report(self, report: PartReport) -> None:
        """Tell the other parts the state of this one, if it has changed or once a second."""
        before, since_s = self._sent
        now_s = self._clock()
        if PARTS in self._publishers and (
                _without_frames(report) != before or now_s - since_s > _REPORT_EVERY_S):
            self._sent = _without_frames(report), now_s
            self._publishers[PARTS].publish(report.to_message())

    def leave(self) -> None:
        """Wait for a while until the others have received what was published."""
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(_ACKNOWLEDGED)

    def wait_for_reports(self, take: Callable[[], None]) -> str:
        """
        Wait for the part with the evaluator, not for long.

        Return why this part does not fit into the run that was there before, empty if it does.
        """
        until_s = self._clock() + _HEARD_WITHIN_S
        while self._part.expected and self._clock() < until_s:
            take()
            if any('/evaluator' in report.own for report, _ in self._heard.values()):
                break
            time.sleep(_LOOK_EVERY_S)
        return next(iter(self._refused.values()), '')

    def state(self, node: GraphNode) -> str:
        """Return the state of an expected node, `ELSEWHERE` while its part is not heard."""
        return next((report.nodes[node.path].state for report in self._present
                     if node.path in report.own), ELSEWHERE)

    def restarts(self, path: str) -> int:
        """Return how often the other parts know that a node was started again."""
        return max((report.nodes.get(path, NodeReport()).restarts
                    for report, _ in self._heard.values()), default=0)

    @property
    def published(self) -> int:
        """Return how many frames the other parts know to be published."""
        return max((report.published for report, _ in self._heard.values()), default=0)

    @property
    def newest_ns(self) -> int:
        """Return the latest stamp of the frames that other parts know of, -1 for none [ns]."""
        return max((report.newest_ns for report, _ in self._heard.values()), default=0) or -1

    @property
    def running(self) -> bool:
        """Return whether the run is under way: this part joins it, or comes back to it."""
        return any(report.stage == RUNNING for report in self._present
                   if self._part.evaluates or '/evaluator' in report.own)

    @property
    def _present(self) -> list[PartReport]:
        """Return the newest reports of the parts that are not away."""
        now_s = self._clock()
        return [report for report, heard_s in self._heard.values()
                if now_s - heard_s < AWAY_AFTER_S]

    @property
    def over(self) -> bool:
        """Return whether the part with the evaluator has ended, and so has the run."""
        return any(report.stage == ENDED and '/evaluator' in report.own
                   for report, _ in self._heard.values())

    def _conflict(self, report: PartReport) -> str:
        """Return why a part that was heard does not belong to the same run, empty if it does."""
        if report.options != self._part.options:
            return (f'{_labels(report)}: started with other options or configuration than this '
                    'part: all parts need the same but for --only and --expect')
        held = {self._name: {each.path for each in self._part.own}} | {
            other.part: other.own for other in self._present
            if other.part != report.part and other.stage != ENDED}
        return next((
            f'{", ".join(sorted(both))} runs in two parts ({part} and {report.part})'
            for part, own in held.items() if (both := own & report.own)), '')

    def watch(self) -> None:
        """Print once which part is not heard any more, has ended, or is not of this run."""
        now_s = self._clock()
        for name, (report, heard_s) in self._heard.items():
            away = report.stage == ENDED or now_s - heard_s > AWAY_AFTER_S
            if away and name not in self._named:
                self._named.add(name)
                how = ('has ended' if report.stage == ENDED
                       else f'not heard for {AWAY_AFTER_S:g} s')
                notify(f'{_labels(report)}: {how}; frames lack what it does until its bring-up '
                       'runs again')
        for fault in self._refused.values():
            if fault not in self._named:
                self._named.add(fault)
                notify(f'{fault}; this part does not heed that one')


def _labels(report: PartReport) -> str:
    """Return the nodes of a part, for people."""
    return ', '.join(sorted(path.strip('/').replace('/', '.') for path in report.own))


def _without_frames(report: PartReport) -> PartReport:
    """Return what of a report is sent at once when it changes."""
    return PartReport(report.part, report.options, report.stage, nodes=report.nodes)
