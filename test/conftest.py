# SPDX-License-Identifier: Apache-2.0
"""What every test may ask for, and the order in which parallel workers take the tests."""

from collections.abc import Callable
from collections.abc import Iterator
import os
from pathlib import Path
import shutil
import signal
import subprocess

from browser import find_browser
import numpy as np
import pytest
import tally

# A shell starts what runs in its background with Ctrl-C ignored, which all processes that the
# tests start would inherit.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# Folders whose tests wait for other processes come first, so that short tests fill the end.
_FIRST = ('system', 'ros', 'scripts', 'fuzz')
# Files whose tests share a graph or another costly fixture: one worker runs all of a unit.
_UNITS = {f'{name}.py': name for name in (
    'test_evaluate', 'test_faults', 'test_graph_is_core', 'test_hangs', 'test_installed',
    'test_layouts', 'test_main_job', 'test_record_replay', 'test_reproduce', 'test_respawn',
    'test_ros2_command', 'test_shared_memory', 'test_stalls', 'test_view', 'test_who_gets_in')}
_UNITS |= {'test_topics.py': 'published', 'test_tracks.py': 'published'}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sort the tests: long ones first."""
    def rank(item: pytest.Item) -> int:
        folder = item.path.parent.name
        return _FIRST.index(folder) if folder in _FIRST else len(_FIRST)

    items.sort(key=rank)


@pytest.hookimpl(optionalhook=True, tryfirst=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Give each worker the next test, or all tests of a file that share something costly."""
    from xdist.scheduler import LoadScopeScheduling

    class Units(LoadScopeScheduling):
        # The groups of xdist itself have no effect with pytest 9.
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.partition('::')[0].rpartition('/')[2]
            return _UNITS.get(file, nodeid)

    return Units(config, log)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Hand the counts of a worker to the process that prints them."""
    if hasattr(session.config, 'workeroutput'):
        session.config.workeroutput['tally'] = tally.counts()


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node) -> None:
    """Take the counts of a worker that has ended; one that crashed has none."""
    if found := getattr(node, 'workeroutput', {}).get('tally'):
        tally.add(found)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print how many faults were injected and how many inputs were tried."""
    for line in tally.summary():
        terminalreporter.write_line(line)


@pytest.fixture
def seed() -> int:
    """Return the seed of a test; a test that needs another one states it."""
    return 7


@pytest.fixture
def rng(seed) -> np.random.Generator:
    """Return a new generator for every test."""
    return np.random.default_rng(seed)


@pytest.fixture
def grid_shape() -> tuple[int, int]:
    """Return (rows, cols) of a small grid; not square, so that a swap of axes shows."""
    return 7, 5


@pytest.fixture(scope='session')
def require_program() -> Callable[[str], str]:
    """
    Return a function that gives a program's path, or ends the test without the program.

    On a user's machine the test is skipped.  With ``CI=true`` it fails, so that no test goes
    missing unnoticed.
    """
    def find(name: str) -> str:
        path = shutil.which(name)
        if path is None:
            end = pytest.fail if os.environ.get('CI') == 'true' else pytest.skip
            end(f'needs the program {name}, which is not on the path')
        return path

    return find


@pytest.fixture(scope='session')
def chromium(require_program: Callable[[str], str]) -> str:
    """Return the path of a Chromium that runs, or end the test without it."""
    return find_browser() or require_program('chromium')


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
