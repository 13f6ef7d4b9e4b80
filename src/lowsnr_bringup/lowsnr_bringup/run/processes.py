# SPDX-License-Identifier: Apache-2.0
"""The processes of a graph: bring-up starts, watches and ends them."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
import signal
import subprocess
import sys
from types import MappingProxyType
from typing import BinaryIO

from lowsnr_bringup.plan.graph import Node
from lowsnr_bringup.plan.node_command import node_command
from lowsnr_bringup.run.forked_nodes import NodeServer
from lowsnr_bringup.run.forked_nodes import ServerGone
from lowsnr_bringup.run.lines import Lines
from lowsnr_bringup.run.middleware import clear_leftovers
from lowsnr_bringup.run.threads import Process
from lowsnr_bringup.run.threads import stuck
from lowsnr_common.core.line import Line
from lowsnr_common.core.process_setup import INTERRUPTED
from lowsnr_common.core.process_setup import LIFELINE
from lowsnr_common.core.process_setup import SHUT_DOWN
from lowsnr_common.core.process_setup import TERMINATED
from lowsnr_common.settings.text import printable_lines
from tqdm import tqdm

# After SIGTERM: the time for a process that does nothing, and for one that computes [s].
_TERM_WITHIN_S, _BUSY_WITHIN_S = 2.0, 15.0
_LAST_LINES = 8
_ENDED_BY = {INTERRUPTED: 'SIGINT', TERMINATED: 'SIGTERM'}
NONE: Mapping[str, object] = MappingProxyType({})


@dataclass(eq=False)
class NodeProcess:
    """
    A node's process, which it may share with others, its log file, and the line to it.

    ``hung`` is why bring-up killed it, if it did.
    """

    node: Node
    process: Process
    log: Path
    line: Line
    hung: str = ''

    def death(self) -> str:
        """Return how the process ended, in words that follow its name."""
        status = self.process.poll()
        if status is None:
            return 'runs'
        if self.hung:
            return f'{self.hung} and was killed by bring-up'
        if status < 0:
            return f'was killed by {signal.Signals(-status).name}'
        if status in _ENDED_BY:
            return f'was ended by {_ENDED_BY[status]}'
        if status == SHUT_DOWN:
            return 'was shut down through its lifecycle'
        return f'ended with status {status}'

    def last_lines(self) -> str:
        """Return the last lines of its log, indented."""
        try:
            lines = self.log.read_text(encoding='utf-8', errors='replace').splitlines()
        except OSError as error:
            return f'    (it cannot be read: {error.strerror})'
        return '\n'.join(f'    {line}' for line in lines[-_LAST_LINES:]) or '    (it is empty)'


class ProcessGroup:
    """
    Node processes that live no longer than their starter.

    Each holds one end of a line whose other end only the starter has: when the starter is gone,
    for whatever reason, the line closes and the nodes end themselves.  Use it as a context
    manager.  ``lines`` is what the processes say.

    Parameters
    ----------
    logs
        Folder for the log files; it is made if it is missing.
    environment
        Environment of the processes.
    server
        Forks the processes; without it, or once it is gone, each starts its own Python.
    claim
        File descriptor that every process holds until its end, none if None.

    """

    def __init__(
        self, logs: Path, environment: Mapping[str, str], server: NodeServer | None = None,
        claim: int | None = None,
    ) -> None:
        self._logs, self._server = logs, server
        self._claim = () if claim is None else (claim,)
        self._environment = dict(environment)
        self.lines = Lines()
        self.members: list[NodeProcess] = []

    def __enter__(self) -> ProcessGroup:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self.lines.close()

    def start(
        self, node: Node, parameter_file: Path, overrides: Mapping[str, object] = NONE,
    ) -> NodeProcess:
        """Start a node in a process of its own, as :meth:`start_together` does several in one."""
        return self.start_together({node: overrides}, parameter_file)[0]

    def start_together(
        self, nodes: Mapping[Node, Mapping[str, object]], parameter_file: Path,
    ) -> list[NodeProcess]:
        """
        Start nodes in one process; its output is appended to ``<label>.log``.

        Parameters
        ----------
        nodes
            The nodes, subscribers before publishers, and for each the values of parameters that
            take precedence over those of the file.  A process that one had before is no longer
            a member.
        parameter_file
            File with their parameters.

        Raises
        ------
        OSError
            If the log cannot be opened, or the machine has no room for another process.

        """
        first = next(iter(nodes))
        path = self._logs / f'{first.process or first.label}.log'
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open('ab') as log, ExitStack() as theirs:
            ends = [self.lines.add() for _ in nodes]
            lines = [theirs.enter_context(end).fileno() for _, end in ends]
            process = self._run(*node_command(nodes, parameter_file), log, lines)
        members = [
            NodeProcess(node, process, path, line) for node, (line, _) in zip(nodes, ends)]
        self.members = [each for each in self.members if each.node not in nodes] + members
        return members

    def _run(
        self, module: str, arguments: list[str], log: BinaryIO, lines: list[int],
    ) -> Process:
        """Start a process in a session of its own, so that Ctrl-C reaches the starter only."""
        if self._server is not None:
            try:
                return self._server.fork(
                    module, arguments, self._environment, log.fileno(), lines, *self._claim)
            except ServerGone:
                self._server = None
                notify('the process that forks nodes is gone; nodes start their own Python')
        return subprocess.Popen(
            [sys.executable, '-m', module, *arguments], stdin=subprocess.DEVNULL, stdout=log,
            stderr=subprocess.STDOUT,
            env={**self._environment, LIFELINE: ','.join(map(str, lines))},
            pass_fds=(*lines, *self._claim), start_new_session=True)

    def kill(self, member: NodeProcess, hung: str) -> None:
        """Kill a process that hangs; it may be stopped, so that no other signal reaches it."""
        for each in self.members:
            if each.process is member.process:
                each.hung = hung
        member.process.kill()

    def member(self, node: Node) -> NodeProcess:
        """Return the newest process of a node."""
        return next(member for member in self.members if member.node == node)

    def dead(self) -> list[NodeProcess]:
        """Return the members that have ended."""
        return [member for member in self.members if member.process.poll() is not None]

    def stop(self, meanwhile: Callable[[], None] = lambda: None) -> None:
        """
        End all members by SIGTERM, and those that stick by SIGKILL.

        ``meanwhile`` is called while they end: what they say at last fits on no line that nobody
        reads.
        """
        nodes = {m.process: m.node for m in self.members if m.process.poll() is None}
        for process in nodes:
            process.send_signal(signal.SIGTERM)
            process.send_signal(signal.SIGCONT)
        killed = []
        for process in stuck(nodes, _TERM_WITHIN_S, _BUSY_WITHIN_S, meanwhile):
            label = nodes[process].process or nodes[process].label
            notify(f'{label} did not end after SIGTERM: bring-up kills it')
            process.kill()
            killed.append(process)
        for _ in stuck(killed, _TERM_WITHIN_S, _BUSY_WITHIN_S, meanwhile):
            pass
        clear_leftovers()


def notify(text: str) -> None:
    """Print a line above the progress bar."""
    tqdm.write(f'bringup.py: {printable_lines(text)}', file=sys.stderr)
