"""Memory of a process that makes the same large arrays anew in every frame."""

from __future__ import annotations

import ctypes
import sys

# Parameters of mallopt(3), as malloc.h numbers them.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
_KEPT_BYTES = 2**30


def keep_freed_memory() -> None:
    """
    Have the C library keep what is freed for what is allocated next, up to 1 GiB.

    It would return large arrays to the kernel, which then clears every page of the next ones:
    for a frame of 2048 x 2048 cells as long as the detector works on it.  Elsewhere than with
    the GNU C library nothing changes.
    """
    if sys.platform != 'linux':
        return
    mallopt = getattr(ctypes.CDLL(None), 'mallopt', None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _KEPT_BYTES)
        mallopt(_TRIM_THRESHOLD, _KEPT_BYTES)
