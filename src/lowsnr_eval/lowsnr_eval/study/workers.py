"""
Workers that run the tasks of a study: local processes, or those of a dask scheduler.

Both are executors of :mod:`concurrent.futures`.  Local processes receive their tasks through
pipes, so that a local run opens no port.
"""

from __future__ import annotations

from abc import ABC
from abc import abstractmethod
from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Mapping
from concurrent.futures import as_completed
from concurrent.futures import Executor
from concurrent.futures import Future
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
import contextlib
from multiprocessing import active_children
from multiprocessing import get_context
from multiprocessing import parent_process
from multiprocessing.process import BaseProcess
import os
from pathlib import Path
import signal
import threading
from typing import Any
from typing import ClassVar
from typing import NamedTuple

# Every worker has one core.
_THREADS = ('OMP_NUM_THREADS', 'MKL_NUM_THREADS', 'OPENBLAS_NUM_THREADS')


class WorkerDiedError(RuntimeError):
    """Workers died too often; the message names the last one and how it ended."""


class TlsFiles(NamedTuple):
    """PEM files of a connection by TLS: its authority, and certificate and key of this side."""

    ca: Path
    cert: Path
    key: Path


class Workers(ABC):
    """
    Runs batches of tasks on an executor, and on a new one after a worker died.

    ``died`` is the error of a task whose worker died; a batch continues on a new executor
    ``restarts`` times.  ``log`` receives a line for each worker that died.
    """

    died: ClassVar[type[Exception]]
    restarts: ClassVar[int]

    def __init__(self, log: Callable[[str], None]) -> None:
        self._log = log
        self._executor: Executor | None = None

    @abstractmethod
    def start(self) -> Executor:
        """Return a new executor; its ``shutdown(wait=False)`` gives up what still runs."""

    @abstractmethod
    def death(self, error: Exception) -> str:
        """Name the worker that died, and how, once the executor has been shut down."""

    def run(
        self, function: Callable[..., Any], tasks: Mapping[str, tuple[Any, ...]],
        keep: Callable[[str, Any], None],
    ) -> None:
        """
        Run a function on each tuple of arguments; the tasks start in their order.

        Parameters
        ----------
        function
            A function of a module.
        tasks
            Arguments by the name of the task.
        keep
            Receives the name and the result of each task as soon as it is finished.

        Raises
        ------
        WorkerDiedError
            If workers died too often.
        Exception
            The error of the first task that failed; the other tasks are given up.

        """
        left, deaths = dict(tasks), 0
        while left:
            self._executor = self._executor or self.start()
            try:
                futures = {self._executor.submit(function, *left[name]): name for name in left}
                for future in as_completed(list(futures)):
                    name = futures.pop(future)
                    keep(name, future.result())
                    del left[name]
            except self.died as error:
                deaths += 1
                self.close()
                if deaths > self.restarts:
                    raise WorkerDiedError(self.death(error)) from None
                self._log(f'{self.death(error)}; its tasks start again')
            finally:
                if left:
                    self.close()

    def close(self) -> None:
        """End the workers, and give up what they still run."""
        executor, self._executor = self._executor, None
        if executor is not None:
            executor.shutdown(wait=False)


class LocalPool(ProcessPoolExecutor):
    """
    Up to ``jobs`` processes of this machine, started as tasks are submitted.

    Ctrl-C does not reach them, so that the main process alone decides what is kept.  They
    end when the main process does, also when it is killed.
    """

    def __init__(self, jobs: int) -> None:
        super().__init__(jobs, get_context('spawn'), _end_with_parent)
        self._others = set(active_children())
        self.workers: set[BaseProcess] = set()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Schedule a call; start a process if there are too few."""
        with _worker_environment():
            future = super().submit(fn, *args, **kwargs)
        self.workers |= set(active_children()) - self._others
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes: after their calls, or at once without ``wait``."""
        if not wait:
            for process in self.workers:
                process.terminate()
        super().shutdown(wait=True, cancel_futures=cancel_futures or not wait)


class LocalWorkers(Workers):
    """Processes of this machine; ``jobs`` is their number."""

    died = BrokenProcessPool
    restarts = 3

    def __init__(self, log: Callable[[str], None], jobs: int) -> None:
        super().__init__(log)
        self._jobs = jobs

    def start(self) -> LocalPool:
        """Return a pool of processes."""
        self._pool = LocalPool(self._jobs)
        return self._pool

    def death(self, error: Exception) -> str:
        """Name the processes that died by themselves: a broken pool terminates all others."""
        workers = self._pool.workers
        dead = [item for item in workers if item.exitcode not in (0, -signal.SIGTERM)] or workers
        return ', '.join(f'worker process {item.pid} {_ending(item.exitcode)}' for item in dead)


@contextlib.contextmanager
def workers(
    jobs: int, scheduler: str | None, log: Callable[[str], None], tls: TlsFiles | None = None,
) -> Iterator[Workers]:
    """
    Yield workers: local processes, or those of an existing dask scheduler.

    Parameters
    ----------
    jobs
        Number of local processes.
    scheduler
        Address of a scheduler, ``HOST:PORT``; its workers must have the same packages.
    log
        Receives a line for each worker that died.
    tls
        What the connection to a scheduler on another machine needs.

    Raises
    ------
    ValueError
        One line, if no scheduler answers at the address or a worker has other code.

    """
    with contextlib.ExitStack() as stack:
        found: Workers
        if scheduler is None:
            found = LocalWorkers(log, jobs)
        else:
            # Imported here, because a local run does not need dask.
            from lowsnr_eval.study.scheduler import connected
            from lowsnr_eval.study.scheduler import SchedulerWorkers
            found = SchedulerWorkers(log, stack.enter_context(connected(scheduler, tls)))
        stack.callback(found.close)
        yield found


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
