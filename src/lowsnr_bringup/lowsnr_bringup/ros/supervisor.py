"""One run of a graph: start the nodes, activate consumers first, follow, end in order."""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from contextlib import closing
import os
from pathlib import Path
import signal
import time
from typing import Any

from lowsnr_bringup.plan.graph import Node
from lowsnr_bringup.ros.manager import ACTIVATE
from lowsnr_bringup.ros.manager import CONFIGURE
from lowsnr_bringup.ros.manager import DEACTIVATE
from lowsnr_bringup.ros.manager import GraphFailure
from lowsnr_bringup.ros.manager import Manager
from lowsnr_bringup.ros.node_watch import CameraWatch
from lowsnr_bringup.ros.respawner import Respawner
from lowsnr_bringup.run.forked_nodes import NodeServer
from lowsnr_bringup.run.middleware import PROFILE_FILE
from lowsnr_bringup.run.processes import NodeProcess
from lowsnr_bringup.run.processes import notify
from lowsnr_bringup.run.processes import ProcessGroup
from lowsnr_bringup.run.results_folder import Account
from lowsnr_bringup.run.results_folder import PARAMETERS_FILE
from tqdm import tqdm

_START_WITHIN_S = 600.0
_ACTIVATE_WITHIN_S = 30.0
_FLUSH_WITHIN_S = 2.0
DONE, FAILED, INTERRUPTED = 0, 1, 130


class Interrupted(Exception):
    """A signal asks the run to end."""


