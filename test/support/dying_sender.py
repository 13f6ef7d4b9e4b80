"""A process that is killed while it sends into a port of the middleware in shared memory."""

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import subprocess
import sys

# Takes a mutex, as a sender does for some microseconds, and does not live to give it back.
_LOCK = """
import ctypes, mmap, os, signal, sys
with open(sys.argv[1], 'r+b') as file:
    memory = mmap.mmap(file.fileno(), 0)
mutex = (ctypes.c_byte * 40).from_buffer(memory, int(sys.argv[2]))
assert ctypes.CDLL(None).pthread_mutex_lock(mutex) == 0
print('locked', flush=True)
if sys.argv[3] == 'die':
    os.kill(os.getpid(), signal.SIGKILL)
sys.stdin.read()
assert ctypes.c_int.from_buffer(memory, int(sys.argv[2])).value
assert ctypes.CDLL(None).pthread_mutex_unlock(mutex) == 0
"""


def open_files(pid: int) -> list[Path]:
    """Return the files that a process has open."""
    return [Path(os.readlink(link)) for link in Path(f'/proc/{pid}/fd').iterdir()]


def port_of(pid: int) -> Path:
    """Return the port at which a process hears what others send to its domain."""
    numbers = [int(path.name.removeprefix('fastrtps_port').removesuffix('_el'))
               for path in open_files(pid) if path.match('fastrtps_port*_el')]
    return Path(f'/dev/shm/fastrtps_port{max(numbers)}')


def die_in(port: Path, offset: int) -> None:
    """Have a process lock a mutex of a port, and be killed."""
    with _locking(port, offset, 'die'):
        pass


@contextmanager
def sending_to(port: Path, offset: int) -> Iterator[None]:
    """Have a process hold a mutex of a port meanwhile; it does not end well if it loses it."""
    with _locking(port, offset, 'live') as process:
        yield
        process.communicate('')
    assert process.returncode == 0


def _locking(port: Path, offset: int, how: str) -> subprocess.Popen:
    process = subprocess.Popen(
        [sys.executable, '-c', _LOCK, str(port), str(offset), how], text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout.readline() == 'locked\n'
    return process
