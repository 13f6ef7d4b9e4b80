# SPDX-License-Identifier: Apache-2.0
"""A pool of processes of this machine, which outlives the death of any of them."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from concurrent.futures import Future
from concurrent.futures import ThreadPoolExecutor
import contextlib
from multiprocessing import get_context
from multiprocessing import parent_process
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
import os
from queue import SimpleQueue
import signal
import threading
from typing import Any
from typing import TypeAlias

_Pipe: TypeAlias = 'Connection[Any, Any]'
# Every worker has one core.
_THREADS = ('OMP_NUM_THREADS', 'MKL_NUM_THREADS', 'OPENBLAS_NUM_THREADS')


class ProcessDiedError(RuntimeError):
    """A process of a pool ended by itself; the message names it, and how it ended."""


class LocalPool(ThreadPoolExecutor):
    """
    Up to ``jobs`` processes of this machine, started as calls are submitted.

    Each process has a pipe of its own, which ends with it: a process that is killed in the
    middle of its result blocks neither this process nor the others.  Ctrl-C does not reach
    them, so that the main process alone decides what is kept.  They end when the main process
    does, also when it is killed.
    """

    def __init__(self, jobs: int) -> None:
        super().__init__(jobs)
        self._jobs = jobs
        self._processes: list[BaseProcess] = []
        self._free: SimpleQueue[tuple[BaseProcess, _Pipe]] = SimpleQueue()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Schedule a call; start a process if there are too few."""
        if len(self._processes) < self._jobs:
            self._start_process()
        return super().submit(self._call, fn, args, kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes: after their calls, or at once without ``wait``."""
        if wait:
            super().shutdown(cancel_futures=cancel_futures)
        for process in self._processes:
            process.terminate()
        super().shutdown(cancel_futures=True)
        for process in self._processes:
            process.join()

    def _start_process(self) -> None:
        context = get_context('spawn')
        here, there = context.Pipe()
        resource_tracker.ensure_running()  # the first process would start it, and unblock Ctrl-C
        process = context.Process(target=_answer_calls, args=(there,), daemon=True)
        with _worker_environment():
            process.start()
        there.close()
        self._processes.append(process)
        self._free.put((process, here))

    def _call(
        self, fn: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any],
    ) -> Any:
        """Return the result of a call in a free process, or raise its error."""
        process, pipe = self._free.get()
        try:
            pipe.send((fn, args, kwargs))
            result, error = pipe.recv()
        except (EOFError, OSError):
            process.join()
            raise ProcessDiedError(
                f'worker process {process.pid} {_ending(process.exitcode)}') from None
        finally:
            self._free.put((process, pipe))
        if error is not None:
            raise error
        return result


@contextlib.contextmanager
def _worker_environment() -> Iterator[None]:
    """Within this context a new process gets one thread, and never receives Ctrl-C."""
    added = [name for name in _THREADS if name not in os.environ]
    # A process inherits the blocked signals of the thread that starts it.
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    os.environ.update(dict.fromkeys(added, '1'))
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


def _answer_calls(pipe: _Pipe) -> None:
    """Run the calls that arrive through a pipe, and send back the result or the error of each."""
    _end_with_parent()
    thread = ThreadPoolExecutor(1)  # it turns whatever a call raises into a value
    while True:
        try:
            fn, args, kwargs = pipe.recv()
        except EOFError:
            return
        call = thread.submit(fn, *args, **kwargs)
        error = call.exception()
        pipe.send((None, error) if error else (call.result(), None))


def _end_with_parent() -> None:
    """End this process when the one that started it ends."""
    def wait() -> None:
        parent = parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def _ending(code: int | None) -> str:
    if code is not None and code < 0:
        return f'was killed by {signal.Signals(-code).name}'
    return f'ended with exit code {code}'
