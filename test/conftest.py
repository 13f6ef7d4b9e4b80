"""What every test may ask for."""

from collections.abc import Callable
from collections.abc import Iterator
import contextlib
import os
from pathlib import Path
import shutil
import signal
import subprocess

import numpy as np
import pytest

# A shell starts what runs in its background deaf to Ctrl-C, and so would be all that tests start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def seed() -> int:
    """Return the seed of a test; a test that needs another one states it."""
    return 7


@pytest.fixture
def rng(seed) -> np.random.Generator:
    """Return a generator of its own for every test."""
    return np.random.default_rng(seed)


@pytest.fixture
def grid_shape() -> tuple[int, int]:
    """Return (rows, cols) of a small grid; not square, so that a swap of axes shows."""
    return 7, 5


@pytest.fixture
def require_program() -> Callable[[str], str]:
    """
    Return a function that gives a program's path, or ends the test without the program.

    On a user's machine the test is skipped.  Under ``CI=true`` every program must be
    there, so that no test goes missing without anybody noticing: the test fails.
    """
    def find(name: str) -> str:
        path = shutil.which(name)
        if path is None:
            end = pytest.fail if os.environ.get('CI') == 'true' else pytest.skip
            end(f'needs the program {name}, which is not on the path')
        return path

    return find


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """Yield a folder that is a disk of one MiB; only root can make one."""
    folder = tmp_path / 'disk'
    folder.mkdir()
    made = subprocess.run(
        ['mount', '-t', 'tmpfs', '-o', 'size=1m', 'none', str(folder)],
        capture_output=True, text=True, check=False)
    if made.returncode:
        end = pytest.fail if os.environ.get('CI') == 'true' else pytest.skip
        end(f'needs to mount a disk: {made.stderr.strip()}')
    yield folder
    subprocess.run(['umount', '--lazy', str(folder)], check=True)


def fill(ballast: Path) -> None:
    """Fill the disk that a file is on, to the last byte."""
    with ballast.open('wb', buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(4096))
