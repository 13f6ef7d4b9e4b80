# SPDX-License-Identifier: Apache-2.0
"""One run of a graph: start the nodes, activate consumers first, follow, end in order."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from contextlib import suppress
import os
from pathlib import Path
import time

from lowsnr_bringup.plan.graph import Node
from lowsnr_bringup.plan.node_command import by_process
from lowsnr_bringup.plan.parts import Part
from lowsnr_bringup.ros.graph_end import GraphEnd
from lowsnr_bringup.ros.graph_start import GraphStart
from lowsnr_bringup.ros.heard.part_report import DONE as PUBLISHED_ALL
from lowsnr_bringup.ros.heard.part_report import RUNNING
from lowsnr_bringup.ros.manager import GraphFailure
from lowsnr_bringup.ros.manager import Manager
from lowsnr_bringup.ros.node_watch import NodeWatches
from lowsnr_bringup.ros.respawner import Respawner
from lowsnr_bringup.run.forked_nodes import NodeServer
from lowsnr_bringup.run.hang_watch import HangWatch
from lowsnr_bringup.run.processes import NodeProcess
from lowsnr_bringup.run.processes import NONE
from lowsnr_bringup.run.processes import notify
from lowsnr_bringup.run.processes import ProcessGroup
from lowsnr_bringup.run.results_folder import Account
from lowsnr_bringup.run.results_folder import PARAMETERS_FILE
from lowsnr_bringup.run.results_folder import start_files
from lowsnr_bringup.run.stop_signals import StopSignals
from tqdm import tqdm

_END_WITHIN_S, _FLUSH_WITHIN_S, _HEARD_WITHIN_S = 30.0, 2.0, 2.0
# Time beyond that of the evaluator's own wait for answers, after which no frame will be scored.
_PATIENCE_BEYOND_S = 2.0
DONE, FAILED, INTERRUPTED = 0, 1, 130


class Interrupted(Exception):
    """A signal asks the run to end, or to end faster."""


class RunOver(Exception):
    """The part of the run that has the evaluator has ended."""


class Supervisor:
    """
    Runs a graph, or the part of it that is this host's, to its end.

    Parameters
    ----------
    part
        The nodes.  A part without the evaluator ends when the one with it does.
    folder
        Results folder, which holds ``parameters.yaml``; logs go to its ``log``.
    frames
        Number of frames that the source publishes, None for no end.
    answer_within_s
        Wall time after which the evaluator counts a frame as unanswered, and a node that gives
        no sign of life as hanging [s].
    stop
        The signals that ask the run to end; the first ends it in order, another faster.
    claim
        File descriptor of the claim on the ROS domain, which every node holds too.
    respawn
        Whether nodes that die or hang are started again; a node that hangs while the graph starts
        is in any case, because nothing is lost by that.
    environment
        Environment of the nodes.
    server
        Forks the nodes; without it each starts its own Python.
    expect_within_s
        Longest wait for the other parts of the run [s].

    """

    def __init__(
        self, part: Part, folder: Path, frames: int | None, answer_within_s: float,
        stop: StopSignals, claim: int, respawn: bool = False,
        environment: Mapping[str, str] = os.environ, server: NodeServer | None = None,
        expect_within_s: float = float('inf'),
    ) -> None:
        self._part, self._nodes, self._expect_within_s = part, part.own, expect_within_s
        self._folder, self._frames, self._stop, self._respawn = folder, frames, stop, respawn
        self._patience_s = answer_within_s + _PATIENCE_BEYOND_S
        self._hang_watch = HangWatch(answer_within_s)
        self._environment, self._server, self._claim = environment, server, claim
        self._stops_faster: int | None = None  # once the run ends: signals that end it faster
        self.account, self._watches = Account(), NodeWatches(part.own)
        self.results = self._watches.results
        self._missed: dict[Node, str] = {}  # nodes that stay dead, and how they died

    def run(self) -> tuple[int, str]:
        """
        Run the graph; return the exit status, and what failed, empty if nothing did.

        Raises
        ------
        DomainTaken
            If nodes of another run answer on the domain; this run has changed none of them.

        """
        with tqdm(desc='starting', total=self._frames, unit=' frames',
                  disable=None) as self._bar, \
                ProcessGroup(
                    self._folder / 'log', self._environment, self._server,
                    self._claim) as self._group, \
                closing(Manager(
                    self._group, self._part, self._check, self._on_scored)) as self._manager:
            if self._server is not None:
                self._server.wait()
            self._manager.guard.check_before_start()
            if conflict := self._manager.parts.wait_for_reports(self._manager.catch_up):
                return (FAILED, conflict)
            self._joins = self._manager.parts.running
            try:
                for node, *others in () if self._joins else by_process(self._nodes):
                    self._group.start_together(
                        dict.fromkeys([node, *others], NONE), self._folder / PARAMETERS_FILE)
            except OSError as error:
                return (FAILED, f'{node.process or node.label} cannot be started: {error}')
            return self._run_processes()

    def _run_processes(self) -> tuple[int, str]:
        self._respawner = Respawner(
            self._group, self._manager, self._folder, start_files(self._folder))
        try:
            with suppress(RunOver):
                self._follow()
            self._end(_END_WITHIN_S)
            lacking = [death for node, death in self._missed.items() if node.needed]
            return (FAILED, lacking[0]) if lacking else (DONE, '')
        except (GraphFailure, Interrupted) as error:
            self._end(_FLUSH_WITHIN_S)
            if isinstance(error, GraphFailure):
                return (FAILED, str(error))
            # A part without the evaluator has no results that could lack something.
            return (INTERRUPTED, 'interrupted') if self._part.evaluates else (DONE, '')
        finally:
            self._group.stop(self._manager.catch_up)
            self._manager.catch_up()  # what they said at last belongs to the account
            self._watches.update(self._manager.reports.statuses)
            self._watches.sum_up()
            self.account = self._manager.account()

    def _follow(self) -> None:
        """Start the graph, and wait until the source is done and its frames are scored."""
        if self._joins or not GraphStart(
                self._manager, self._group, self._part, self._expect_within_s).run():
            self._respawner.join(self._nodes)
        self._respawner.autostart, self._manager.stage = True, RUNNING
        self._bar.unpause()  # the rate is that of the frames, not of the start
        self._bar.set_description('running')
        while not self._source_done():
            self._manager.spin(0.1)
        until_s = time.monotonic() + _HEARD_WITHIN_S
        while self._manager.frames.newest_ns < self._manager.parts.newest_ns and (
                time.monotonic() < until_s):  # the last word of another part's source
            self._manager.spin(0.02)
        self._manager.catch_up()
        self._manager.end_frames()
        while not self._part.evaluates:
            self._manager.spin(0.1)  # until the run is over
        frames, scored, since = self._manager.frames, 0, time.monotonic()
        while frames.ledger.awaits and self._frames is not None:
            self._manager.spin(0.1)
            if frames.scored != scored:
                scored, since = frames.scored, time.monotonic()
            if time.monotonic() - since > self._patience_s:
                break

    def _end(self, within_s: float) -> None:
        """End the nodes in order; where a signal asks for it, without that."""
        self._stops_faster = self._stop.count + 1
        without = self._respawner.away | set(self._missed)
        if not self._respawner.autostart:  # in a start nothing is scored, and nodes may compile
            without |= set(self._nodes)
        with suppress(Interrupted):
            GraphEnd(self._manager, self._group, self._part).run(within_s, without)

    def _check(self) -> None:
        """Handle dead nodes; raise if the run is interrupted or cannot go on without one."""
        if self._stop.count >= (self._stops_faster or 1):
            raise Interrupted
        if self._stops_faster:
            return
        if not self._part.evaluates and self._manager.parts.over:
            raise RunOver
        self._manager.parts.watch()
        if not self._respawner.autostart:
            self._manager.guard.check()
        for member in self._group.dead():
            if member.node.source and member.process.returncode == 0:
                continue
            if member.node not in self._missed and not (
                    (self._respawn or member.hung) and self._respawner.schedule(member)):
                self._continue_without(member)
        self._respawner.update()
        self._end_hanging()
        self._watches.update(self._manager.reports.statuses)

    def _end_hanging(self) -> None:
        """Kill the nodes that hang where they are to be started again, otherwise name them."""
        starting = not self._respawner.autostart
        hanging = self._hang_watch.update(self._group.members, self._manager.reports.heard)
        for member, how in hanging.items():
            if self._respawn or starting:
                self._group.kill(member, how)
            else:
                self._hang_watch.name(
                    member, how, '; only with --respawn does bring-up start it again')

    def _continue_without(self, member: NodeProcess) -> None:
        """Continue without a node that stays dead, or raise if the run needs it."""
        report = (f'{member.node.label} {member.death()} at frame {self._manager.frames.scored}; '
                  f'the end of {member.log}:\n{member.last_lines()}')
        spare = not member.node.needed or (self._respawn and member.node.name == 'recorder')
        self._missed[member.node] = report
        if not (spare and self._manager.frames.scored):
            raise GraphFailure(report)
        notify(f'the run goes on without {report}')

    def _source_done(self) -> bool:
        """Return whether the source of the run, here or in another part, has done its work."""
        done = [member.node for member in self._group.dead()
                if member.node.source and member.process.returncode == 0]
        self._manager.states |= {node.path: PUBLISHED_ALL for node in done}
        return bool(done) or any(
            self._manager.parts.state(node) == PUBLISHED_ALL
            for node in self._part.expected if node.source)

    def _on_scored(self, frame: int, detections: int, tracks: int) -> None:
        self._bar.update(frame - self._bar.n)
        self._bar.set_postfix(detections=detections, tracks=tracks, refresh=False)
