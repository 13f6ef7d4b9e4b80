"""What processes that were killed leave of Fast DDS in shared memory, and its removal."""

from __future__ import annotations

import contextlib
import fcntl
from pathlib import Path
import re
import time

_FOLDER = Path('/dev/shm')
# A segment and the lock that its process holds as long as it lives.
_LOCK = re.compile(r'fastrtps_[0-9a-f]{16}_el')
# A process that is starting has made the file, and may not hold the lock yet.
_STARTING_S = 10.0


def clear_leftovers(folder: Path = _FOLDER) -> int:
    """
    Remove the segments whose process is gone; each is as large as eight frames.

    Returns
    -------
    int
        How many there were.

    """
    cleared = 0
    for lock in folder.glob('fastrtps_*_el'):
        with contextlib.suppress(OSError):  # it lives, or belongs to somebody else
            if _LOCK.fullmatch(lock.name) and time.time() - lock.stat().st_mtime > _STARTING_S:
                with lock.open('rb') as claim:
                    fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    lock.with_name(lock.name.removesuffix('_el')).unlink(missing_ok=True)
                    lock.unlink()
                    cleared += 1
    return cleared
