# SPDX-License-Identifier: Apache-2.0
"""The end of a graph: the source stops first, and the evaluator after all that it scores."""

from __future__ import annotations

from collections.abc import Set as AbstractSet
import signal
import time

from lowsnr_bringup.plan.graph import Node
from lowsnr_bringup.plan.parts import Part
from lowsnr_bringup.ros.heard.part_report import ACTIVE
from lowsnr_bringup.ros.heard.part_report import CONFIGURED
from lowsnr_bringup.ros.heard.part_report import ENDED
from lowsnr_bringup.ros.manager import DEACTIVATE
from lowsnr_bringup.ros.manager import GraphFailure
from lowsnr_bringup.ros.manager import Manager
from lowsnr_bringup.run.processes import NodeProcess
from lowsnr_bringup.run.processes import notify
from lowsnr_bringup.run.processes import ProcessGroup

_SOURCE_STOPS_WITHIN_S = 2.0


class GraphEnd:
    """
    Deactivates the nodes of a part of a run, or of a whole one.

    The source comes first, the evaluator after all whose answers it scores, and the recorder
    last, because it records the others.

    Parameters
    ----------
    manager, group
        The client of the nodes' lifecycles, and the processes.
    part
        The nodes, subscribers before publishers.

    """

    def __init__(self, manager: Manager, group: ProcessGroup, part: Part) -> None:
        self._manager, self._group, self._part = manager, group, part

    def run(self, within_s: float, without: AbstractSet[Node]) -> None:
        """
        Deactivate the nodes, and print which cannot be.

        Parameters
        ----------
        within_s
            Longest time for one node [s].
        without
            Nodes that are known to be dead, or have nothing to finish.

        """
        self._manager.reports.expect_changes()
        self._manager.stage = ENDED
        self._wait_for_source(min(within_s, _SOURCE_STOPS_WITHIN_S))
        dead = {member.node for member in self._group.dead()} | without
        members = [member for member in self._group.members if member.node in self._part.own]
        order = {node: n for n, node in enumerate(reversed(self._part.own))}
        for member in sorted(
                members, key=lambda each: (each.node.name == 'recorder', order[each.node])):
            if member.node not in dead:
                self._deactivate(member, within_s)
            if member.process.poll() and member.node not in without:
                notify(f'while stopping: {member.node.label} {member.death()}')

    def _wait_for_source(self, within_s: float) -> None:
        """Have the other parts know of the end, and wait until their source has stopped."""
        until_s = time.monotonic() + within_s
        sources = [node for node in self._part.expected if node.source and self._part.evaluates]
        while time.monotonic() < until_s and any(
                self._manager.parts.state(node) == ACTIVE for node in sources):
            self._manager.spin(0.02)
        self._manager.report_part()

    def _deactivate(self, member: NodeProcess, within_s: float) -> None:
        """Deactivate a node, also one that was stopped, and print why if that fails."""
        member.process.send_signal(signal.SIGCONT)
        try:
            self._manager.change(
                member.node, DEACTIVATE, within_s, lambda: member.process.poll() is None)
            self._manager.states[member.node.path] = CONFIGURED
        except GraphFailure as error:
            notify(f'while stopping: {error}')
