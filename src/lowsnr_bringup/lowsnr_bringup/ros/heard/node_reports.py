# SPDX-License-Identifier: Apache-2.0
"""What the own nodes of bring-up report about themselves."""

from __future__ import annotations

from collections.abc import Iterable
import time

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from lowsnr_bringup.plan.graph import Node
from lowsnr_bringup.ros.node_watch import StateWatch
from lowsnr_bringup.ros.node_watch import StrangerWatch


class NodeReports:
    """
    Keeps the newest status of each node, and has what is wrong printed.

    ``heard`` is process and time [s] of the last sign of life of a node by its full name, and
    ``statuses`` its newest status while it was active.
    """

    def __init__(self, nodes: Iterable[Node]) -> None:
        self._labels = {node.path: node.label for node in nodes}
        # The faults of a camera are printed with all others of its node.
        self._cameras = {node.path for node in nodes if node.live}
        self.heard: dict[str, tuple[str, float]] = {}
        self.statuses: dict[str, DiagnosticStatus] = {}
        self._active: dict[str, str] = {}  # process by node
        self._state_watch: StateWatch | None = StateWatch()
        self._strangers = StrangerWatch()

    def expect_changes(self) -> None:
        """Print no more changes of state: from here on bring-up asks for them."""
        self._state_watch = None

    def hear(self, path: str, process: str) -> None:
        """Note a sign of life of a process of a node: a report, or an answer."""
        self.heard[path] = process, time.monotonic()

    def is_active(self, node: Node, process: int) -> bool:
        """Return whether a process of a node has reported that it is active."""
        return self._active.get(node.path) == str(process)

    def take(self, message: DiagnosticArray) -> None:
        """Take the report of a node."""
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
