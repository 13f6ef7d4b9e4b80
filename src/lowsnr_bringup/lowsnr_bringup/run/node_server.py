"""
A process that imports what nodes need, once, and forks each node of a run from itself.

A forked node starts without the second that Python takes to import rclpy, NumPy and Numba.  It
is otherwise the process that ``python -m MODULE`` would be: it has a session, a process id, an
environment and a log file of its own, it is a child of bring-up, and its title is that command.

The server forks twice and the process between ends at once.  Bring-up has told the kernel that
it adopts such orphans, so it is the parent of every node: it learns how each one ends, and a
node outlives the server.
"""

from __future__ import annotations

import ctypes
import errno
import gc
import importlib
import json
import os
import runpy
import signal
import socket
import subprocess
import sys
import time
import warnings

from lowsnr_common.core.process_setup import LIFELINE
from setproctitle import getproctitle
from setproctitle import setproctitle

# What every run needs; other nodes import the little more that they need after the fork.
_PRELOADED = (
    'lowsnr_sensor.sensor_node', 'lowsnr_detect.node.detector_node',
    'lowsnr_track.tracker_node', 'lowsnr_eval.evaluator_node')
_LARGEST_REQUEST = 2**20
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

    It starts to import at once, while bring-up plans the run.  ``process`` is None where there
    is no server.
    """

    def __init__(self) -> None:
        self._channel: socket.socket | None = None
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
                [sys.executable, '-m', __name__, str(theirs.fileno())],
                # A thread of OpenBLAS would not survive the fork.
                env={**os.environ, 'OPENBLAS_NUM_THREADS': '1'}, pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                start_new_session=True)

    def fork(
        self, module: str, arguments: list[str], environment: dict[str, str], log: int,
        lifeline: int,
    ) -> ForkedProcess:
        """
        Start ``python -m MODULE ARGUMENTS``.

        Parameters
        ----------
        module, arguments, environment
            Those of the new process.
        log, lifeline
            File descriptors: of its output, and of the pipe that closes with bring-up.

        Raises
        ------
        ServerGone
            If there is no server, or it did not answer; another call raises the same.
        OSError
            If the machine has no room for another process.

        """
        if self._channel is None:
            raise ServerGone
        request = json.dumps([module, arguments, environment]).encode()
        try:
            socket.send_fds(self._channel, [request], [log, lifeline])
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


def _serve(channel: socket.socket) -> str:
    """Fork nodes until bring-up is gone; in a node, return the module that it is to run."""
    while True:
        request, files, *_ = socket.recv_fds(channel, _LARGEST_REQUEST, 2)
        if not request:
            return ''
        pid = _fork_twice()
        if pid == 0:
            channel.close()
            return _set_up(*json.loads(request), *files)
        for each in files:
            os.close(each)
        channel.send(str(pid).encode())


def _set_up(
    module: str, arguments: list[str], environment: dict[str, str], log: int, lifeline: int,
) -> str:
    """Make this process the one that ``python -m MODULE`` starts; return the module."""
    os.setsid()
    for stream in (1, 2):
        os.dup2(log, stream)
    os.close(log)
    os.environ.clear()
    os.environ.update({**environment, LIFELINE: str(lifeline)})
    sys.argv[1:] = arguments
    setproctitle(' '.join([sys.executable, '-m', module, *arguments]))
    sys.modules.pop(module, None)  # it runs again, as __main__
    return module


def _fork_twice() -> int:
    """
    Fork a process whose parent ends at once.

    Returns
    -------
    int
        0 in the new process; in this one its process id, or a negative error number.

    """
    reading, writing = os.pipe()
    try:
        between = os.fork()
    except OSError as error:
        os.close(reading)
        os.close(writing)
        return -(error.errno or errno.EAGAIN)
    if not between:
        try:
            if not (pid := os.fork()):
                os.close(reading)
                os.close(writing)
                return 0
        except OSError as error:
            pid = -(error.errno or errno.EAGAIN)
        os.write(writing, str(pid).encode())
        os._exit(0)
    os.close(writing)
    answer = int(os.read(reading, 32))
    os.close(reading)
    os.waitpid(between, 0)  # from now on the new process is a child of bring-up
    return answer


def main() -> None:
    """Import, then fork nodes as bring-up asks for them."""
    getproctitle()  # only while the environment is that of the start can it find its title
    channel = socket.socket(fileno=int(sys.argv[1]))
    for name in _PRELOADED:
        importlib.import_module(name)
    gc.freeze()  # so that the memory of what was imported stays shared
    # The tracing library that rclpy links has two threads, which a forked node does without.
    warnings.filterwarnings('ignore', r'This process .* is multi-threaded', DeprecationWarning)
    if module := _serve(channel):
        runpy.run_module(module, run_name='__main__', alter_sys=True)


if __name__ == '__main__':
    main()
