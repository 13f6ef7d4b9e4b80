"""The workers of an existing dask scheduler; only a run with ``--scheduler`` imports this."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from concurrent.futures import Executor
import contextlib
import logging
from typing import Any

import distributed
from lowsnr_eval.study.study_identity import code_digest
from lowsnr_eval.study.workers import Workers

_TIMEOUT_S = 10.0
# dask's client has no types.
_CLIENT: Any = distributed.Client


class SchedulerWorkers(Workers):
    """The workers of a scheduler, which itself runs the task of a dead worker again."""

    died = distributed.KilledWorker
    restarts = 0

    def __init__(self, log: Callable[[str], None], client: Any) -> None:
        super().__init__(log)
        self._client = client

    def start(self) -> Executor:
        """Return an executor on the workers of the scheduler."""
        executor: Executor = self._client.get_executor(pure=False)
        return executor

    def death(self, error: Exception) -> str:
        """Return dask's first line, which names the task and the last worker that died of it."""
        return str(error).splitlines()[0]


@contextlib.contextmanager
def connected(address: str) -> Iterator[Any]:
    """
    Yield a client of a scheduler whose workers have the same code.

    Raises
    ------
    ValueError
        One line, if no scheduler answers at the address or a worker has other code.

    """
    logging.getLogger('distributed').setLevel(logging.CRITICAL)
    try:
        client = _CLIENT(address, timeout=_TIMEOUT_S)
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else 'no answer'
        raise ValueError(f'scheduler {address}: cannot be reached: {reason}') from None
    with client:
        try:
            client.wait_for_workers(1, timeout=_TIMEOUT_S)
        except TimeoutError:
            raise ValueError(f'scheduler {address}: has no worker') from None
        _check_code(client, address)
        yield client


def _check_code(client: Any, address: str) -> None:
    """Refuse workers that would give other numbers, or none."""
    try:
        # A task passes through the scheduler, which must be able to import the packages too.
        client.submit(code_digest, pure=False).result(timeout=_TIMEOUT_S)
        found = set(client.run(code_digest).values())
    except (RuntimeError, ImportError, TimeoutError):
        found = set()
    if found != {code_digest()}:
        raise ValueError(
            f'scheduler {address}: start it and its workers with this code on PYTHONPATH')
