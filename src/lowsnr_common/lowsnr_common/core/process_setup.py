"""The process of a node: how it ends with its starter, its memory, and its exit statuses."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading

LIFELINE = 'LOWSNR_LIFELINE'
# Exit statuses: of a node that cannot become active, of one with a setting out of its bounds, of
# one that was shut down through its lifecycle, and after SIGINT and SIGTERM.
FAILED, USAGE_ERROR, SHUT_DOWN = 1, 2, 3
INTERRUPTED, TERMINATED = 128 + signal.SIGINT, 128 + signal.SIGTERM
# Parameters of mallopt(3), as malloc.h numbers them.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
_KEPT_BYTES = 2**30


def end_with_starter() -> None:
    """
    Have this process end by SIGTERM when the process that started it is gone.

    The starter passes the read end of a pipe and names its file descriptor in the environment
    variable ``LOWSNR_LIFELINE``.  The kernel closes the other end with the starter.  Without the
    variable nothing happens.
    """
    pipe = os.environ.pop(LIFELINE, None)
    if pipe is not None:
        threading.Thread(target=_wait_for_end, args=(int(pipe),), daemon=True).start()


def _wait_for_end(pipe: int) -> None:
    while os.read(pipe, 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def keep_freed_memory() -> None:
    """
    Have the C library keep up to 1 GiB of freed memory for later allocations.

    By default it returns large arrays to the kernel, which clears every page of the next ones:
    for a frame of 2048 x 2048 cells that takes as long as the detector.  Without the GNU C
    library nothing changes.
    """
    if sys.platform != 'linux':
        return
    mallopt = getattr(ctypes.CDLL(None), 'mallopt', None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _KEPT_BYTES)
        mallopt(_TRIM_THRESHOLD, _KEPT_BYTES)
