"""What processes that were killed leave of Fast DDS in shared memory, put in order."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import ctypes
import fcntl
import mmap
from pathlib import Path
import re
import struct
import time

_FOLDER = Path('/dev/shm')
# The lock of a segment, which its process holds as long as it lives, and a port.
_SEGMENT = re.compile(r'fastrtps_[0-9a-f]{16}_el')
_PORT = re.compile(r'fastrtps_port(\d+)')
# A process that is starting has made the file, and may not hold the lock yet.
_STARTING_S = 10.0
# In a port of Fast DDS 2.14: its version, its number, and a byte with whether it is in order.
_VERSION, _NUMBER_AT, _STATE_AT, _IN_ORDER = b'port_node_abi5', 276, 300, 1
# Its mutexes on x86-64; in one, whether it is locked, by which thread, and its kind: shared.
MUTEXES_AT, _MUTEX, _SHARED = (20808, 20848), struct.Struct('<i4xi4xi'), 128
# Whoever lives holds one for some microseconds.
_HELD_S = 0.01


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
    for port, memory in _ports(folder):
        with contextlib.suppress(OSError), _claimed(port.with_name(f'{port.name}_el')):
            memory[_STATE_AT] &= ~_IN_ORDER
            closed += 1
    return closed


def free_ports(folder: Path = _FOLDER) -> int:
    """
    Unlock what a process that was killed while it sent has left locked in the ports of others.

    They would wait for it for a second, give the port up and make a new one, each at its own
    time; meanwhile a node may hear nothing, for ten seconds or for good.

    Returns
    -------
    int
        How many mutexes there were.

    """
    freed = 0
    for _, memory in _ports(folder):
        for offset in MUTEXES_AT:
            if (owner := _lost_owner(memory, offset)) and _still(memory, offset, owner):
                mutex = (ctypes.c_byte * _MUTEX.size).from_buffer(memory, offset)
                ctypes.CDLL(None).pthread_mutex_unlock(mutex)
                del mutex  # which keeps the memory mapped
                freed += 1
    return freed


def _lost_owner(memory: mmap.mmap, offset: int) -> int:
    """Return the thread that holds a mutex, where there is no such thread; 0 otherwise."""
    locked, owner, kind = _MUTEX.unpack_from(memory, offset)
    return owner if locked and kind == _SHARED and not Path(f'/proc/{owner}').exists() else 0


def _still(memory: mmap.mmap, offset: int, owner: int) -> bool:
    """Return whether it is held on; one of another container, which is not seen, lets go."""
    time.sleep(_HELD_S)
    return _lost_owner(memory, offset) == owner


def _ports(folder: Path) -> Iterator[tuple[Path, mmap.mmap]]:
    """Give the ports that we know, and may write, with their memory."""
    for path in folder.glob('fastrtps_port*'):
        with contextlib.suppress(OSError):
            found = _PORT.fullmatch(path.name)
            if found and path.stat().st_size >= MUTEXES_AT[-1] + _MUTEX.size:
                with path.open('r+b') as file, mmap.mmap(file.fileno(), 0) as memory:
                    number = struct.unpack_from('<I', memory, _NUMBER_AT)
                    if memory.find(_VERSION) >= 0 and number == (int(found[1]),):
                        yield path, memory


@contextlib.contextmanager
def _claimed(lock: Path) -> Iterator[Path]:
    """Hold a lock, and give what it guards; OSError where its process lives."""
    with lock.open('rb') as claim:
        fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield lock.with_name(lock.name.removesuffix('_el'))


def _may_be_starting(lock: Path) -> bool:
    """Return whether a file was just made; one of the future was not, the clock was set back."""
    return 0.0 <= time.time() - lock.stat().st_mtime <= _STARTING_S
