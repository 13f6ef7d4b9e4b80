# SPDX-License-Identifier: Apache-2.0
"""
A process that imports what nodes need, once, and forks each node of a run from itself.

A forked node starts without the second that Python takes to import rclpy, NumPy and Numba, and
without the time for what the functions ``preload`` of modules load, such as compiled loops.  It
is otherwise the process that ``python -m MODULE`` would be: it has a session, a process id, an
environment and a log file of its own, it is a child of bring-up, and its title is that command.

The server forks twice and the process between ends at once.  Bring-up has told the kernel that
it adopts such orphans, so it is the parent of every node: it learns how each one ends, and a
node outlives the server.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import errno
import gc
import importlib
import json
import os
import runpy
import socket
import sys
from types import TracebackType
from typing import NoReturn
import warnings

from lowsnr_common.core.compiled import loading_only
from lowsnr_common.core.process_setup import keep_freed_memory
from lowsnr_common.core.process_setup import LIFELINE
from setproctitle import getproctitle
from setproctitle import setproctitle

# What nodes of every run share, Numba included, which the tracker loads.
_SHARED = (
    ('lowsnr_sensor.sensor_node',), ('lowsnr_detect.node.detector_node',),
    ('lowsnr_track.tracker_node',), ('lowsnr_common.ros.process.first_uses',))
# What one node needs: at the start of the graph each loads its own, at the same time as others.
# The server loads it all once so long [s] has passed without a request, for nodes that start
# again.
_OF_ONE_NODE: tuple[Sequence[str], ...] = (('lowsnr_eval.evaluator_node',),)
_QUIET_S = 2.0
_LARGEST_REQUEST = 2**20
_MOST_FILES = 128  # the log, the lines to bring-up, and the claim on the domain


def _load(name: str, *arguments: str) -> None:
    """
    Import a module, and call its function ``preload`` if it has one.

    Where that fails, nodes do it themselves, and say why it fails.  They also compile what is
    not on disk, several at a time, and say that they do.
    """
    with suppress(Exception), loading_only():
        module = importlib.import_module(name)
        if hasattr(module, 'preload'):
            module.preload(*arguments)


def _serve(channel: socket.socket, later: list[Sequence[str]]) -> str:
    """Fork nodes until bring-up is gone; in a node, return the module that it is to run."""
    channel.send(b'ready')
    wait_s = _QUIET_S
    while True:
        channel.settimeout(wait_s if later else None)
        try:
            request, files, *_ = socket.recv_fds(channel, _LARGEST_REQUEST, _MOST_FILES)
        except (TimeoutError, BlockingIOError):
            _load(*later.pop(0))
            wait_s = 0.0  # the graph has started
            continue
        wait_s = _QUIET_S
        if not request:
            return ''
        gc.freeze()  # so that the memory of what was imported stays shared
        pid = _fork_twice()
        if pid == 0:
            channel.close()
            return _set_up(*json.loads(request), *files)
        for each in files:
            os.close(each)
        channel.send(str(pid).encode())


def _set_up(
    module: str, arguments: list[str], environment: dict[str, str], lines: int, log: int,
    *held: int,
) -> str:
    """Make this process the one that ``python -m MODULE`` starts; return the module."""
    os.setsid()
    for stream in (1, 2):
        os.dup2(log, stream)
    os.close(log)
    os.environ.clear()
    os.environ.update({**environment, LIFELINE: ','.join(map(str, held[:lines]))})
    sys.argv[1:] = arguments
    gc.enable()
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


def _run(module: str) -> NoReturn:
    """
    Run a module as ``python -m`` does, and end the process.

    The exit handlers of C libraries are those of the server: the one of LTTng would cancel the
    threads whose stacks lie where those of the server's own threads were.
    """
    def end(status: int) -> NoReturn:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)

    def end_after_traceback(
        kind: type[BaseException], error: BaseException, trace: TracebackType | None,
    ) -> None:
        sys.__excepthook__(kind, error, trace)
        end(1)

    sys.excepthook = end_after_traceback
    try:
        runpy.run_module(module, run_name='__main__', alter_sys=True)
    except SystemExit as error:
        end(error.code if isinstance(error.code, int) else int(error.code is not None))
    end(0)


def main() -> None:
    """
    Import, then fork nodes as bring-up asks for them.

    Arguments: the channel, and further modules of one node each, a JSON list of lists of name and
    arguments of ``preload``.
    """
    getproctitle()  # only while the environment is that of the start can it find its title
    channel = socket.socket(fileno=int(sys.argv[1]))
    gc.disable()  # a sixth of the time would go into collections that find nothing
    keep_freed_memory()  # a forked node would keep heaps of the threads that an import starts
    for each in _SHARED:
        _load(*each)
    # The tracing library that rclpy links has two threads, which a forked node does without.
    warnings.filterwarnings('ignore', r'This process .* is multi-threaded', DeprecationWarning)
    if module := _serve(channel, [*_OF_ONE_NODE, *json.loads(sys.argv[2])]):
        _run(module)


if __name__ == '__main__':
    main()
