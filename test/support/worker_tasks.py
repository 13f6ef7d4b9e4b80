# SPDX-License-Identifier: Apache-2.0
"""Tasks that the worker processes of a study run in tests."""

from multiprocessing.connection import Connection
import os
from pathlib import Path
import signal
import sys


def die_once(mark: Path, number: int) -> int:
    """Return a number; the first process that gets here writes its id to a file and dies."""
    try:
        with mark.open('x', encoding='utf-8') as file:
            file.write(str(os.getpid()))
    except FileExistsError:
        return number
    signal.raise_signal(signal.SIGKILL)
    return number


def die_while_sending(mark: Path, number: int) -> int:
    """Return a number; the first process that gets here dies in the middle of its result."""
    def send_half(pipe: Connection, data: bytes) -> None:
        os.write(pipe.fileno(), data[:len(data) // 2])
        signal.raise_signal(signal.SIGKILL)

    try:
        with mark.open('x', encoding='utf-8') as file:
            file.write(str(os.getpid()))
    except FileExistsError:
        return number
    Connection._send = send_half
    return number


def surroundings() -> tuple[bool, bool, str | None]:
    """Return whether dask is imported, whether Ctrl-C is blocked, and the number of threads."""
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    return 'distributed' in sys.modules, signal.SIGINT in blocked, os.environ.get(
        'OMP_NUM_THREADS')


def fail(error: Exception) -> None:
    """Raise an error."""
    raise error
