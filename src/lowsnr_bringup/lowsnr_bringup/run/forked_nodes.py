# SPDX-License-Identifier: Apache-2.0
"""Bring-up's side of the server that forks nodes: the server, and the forked processes."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import ctypes
import json
import os
import signal
import socket
import subprocess
import sys
import time

_SERVER = 'lowsnr_bringup.run.node_server'
_ANSWERS_WITHIN_S = 60.0
_POLL_S = 0.01
# Of prctl(2): orphans among the descendants become children of this process.
_PR_SET_CHILD_SUBREAPER = 36


class ServerGone(Exception):
    """There is no server that forks nodes, or it does not answer."""


class ForkedProcess:
    """A process that the server forked; it is used as a :class:`subprocess.Popen` is."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """Return the exit status, the negative signal that killed it, or None while it runs."""
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: float) -> int:
        """Wait for the end; :class:`subprocess.TimeoutExpired` after so many seconds."""
        until = time.monotonic() + timeout
        while (status := self.poll()) is None:
            if time.monotonic() >= until:
                raise subprocess.TimeoutExpired(str(self.pid), timeout)
            time.sleep(_POLL_S)
        return status

    def send_signal(self, number: int) -> None:
        """Send a signal, unless the process has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """Send SIGKILL, unless the process has ended."""
        self.send_signal(signal.SIGKILL)


class NodeServer:
    """
    The server as bring-up sees it; use it as a context manager.

    It starts at once to import what nodes share, while bring-up plans the run.  ``process`` is
    None where there is no server.

    Parameters
    ----------
    *modules
        What it imports later, for nodes that start again: name, and arguments of ``preload``.

    """

    def __init__(self, *modules: Sequence[str]) -> None:
        self._modules = modules
        self._channel: socket.socket | None = None
        self._ready = False
        self.process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> NodeServer:
        if _adopt_orphans(True):
            self._start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _start(self) -> None:
        self._channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._channel.settimeout(_ANSWERS_WITHIN_S)
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, '-m', _SERVER, str(theirs.fileno()),
                 json.dumps(self._modules)],
                # A thread of OpenBLAS would not survive the fork.
                env={**os.environ, 'OPENBLAS_NUM_THREADS': '1'}, pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                start_new_session=True)

    def wait(self) -> None:
        """Wait until the server has imported everything, if there is a server."""
        if self._channel is not None and not self._ready:
            with suppress(OSError):  # it may not say so in time
                self._ready = bool(self._channel.recv(64))
            if not self._ready:
                self.close()

    def fork(
        self, module: str, arguments: list[str], environment: dict[str, str], log: int,
        lifelines: Sequence[int], *held: int,
    ) -> ForkedProcess:
        """
        Start ``python -m MODULE ARGUMENTS``.

        Parameters
        ----------
        module, arguments, environment
            Those of the new process.
        log, lifelines, *held
            File descriptors: of its output, of its ends of the lines to bring-up, and of what
            the process holds until its end.

        Raises
        ------
        ServerGone
            If there is no server, or it did not answer; another call raises the same.
        OSError
            If the machine has no room for another process.

        """
        self.wait()
        if self._channel is None:
            raise ServerGone
        request = json.dumps([module, arguments, environment, len(lifelines)]).encode()
        try:
            socket.send_fds(self._channel, [request], [log, *lifelines, *held])
            answer = self._channel.recv(64)
        except OSError:  # its end is closed, it did not answer in time, or a huge environment
            answer = b''
        if not answer:
            self.close()
            raise ServerGone
        if (number := int(answer)) < 0:
            raise OSError(-number, os.strerror(-number), module)
        return ForkedProcess(number)

    def close(self) -> None:
        """End the server; the nodes go on."""
        if self._channel is not None:
            self._channel.close()
            self._channel = None
        if self.process is not None:
            # It may be importing, or stopped; it holds nothing that needs an orderly end.
            self.process.kill()
            self.process.wait()
            self.process = None
            _adopt_orphans(False)


def _adopt_orphans(adopt: bool) -> bool:
    """Have orphaned descendants become children of this process; False elsewhere than on Linux."""
    prctl = getattr(ctypes.CDLL(None), 'prctl', None)
    return prctl is not None and prctl(_PR_SET_CHILD_SUBREAPER, int(adopt), 0, 0, 0) == 0
