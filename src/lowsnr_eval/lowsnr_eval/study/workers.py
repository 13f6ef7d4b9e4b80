"""Tasks on worker processes, with dask.distributed: a cluster of our own or an existing one."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Mapping
import contextlib
import logging
import signal
from typing import Any

import dask
from distributed import as_completed
from distributed import Client
from distributed import LocalCluster
from lowsnr_eval.study.study_folder import code_digest

_PATIENCE_S = 10.0
_SETTINGS = {
    # A task whose worker dies is run again; only a task that keeps killing workers fails.
    'distributed.scheduler.allowed-failures': 5,
    'distributed.worker.memory.target': False,
    'distributed.worker.memory.spill': False,
    # One core each. dask also has malloc give memory back at once, which takes half the time
    # of programs that make and drop many arrays.
    'distributed.nanny.pre-spawn-environ': dict.fromkeys(
        ('OMP_NUM_THREADS', 'MKL_NUM_THREADS', 'OPENBLAS_NUM_THREADS'), 1) | {
            # Nothing but results is said on the terminal.
            'DASK_DISTRIBUTED__LOGGING__DISTRIBUTED': 'critical'},
    'distributed.logging.distributed': 'critical',
}


@contextlib.contextmanager
def workers(jobs: int, scheduler: str | None = None) -> Iterator[Client]:
    """
    Connect to workers: processes of our own, or those of an existing scheduler.

    Parameters
    ----------
    jobs
        Number of processes of our own.
    scheduler
        Address of a scheduler, ``HOST:PORT``; its workers must have the same packages.

    Raises
    ------
    ValueError
        One line, if there is no scheduler at the address, or no worker with this code.

    """
    with dask.config.set(_SETTINGS), contextlib.ExitStack() as stack:
        logging.getLogger('distributed').setLevel(logging.CRITICAL)
        if scheduler is None:
            with _without_interrupts():
                cluster = stack.enter_context(LocalCluster(
                    n_workers=jobs, threads_per_worker=1, host='127.0.0.1', memory_limit=0,
                    dashboard_address=None))
            yield stack.enter_context(Client(cluster))
            return
        client = stack.enter_context(_connected(scheduler))
        _check_code(client, scheduler)
        yield client


def run_tasks(
    client: Client, function: Callable[..., Any], tasks: Mapping[str, tuple[Any, ...]],
) -> Iterator[tuple[str, Any]]:
    """
    Run a function on each tuple of arguments; yield name and result as they come.

    Tasks are started in their order.

    Raises
    ------
    Exception
        Whatever the function raised; what is still to do is given up.

    """
    futures = {
        client.submit(function, *arguments, pure=False, priority=-number): name
        for number, (name, arguments) in enumerate(tasks.items())}
    try:
        for future in as_completed(futures):
            yield futures[future], future.result()
            future.release()
    finally:
        client.cancel(list(futures))


def _connected(scheduler: str) -> Client:
    try:
        client = Client(scheduler, timeout=_PATIENCE_S)
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else 'no answer'
        raise ValueError(f'scheduler {scheduler}: not reached: {reason}') from None
    try:
        client.wait_for_workers(1, timeout=_PATIENCE_S)
    except TimeoutError:
        client.close()
        raise ValueError(f'scheduler {scheduler}: has no worker') from None
    return client


def _check_code(client: Client, scheduler: str) -> None:
    """Refuse workers that would give other numbers, or none."""
    try:
        # A task goes through the scheduler, which has to know our packages too.
        client.submit(code_digest, pure=False).result(timeout=_PATIENCE_S)
        found = set(client.run(code_digest).values())
    except (RuntimeError, ImportError, TimeoutError):
        found = set()
    if found != {code_digest()}:
        raise ValueError(
            f'scheduler {scheduler}: it and its workers must be started with this code on '
            'PYTHONPATH')


@contextlib.contextmanager
def _without_interrupts() -> Iterator[None]:
    """
    Start processes that Ctrl-C does not reach.

    It goes to the whole process group; we alone end the workers, once what they
    finished is saved.
    """
    old = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, old)
