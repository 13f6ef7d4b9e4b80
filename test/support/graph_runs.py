# SPDX-License-Identifier: Apache-2.0
"""Start the real graph for a test, on a ROS domain of its own, and check that it ends."""

from collections.abc import Callable
from collections.abc import Sequence
import csv
from dataclasses import dataclass
import fcntl
import functools
import gc
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any
from typing import Self

ROOT = Path(__file__).resolve().parents[2]
BRINGUP = ROOT / 'scripts' / 'bringup.py'
# Domains for tests and benchmarks, away from those that people use.  Their ports lie below those
# that the system gives to sockets that ask for any.
_DOMAINS = range(51, 97)
# Generous, because the other tests that run at the same time take the cores too.
_ENDS_WITHIN_S = 240.0
_ROWS_WITHIN_S = 120.0
_RESTARTS_WITHIN_S = 120.0
_LEAVES_WITHIN_S = 120.0
_CLAIMS: list[int] = []  # open lock files; the claims end with this process


def graph_environment(domain_id: int) -> dict[str, str]:
    """Return the environment of a graph that only this test can reach."""
    gc.collect()  # nodes that earlier tests destroyed answer until they are collected
    return os.environ | {
        'ROS_DOMAIN_ID': str(domain_id), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        'BROWSER': '', 'DISPLAY': '', 'WAYLAND_DISPLAY': ''}  # a page opens in no browser


@functools.cache
def own_domain(other: int = 0) -> int:
    """
    Return a ROS domain that no other test or benchmark of this user on this machine has.

    Each worker of a parallel test run is such a process.  A lock file for every domain holds the
    claim until this process ends.

    Parameters
    ----------
    other
        Which of the process's domains: graphs that run at the same time take one each.

    """
    for n in range(len(_DOMAINS)):
        domain = _DOMAINS[(os.getpid() + n) % len(_DOMAINS)]
        path = Path(tempfile.gettempdir(), f'lowsnr-{os.getuid()}-test-domain-{domain}.lock')
        claim = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_NOFOLLOW, 0o600)
        try:
            fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(claim)
        else:
            _CLAIMS.append(claim)
            return domain
    raise AssertionError(f'all ROS domains in {_DOMAINS} are taken by other tests')


def enter_own_domain() -> int:
    """Give this process, and what it starts, a ROS domain of its own on this host; return it."""
    domain = own_domain()
    os.environ |= {'ROS_DOMAIN_ID': str(domain), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    return domain


def node_processes(results: Path) -> list[tuple[str, int]]:
    """Return the last part of the module, and the process id, of every node of a run."""
    found = []
    for entry in Path('/proc').glob('[0-9]*'):
        try:
            # The title of a forked node has spaces where a command line has zeros.
            command = (entry / 'cmdline').read_bytes().replace(b'\0', b' ').decode()
        except OSError:  # it has ended
            continue
        if ' -m ' in command and str(results) in command:
            module = command.partition(' -m ')[2].split()[0]
            found.append((module.rpartition('.')[2], int(entry.name)))
    return found


@dataclass
class GraphRun:
    """A started ``bringup.py`` and the folder of its results; a ``with`` block ends it."""

    process: subprocess.Popen
    results: Path

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def finish(self, within_s: float = _ENDS_WITHIN_S) -> tuple[int, str, str]:
        """Wait for the end; return exit code, stdout and stderr."""
        out, err = self.process.communicate(timeout=within_s)
        return self.process.returncode, out, err

    def summary(self) -> dict:
        """Return what ``summary.json`` holds."""
        return json.loads((self.results / 'summary.json').read_text())

    def rows(self) -> list[str]:
        """Return the whole rows of ``frames.csv`` without its header."""
        path = self.results / 'frames.csv'
        lines = path.read_text().splitlines(keepends=True) if path.is_file() else []
        return [line.rstrip('\n') for line in lines[1:] if line.endswith('\n')]

    def wait_for_rows(self, count: int, within_s: float = _ROWS_WITHIN_S) -> None:
        """Wait until ``frames.csv`` has this many rows."""
        self._wait_for(count, self.rows, within_s)

    def nodes(self) -> dict[str, int]:
        """Return the process ids of the nodes that run, by the last part of their module."""
        return dict(self.processes())

    def processes(self) -> list[tuple[str, int]]:
        """Return the last part of the module, and the process id, of every node that runs."""
        return [(module, pid) for module, pid in node_processes(self.results)
                if pid != self.process.pid]

    def wait_for_nodes(self, count: int, within_s: float = _ROWS_WITHIN_S) -> None:
        """Wait until this many nodes run."""
        self._wait_for(count, self.processes, within_s)

    def restarts(self) -> list[dict[str, str]]:
        """Return the rows of ``restarts.csv``."""
        path = self.results / 'restarts.csv'
        return list(csv.DictReader(path.read_text().splitlines())) if path.is_file() else []

    def kill(self, module: str, number: int = signal.SIGKILL) -> None:
        """Send a node a signal."""
        os.kill(self.nodes()[module], number)

    def wait_for_restarts(self, count: int, within_s: float = _RESTARTS_WITHIN_S) -> None:
        """Wait until this many nodes have been restarted."""
        self._wait_for(count, self.restarts, within_s)

    def _wait_for(self, count: int, found: Callable[[], Sequence[Any]], within_s: float) -> None:
        """Wait until so many are found; fail where the run ends before, or after this time."""
        until = time.monotonic() + within_s
        while len(there := found()) < count:
            assert self.process.poll() is None, self.finish()
            assert time.monotonic() < until, (
                f'{len(there)} of {count} after {within_s} s, the last {there[-5:]}')
            time.sleep(0.02)

    def wait_until_none_is_left(self, within_s: float = _LEAVES_WITHIN_S) -> None:
        """Wait until no node of the run is left; fail after this time."""
        until = time.monotonic() + within_s
        while self.nodes():
            assert time.monotonic() < until, f'left behind: {self.nodes()}'
            time.sleep(0.05)

    def end(self) -> None:
        """Kill what still runs of it, by process id."""
        for pid in [*(pid for _, pid in self.processes()), self.process.pid]:
            if pid != self.process.pid or self.process.poll() is None:
                os.kill(pid, signal.SIGKILL)
        self.process.wait()
        for stream in (self.process.stdout, self.process.stderr):
            if stream is not None:
                stream.close()


def start_bringup(results: Path, *arguments: str, domain_id: int, **how: Any) -> GraphRun:
    """Start ``bringup.py``, which writes its results into the folder given; `how` is Popen's."""
    process = subprocess.Popen(
        [sys.executable, str(BRINGUP), '--results', str(results), *arguments],
        env=graph_environment(domain_id), text=True,
        **{'stdout': subprocess.PIPE, 'stderr': subprocess.PIPE} | how)
    return GraphRun(process, results)


def run_bringup(*arguments: str) -> subprocess.CompletedProcess:
    """Run ``bringup.py`` to its end; for command lines that it refuses."""
    return subprocess.run(
        [sys.executable, str(BRINGUP), *arguments], env=graph_environment(own_domain()),
        capture_output=True, text=True, timeout=_ENDS_WITHIN_S, check=False)
