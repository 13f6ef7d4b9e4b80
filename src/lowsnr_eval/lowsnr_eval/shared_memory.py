"""What processes that were killed leave of Fast DDS in shared memory, and its removal."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import fcntl
import mmap
from pathlib import Path
import re
import struct
import time

_FOLDER = Path('/dev/shm')
# A segment or port, and the lock that its process holds as long as it lives.
_SEGMENT = re.compile(r'fastrtps_[0-9a-f]{16}_el')
_PORT = re.compile(r'fastrtps_port(\d+)_el')
# A process that is starting has made the file, and may not hold the lock yet.
_STARTING_S = 10.0
# In a port of Fast DDS 2.14: its version, its number, and a byte with whether it is in order.
_VERSION, _NUMBER_AT, _STATE_AT, _IN_ORDER = b'port_node_abi5', 276, 300, 1


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
            if _SEGMENT.fullmatch(lock.name) and not _may_be_starting(lock):
                with _claimed(lock) as segment:
                    segment.unlink(missing_ok=True)
                    lock.unlink()
                    cleared += 1
    return cleared


def close_ports(folder: Path = _FOLDER) -> int:
    """
    Mark the ports whose process is gone, so that nobody goes on sending to them.

    The next process gets the same ports, in new files.  The senders find out that the old ones
    are dead by looking at the time, and where the clock was set back do not look for as long as
    that: all that they send to the new process is lost.

    Returns
    -------
    int
        How many there were.

    """
    closed = 0
    for lock in folder.glob('fastrtps_port*_el'):
        with contextlib.suppress(OSError, ValueError):  # it lives, or is another's, or is empty
            if found := _PORT.fullmatch(lock.name):
                with _claimed(lock) as port:
                    closed += _close(port, int(found[1]))
    return closed


def _close(port: Path, number: int) -> bool:
    """Mark a port as out of order; False where it is not one that we know."""
    with port.open('r+b') as file, mmap.mmap(file.fileno(), 0) as memory:
        if memory.find(_VERSION) < 0 or struct.unpack_from('<I', memory, _NUMBER_AT) != (number,):
            return False
        memory[_STATE_AT] &= ~_IN_ORDER
        return True


@contextlib.contextmanager
def _claimed(lock: Path) -> Iterator[Path]:
    """Hold a lock, and give what it guards; OSError where its process lives."""
    with lock.open('rb') as claim:
        fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield lock.with_name(lock.name.removesuffix('_el'))


def _may_be_starting(lock: Path) -> bool:
    """Return whether a file was just made; one of the future was not, the clock was set back."""
    return 0.0 <= time.time() - lock.stat().st_mtime <= _STARTING_S