class Supervisor:
    """
    Runs a graph to its end.

    Parameters
    ----------
    nodes
        The nodes, consumers first; the source of the frames, if any, last.
    folder
        Results folder, which holds ``parameters.yaml``; logs go to its ``log``.
    frames
        Number of frames that the source publishes, None for no end.
    patience_s
        Wall time without a newly scored frame after which the run ends without the rest [s].
    respawn
        Whether nodes that die are started again.
    environment
        Environment of the nodes.
    server
        Forks the nodes; without it each starts its own Python.

    """

    def __init__(
        self, nodes: Sequence[Node], folder: Path, frames: int | None, patience_s: float,
        respawn: bool = False, environment: Mapping[str, str] = os.environ,
        server: NodeServer | None = None,
    ) -> None:
        self._nodes = nodes
        self._folder = folder
        self._frames = frames
        self._patience_s = patience_s
        self._environment, self._server = environment, server
        self._signal = 0
        self._respawn = respawn
        self._respawner: Respawner | None = None
        self.account = Account()
        self._watch = CameraWatch()
        self._missed: dict[Node, str] = {}  # nodes that stay dead, and how they died

    def run(self) -> tuple[int, str]:
        """
        Run the graph; return the exit status, and what failed, empty if nothing did.

        Raises
        ------
        DomainTaken
            If nodes of another run answer on the domain; this run has changed none of them.

        """
        before = {s: signal.signal(s, self._on_signal) for s in (signal.SIGINT, signal.SIGTERM)}
        try:
            with ProcessGroup(
                    self._folder / 'log', self._environment, self._server) as self._group, \
                    closing(Manager(
                        self._group, self._nodes, self._check, self._on_scored)) as self._manager:
                if self._server is not None:
                    self._server.wait()
                self._manager.guard.check_before_start()
                return self._run_processes()
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _run_processes(self) -> tuple[int, str]:
        for node in self._nodes:
            self._group.start(node, self._folder / PARAMETERS_FILE)
        with tqdm(
            desc='starting', total=self._frames, unit=' frames', disable=None,
        ) as self._bar:
            try:
                self._follow()
                self._end(_ACTIVATE_WITHIN_S)
                lacking = [death for node, death in self._missed.items() if node.needed]
                return (FAILED, lacking[0]) if lacking else (DONE, '')
            except (GraphFailure, Interrupted) as error:
                self._end(_FLUSH_WITHIN_S)
                failed = isinstance(error, GraphFailure)
                return (FAILED, str(error)) if failed else (INTERRUPTED, 'interrupted')
            finally:
                self._manager.catch_up()
                self.account.published = self._manager.published
                self.account.restarts = self._manager.restarted

    def _follow(self) -> None:
        """Activate the nodes, and wait until the source is done and its frames are scored."""
        self._manager.change(CONFIGURE, self._nodes, _START_WITHIN_S)
        for node in self._nodes:
            self._manager.change(ACTIVATE, [node], _ACTIVATE_WITHIN_S)
        if self._respawn:
            self._respawner = Respawner(
                self._group, self._manager, self._folder, _texts(self._folder))
        self._starting = False
        self._bar.unpause()  # the rate is that of the frames, not of the start
        self._bar.set_description('running')
        while not self._source_done():
            self._manager.spin(0.1)
        scored, since = self._manager.scored, time.monotonic()
        while self._manager.scored != self._frames and self._frames is not None:
            self._manager.spin(0.1)
            if self._manager.scored != scored:
                scored, since = self._manager.scored, time.monotonic()
            if time.monotonic() - since > self._patience_s:
                break

    def _end(self, within_s: float) -> None:
        """
        Deactivate the source first, and the evaluator after all whose answers it scores.

        The recorder comes last, because it records the others.
        """
        self._check_enabled = False
        self._manager.expect_changes()
        dead = {member.node for member in self._group.dead()}
        if self._respawner:
            dead |= self._respawner.away
        recorders = [node for node in self._nodes if node.name == 'recorder']
        others = [node for node in reversed(self._nodes) if node not in recorders]
        for node in others + recorders:
            if node in dead:
                continue
            try:
                self._manager.change(DEACTIVATE, [node], within_s)
            except GraphFailure as error:
                notify(f'while stopping: {error}')

    _check_enabled = _starting = True

    def _check(self) -> None:
        """Handle dead nodes; raise if the run is interrupted or cannot go on without one."""
        if not self._check_enabled:
            return
        if self._signal:
            raise Interrupted
        if self._starting:
            self._manager.guard.check()
        for member in self._group.dead():
            if member.node.source and member.process.returncode == 0:
                continue
            if member.node not in self._missed and not (
                    self._respawner and self._respawner.schedule(member)):
                self._continue_without(member)
        if self._respawner:
            self._respawner.update()
        self._watch_camera()

    def _watch_camera(self) -> None:
        """Print the faults that the node nearest to the camera reports."""
        path = next((node.path for node in reversed(self._nodes) if node.live), '')
        if path in self._manager.statuses:
            self._watch.update(self._manager.statuses.pop(path))

    def _continue_without(self, member: NodeProcess) -> None:
        """Continue without a node that stays dead, or raise if the run needs it."""
        report = (f'{member.node.label} {member.death()} at frame {self._manager.scored}; '
                  f'the end of {member.log}:\n{member.last_lines()}')
        spare = not member.node.needed or (self._respawner and member.node.name == 'recorder')
        if not (spare and self._manager.scored):
            raise GraphFailure(report)
        self._missed[member.node] = report
        notify(f'the run goes on without {report}')

    def _source_done(self) -> bool:
        return any(member.node.source and member.process.returncode == 0
                   for member in self._group.dead())

    def _on_signal(self, number: int, _: Any) -> None:
        self._signal = number

    def _on_scored(self, frame: int, detections: int, tracks: int) -> None:
        self._bar.update(frame - self._bar.n)
        self._bar.set_postfix(detections=detections, tracks=tracks, refresh=False)


def _texts(folder: Path) -> dict[Path, str]:
    """Return the files that nodes read when they start, the parameters first."""
    paths = [folder / PARAMETERS_FILE, folder / PROFILE_FILE]
    return {path: path.read_text(encoding='utf-8') for path in paths if path.exists()}
