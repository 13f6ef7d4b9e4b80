# SPDX-License-Identifier: Apache-2.0
"""Restart of the nodes that die in a run."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
import csv
from dataclasses import dataclass
from dataclasses import field
from pathlib import Path
import time

from lowsnr_bringup.plan.graph import Node
from lowsnr_bringup.plan.node_command import by_process
from lowsnr_bringup.ros.manager import Manager
from lowsnr_bringup.run.middleware import clear_leftovers
from lowsnr_bringup.run.processes import NodeProcess
from lowsnr_bringup.run.processes import notify
from lowsnr_bringup.run.processes import ProcessGroup
from lowsnr_bringup.run.results_folder import RESTARTS_FILE
from lowsnr_common.core.process_setup import SHUT_DOWN
from lowsnr_common.core.process_setup import USAGE_ERROR

_COLUMNS = ('frame', 'node', 'death', 'down_s')
_AGAIN_AFTER_S = 5.0
# Exit statuses after which a node is not started again: it would end the same way, or an
# operator has shut it down.  A recorder ends with 1 when the disk is full.
_FINAL = (USAGE_ERROR, SHUT_DOWN)
_FINAL_OF = {'recorder': (*_FINAL, 1)}


@dataclass(frozen=True)
class RespawnPolicy:
    """
    How often, and after what wait, a node that died is started again.

    Bring-up starts a node again after the first death within ``window_s`` at once, after the
    second in ``wait_s``, after each further one in twice the wait before, and gives the node up
    after more than ``most``.
    """

    most: int = 5
    window_s: float = 60.0
    wait_s: float = 0.5


@dataclass
class Deaths:
    """The deaths of one node."""

    policy: RespawnPolicy
    count: int = 0
    _recent: deque[float] = field(default_factory=deque)

    def add(self, now_s: float) -> float | None:
        """Count a death; return how long to wait [s], or None if the node is given up."""
        self.count += 1
        while self._recent and now_s - self._recent[0] > self.policy.window_s:
            self._recent.popleft()
        self._recent.append(now_s)
        recent = len(self._recent)
        if recent > self.policy.most:
            return None
        return 0.0 if recent == 1 else self.policy.wait_s * 2.0 ** (recent - 2)


@dataclass
class _Case:
    """
    A node that died: how, at which frame and when [s].

    ``start_s`` is when it is due to start, ``process`` its new process if that has started.
    """

    death: str
    frame: int
    died_s: float
    start_s: float
    process: NodeProcess | None = None
    started_s: float = 0.0


@dataclass
class Respawner:
    """
    Starts nodes again that died, and announces them once they are active.

    A node of a graph that runs configures and activates itself.  While the graph starts,
    ``autostart`` is false: :class:`lowsnr_bringup.ros.graph_start.GraphStart` does it in order.

    Parameters
    ----------
    group, manager
        The processes, and the manager that announces them.
    folder
        Results folder, whose ``restarts.csv`` gets a line for each restart.
    files
        Texts of the files that a node needs at its start; a file that is gone is written again.

    """

    group: ProcessGroup
    manager: Manager
    folder: Path
    files: dict[Path, str]
    policy: RespawnPolicy = field(default_factory=RespawnPolicy)
    autostart: bool = False
    _deaths: dict[Node, Deaths] = field(default_factory=dict)
    _cases: dict[Node, _Case] = field(default_factory=dict)

    @property
    def away(self) -> set[Node]:
        """Return the nodes that have died and are not active again yet."""
        return set(self._cases)

    def join(self, nodes: Iterable[Node]) -> None:
        """
        Schedule the start of nodes of a graph that runs on other hosts already.

        Processes that they have had for a start in order are ended.
        """
        self.group.stop(self.manager.catch_up)
        self.group.members = []
        self.autostart, now_s = True, time.monotonic()
        for node in nodes:
            known = self.manager.restarted[node.label] = self.manager.parts.restarts(node.path)
            self._deaths[node] = Deaths(self.policy, known + 1)
            self._cases[node] = _Case(
                'was away with its host', self.manager.frames.scored, now_s, now_s)

    def schedule(self, member: NodeProcess) -> bool:
        """Schedule the restart of a dead member; return False if it stays dead."""
        node, now_s = member.node, time.monotonic()
        if node in self._cases and self._cases[node].process is not member:
            return True  # it is scheduled
        self.manager.catch_up()
        deaths = self._deaths.setdefault(node, Deaths(self.policy))
        wait_s = deaths.add(now_s)
        if wait_s is None or member.process.returncode in _FINAL_OF.get(node.name, _FINAL):
            self._cases.pop(node, None)
            return False
        clear_leftovers()
        first = self._cases.get(node)
        died_s = first.died_s if first else now_s
        frame = self.manager.frames.scored
        self._cases[node] = _Case(member.death(), frame, died_s, now_s + wait_s)
        notify(
            f'{node.label} {member.death()} at frame {frame}; '
            f'bring-up starts it again (restart {deaths.count})')
        return True

    def update(self) -> None:
        """Start the nodes that are due, and announce those that are active again."""
        now_s = time.monotonic()
        for node, case in list(self._cases.items()):
            if case.process and self.manager.reports.is_active(node, case.process.process.pid):
                del self._cases[node]
                self._announce(node, case, now_s)
        waiting = [node for node, case in self._cases.items() if case.process is None]
        for together in by_process(waiting):
            if all(now_s >= self._cases[node].start_s for node in together):
                self._start(together)

    def _start(self, nodes: list[Node]) -> None:
        """Start the nodes of a process, or try later if the disk or the machine has no room."""
        cases = [self._cases[node] for node in nodes]
        try:
            for path, text in self.files.items():
                if not path.exists():
                    path.parent.mkdir(parents=True, exist_ok=True)
                    path.write_text(text, encoding='utf-8')
            started = self.group.start_together(
                {node: self._overrides(node) for node in nodes}, next(iter(self.files)))
            for case, member in zip(cases, started):
                case.process, case.started_s = member, time.monotonic()
        except OSError as error:
            for case in cases:
                case.start_s += _AGAIN_AFTER_S
            notify(
                f'{nodes[0].process or nodes[0].label} cannot be started: {error.strerror}: '
                f'{error.filename}; trying again in {_AGAIN_AFTER_S:g} s')

    def _overrides(self, node: Node) -> dict[str, object]:
        """Return the parameters with which a node is started again."""
        own: dict[str, object] = {
            **self.manager.changed(node),
            'autostart': self.autostart, 'lives': self._deaths[node].count}
        if node.source:
            own['resume_after_ns'] = self.manager.newest_ns
        return own

    def _announce(self, node: Node, case: _Case, now_s: float) -> None:
        """Publish, print and write down that a node is active again."""
        self.manager.announce(node, case.death, now_s - case.started_s)
        down_s = now_s - case.died_s
        notify(f'{node.label} is back after {down_s:.1f} s')
        path = self.folder / RESTARTS_FILE
        try:
            fresh = not path.exists()
            with path.open('a', encoding='utf-8', newline='') as file:
                table = csv.writer(file, lineterminator='\n')
                table.writerows([_COLUMNS] * fresh)
                table.writerow([case.frame, node.label, case.death, f'{down_s:.3f}'])
        except OSError as error:
            notify(f'{path}: cannot be written: {error.strerror}')
