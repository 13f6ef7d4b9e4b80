"""Start the real graph for a test, on a domain of its own, and see that nothing is left."""

import csv
from dataclasses import dataclass
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Self

ROOT = Path(__file__).resolve().parents[2]
BRINGUP = ROOT / 'scripts' / 'bringup.py'
# Domains for tests, away from those that people and benchmarks use; their ports lie below those
# that the system gives to sockets that ask for any.
_DOMAINS = range(51, 97)
_ENDS_WITHIN_S = 120.0


def graph_environment(domain_id: int) -> dict[str, str]:
    """Return the environment of a graph that only this test can see."""
    return os.environ | {
        'ROS_DOMAIN_ID': str(domain_id), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}


def own_domain(other: int = 0) -> int:
    """
    Return a ROS domain that no other test process on this machine is likely to use.

    Graphs that run at the same time take the others, counted from 0.
    """
    return _DOMAINS[(os.getpid() + 37 * other) % len(_DOMAINS)]


@dataclass
class GraphRun:
    """A started ``bringup.py`` and the folder of its results; in ``with`` it ends with that."""

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
        """Return the lines of ``frames.csv`` without its header."""
        path = self.results / 'frames.csv'
        return path.read_text().splitlines()[1:] if path.is_file() else []

    def wait_for_rows(self, count: int, within_s: float = 60.0) -> None:
        """Wait until this many lines are scored."""
        until = time.monotonic() + within_s
        while len(self.rows()) < count:
            assert self.process.poll() is None, self.finish()
            assert time.monotonic() < until, f'{len(self.rows())} lines after {within_s} s'
            time.sleep(0.02)

    def nodes(self) -> dict[str, int]:
        """Return the process ids of the nodes that run, by the last part of their module."""
        return dict(self.processes())

    def processes(self) -> list[tuple[str, int]]:
        """Return the last part of the module, and the process id, of every node that runs."""
        found = []
        for entry in Path('/proc').iterdir():
            if not entry.name.isdigit() or int(entry.name) == self.process.pid:
                continue
            try:
                # The title of a forked node has spaces where a command line has zeros.
                command = (entry / 'cmdline').read_bytes().replace(b'\0', b' ').decode()
            except OSError:
                continue
            if ' -m ' in command and str(self.results) in command:
                module = command.partition(' -m ')[2].split()[0]
                found.append((module.rpartition('.')[2], int(entry.name)))
        return found

    def restarts(self) -> list[dict[str, str]]:
        """Return the rows of ``restarts.csv``."""
        path = self.results / 'restarts.csv'
        return list(csv.DictReader(path.read_text().splitlines())) if path.is_file() else []

    def kill(self, module: str, number: int = signal.SIGKILL) -> None:
        """Send a node a signal."""
        os.kill(self.nodes()[module], number)

    def wait_for_restarts(self, count: int, within_s: float = 90.0) -> None:
        """Wait until so many nodes are back."""
        until = time.monotonic() + within_s
        while len(self.restarts()) < count:
            assert self.process.poll() is None, self.finish()
            assert time.monotonic() < until, f'{self.restarts()} after {within_s} s'
            time.sleep(0.02)

    def wait_until_none_is_left(self, within_s: float = 5.0) -> None:
        """Fail where a node still runs after this time."""
        until = time.monotonic() + within_s
        while self.nodes():
            assert time.monotonic() < until, f'left behind: {self.nodes()}'
            time.sleep(0.05)

    def end(self) -> None:
        """End whatever still runs, by process id."""
        for pid in [*(pid for _, pid in self.processes()), self.process.pid]:
            if pid != self.process.pid or self.process.poll() is None:
                os.kill(pid, signal.SIGKILL)
        self.process.wait()
        for stream in (self.process.stdout, self.process.stderr):
            stream.close()


def start_bringup(results: Path, *arguments: str, domain_id: int) -> GraphRun:
    """Start ``bringup.py`` with its results in a folder of the test."""
    process = subprocess.Popen(
        [sys.executable, str(BRINGUP), '--results', str(results), *arguments],
        env=graph_environment(domain_id), stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True)
    return GraphRun(process, results)


def run_bringup(*arguments: str) -> subprocess.CompletedProcess:
    """Run ``bringup.py`` to its end; for what never starts a node."""
    return subprocess.run(
        [sys.executable, str(BRINGUP), *arguments], env=graph_environment(own_domain()),
        capture_output=True, text=True, timeout=60.0, check=False)
