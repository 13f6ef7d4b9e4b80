# SPDX-License-Identifier: Apache-2.0
"""The processes of a graph: bring-up starts, watches and ends them."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterable
from collections.abc import Iterator
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
import signal
import subprocess
import sys
import time
from types import MappingProxyType
from typing import BinaryIO
from typing import Protocol

from lowsnr_bringup.plan.graph import Node
from lowsnr_bringup.run.forked_nodes import NodeServer
from lowsnr_bringup.run.forked_nodes import ServerGone
from lowsnr_bringup.run.lines import Lines
from lowsnr_bringup.run.middleware import clear_leftovers
from lowsnr_bringup.run.threads import Patience
from lowsnr_common.core.line import Line
from lowsnr_common.core.process_setup import INTERRUPTED
from lowsnr_common.core.process_setup import LIFELINE
from lowsnr_common.core.process_setup import SHUT_DOWN
from lowsnr_common.core.process_setup import TERMINATED
from lowsnr_common.settings.text import printable_lines
from tqdm import tqdm

# After SIGTERM: the time for a process that does nothing, and for one that computes [s].
_TERM_WITHIN_S, _BUSY_WITHIN_S, _POLL_S = 2.0, 15.0, 0.01
_LAST_LINES = 8
# Nodes log to the results; ROS would write the same to ~/.ros/log, and needs a home for that.
NO_OTHER_LOGS = '--disable-external-lib-logs'
_ENDED_BY = {INTERRUPTED: 'SIGINT', TERMINATED: 'SIGTERM'}
NONE: Mapping[str, object] = MappingProxyType({})


class Process(Protocol):
    """A process of a node, spawned or forked."""

    @property
    def pid(self) -> int:
        """Process id."""

    @property
    def returncode(self) -> int | None:
        """Exit status, or the negative signal that killed it; None before :meth:`poll` saw it."""

    def poll(self) -> int | None:
        """Return the exit status, None while it runs."""

    def wait(self, timeout: float) -> int:
        """Wait for the end; :class:`subprocess.TimeoutExpired` after so many seconds."""

    def send_signal(self, number: int, /) -> None:
        """Send a signal, unless the process has ended."""

    def kill(self) -> None:
        """Send SIGKILL, unless the process has ended."""


@dataclass(eq=False)
class NodeProcess:
    """
    A node's process, its log file, and the line to it.

    ``hung`` is why bring-up killed it, if it did.
    """

    node: Node
    process: Process
    log: Path
    line: Line
    hung: str = ''

    def kill(self, hung: str) -> None:
        """Kill a process that hangs; it may be stopped, so that no other signal reaches it."""
        self.hung = hung
        self.process.kill()

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
        """
        Start one node; its output is appended to ``<label>.log``.

        Parameters
        ----------
        node
            The node.  If it had a process before, that is no longer a member.
        parameter_file
            File with its parameters.
        overrides
            Values of parameters that take precedence over those of the file.

        Raises
        ------
        OSError
            If the log cannot be opened, or the machine has no room for another process.

        """
        arguments = [*node.arguments, '--ros-args', '--params-file', str(parameter_file),
                     '--enclave', node.path, NO_OTHER_LOGS]
        for name, value in overrides.items():
            arguments += ['-p', f'{name}:={value}']
        if node.namespace:
            arguments += ['-r', f'__ns:={node.namespace}']
        for remap in node.remaps:
            arguments += ['-r', remap]
        path = self._logs / f'{node.label}.log'
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open('ab') as log:
            line, theirs = self.lines.add()
            with theirs:
                process = self._run(node.module, arguments, log, theirs.fileno())
        member = NodeProcess(node, process, path, line)
        self.members = [other for other in self.members if other.node != node] + [member]
        return member

    def _run(self, module: str, arguments: list[str], log: BinaryIO, lifeline: int) -> Process:
        """Start a process in a session of its own, so that Ctrl-C reaches the starter only."""
        if self._server is not None:
            try:
                return self._server.fork(
                    module, arguments, self._environment, log.fileno(), lifeline, *self._claim)
            except ServerGone:
                self._server = None
                notify('the process that forks nodes is gone; nodes start their own Python')
        return subprocess.Popen(
            [sys.executable, '-m', module, *arguments], stdin=subprocess.DEVNULL, stdout=log,
            stderr=subprocess.STDOUT, env={**self._environment, LIFELINE: str(lifeline)},
            pass_fds=(lifeline, *self._claim), start_new_session=True)

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
        running = [m for m in self.members if m.process.poll() is None]
        for member in running:
            member.process.send_signal(signal.SIGTERM)
            member.process.send_signal(signal.SIGCONT)
        killed = []
        for member in _stuck(running, meanwhile):
            notify(f'{member.node.label} did not end after SIGTERM: bring-up kills it')
            member.process.kill()
            killed.append(member)
        for _ in _stuck(killed, meanwhile):
            pass
        clear_leftovers()


def _stuck(
    members: Iterable[NodeProcess], meanwhile: Callable[[], None],
) -> Iterator[NodeProcess]:
    """Wait until all have ended; yield each that does not, and is waited for no longer."""
    left = {m: Patience(m.process.pid, _TERM_WITHIN_S, _BUSY_WITHIN_S) for m in members}
    while left:
        meanwhile()
        for member, patience in list(left.items()):
            if member.process.poll() is not None:
                del left[member]
            elif patience.is_over():
                del left[member]
                yield member
        time.sleep(_POLL_S * bool(left))


def notify(text: str) -> None:
    """Print a line above the progress bar."""
    tqdm.write(f'bringup.py: {printable_lines(text)}', file=sys.stderr)
