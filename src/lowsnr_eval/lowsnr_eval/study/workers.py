# SPDX-License-Identifier: Apache-2.0
"""
Workers that run the tasks of a study: local processes, or those of a dask scheduler.

Both are executors of :mod:`concurrent.futures`; a local run opens no port.
"""

from __future__ import annotations

from abc import ABC
from abc import abstractmethod
from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Mapping
from concurrent.futures import as_completed
from concurrent.futures import Executor
import contextlib
from pathlib import Path
from typing import Any
from typing import ClassVar
from typing import NamedTuple

from lowsnr_eval.study.local_pool import LocalPool
from lowsnr_eval.study.local_pool import ProcessDiedError


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


class LocalWorkers(Workers):
    """Processes of this machine; ``jobs`` is their number."""

    died = ProcessDiedError
    restarts = 3

    def __init__(self, log: Callable[[str], None], jobs: int) -> None:
        super().__init__(log)
        self._jobs = jobs

    def start(self) -> LocalPool:
        """Return a pool of processes."""
        return LocalPool(self._jobs)

    def death(self, error: Exception) -> str:
        """Return the message of the error, which names the process."""
        return str(error)


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
