# SPDX-License-Identifier: Apache-2.0
"""Removal of the Fast DDS segments in shared memory whose process is gone."""

from __future__ import annotations

import contextlib
import fcntl
from pathlib import Path
import re
import time

_FOLDER = Path('/dev/shm')
# The lock file of a segment; the process that made the segment holds the lock while it lives.
_LOCK = re.compile(r'fastrtps_[0-9a-f]{16}_el')
# A process makes the lock file first and locks it a moment later.
_STARTING_S = 10.0


def clear_leftovers(folder: Path = _FOLDER) -> int:
    """
    Remove the segments of processes that have ended; return how many there were.

    The nodes of a run use no shared memory unless the user's own profile says so, and then a
    killed node leaves segments behind.  A segment whose lock is held, or whose file belongs to
    another user, stays.
    """
    cleared = 0
    for lock in folder.glob('fastrtps_*_el'):
        with contextlib.suppress(OSError):  # the lock is held, or the file is another user's
            if _LOCK.fullmatch(lock.name) and not _may_be_starting(lock):
                with lock.open('rb') as file:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    lock.with_name(lock.name.removesuffix('_el')).unlink(missing_ok=True)
                    lock.unlink()
                    cleared += 1
    return cleared


def _may_be_starting(lock: Path) -> bool:
    """Return whether a file is a few seconds old; one of the future predates a set-back clock."""
    return 0.0 <= time.time() - lock.stat().st_mtime <= _STARTING_S
