# SPDX-License-Identifier: Apache-2.0
"""Processes, and what their threads do: whether one is slow, or stuck."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterable
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
import time
from typing import Protocol

_RUNNING = 'RD'  # running or waiting for a processor; waiting for a disk
# Time between two looks that counts at most, in case that this process itself did not run [s].
_LONGEST_LOOK_S = 0.1
_MOST_S, _POLL_S = 30.0, 0.01


class Process(Protocol):
    """A process of a node, spawned or forked."""

    @property
    def pid(self) -> int:
        """Process id."""

    @property
    def returncode(self) -> int | None:
        """Exit status, or the negative signal that killed it; None before :meth:`poll` saw it."""

    def poll(self) -> int | None:
        """Return the exit status, None while it runs."""

    def wait(self, timeout: float) -> int:
        """Wait for the end; :class:`subprocess.TimeoutExpired` after so many seconds."""

    def send_signal(self, number: int, /) -> None:
        """Send a signal, unless the process has ended."""

    def kill(self) -> None:
        """Send SIGKILL, unless the process has ended."""


@dataclass(frozen=True)
class Threads:
    """
    The threads of a process at one moment.

    ``busy`` is whether any runs, or waits for a processor or a disk; ``switches`` counts how often
    the main thread was taken off a processor.
    """

    busy: bool
    switches: int


def threads_of(pid: int) -> Threads | None:
    """Return the threads of a process; None where the system does not say (not Linux)."""
    states, switches = set(), 0
    try:
        for thread in Path(f'/proc/{pid}/task').iterdir():
            facts = dict(
                line.split(':\t', 1) for line in (thread / 'status').read_text().splitlines()
                if ':\t' in line)
            states.add(facts['State'][0])
            if thread.name == str(pid):
                switches = (int(facts['voluntary_ctxt_switches'])
                            + int(facts['nonvoluntary_ctxt_switches']))
    except (OSError, KeyError):
        return None
    return Threads(bool(states & set(_RUNNING)), switches)


class Patience:
    """
    How long to wait for what a process is to do.

    A process that computes, or waits for a processor, is slow: on a busy machine it may take any
    time.  One with nothing to do, or that is stopped, is stuck.

    Parameters
    ----------
    pid
        Process id.
    idle_s, most_s
        Longest time in which the process is not busy, and in all [s].
    look, clock
        What tells the threads of a process, and the time [s].

    """

    def __init__(
        self, pid: int, idle_s: float, most_s: float = _MOST_S,
        look: Callable[[int], Threads | None] = threads_of,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._pid, self._look, self._clock = pid, look, clock
        self._left_s, self._looked_s = idle_s, clock()
        self._until_s = self._looked_s + most_s

    def is_over(self) -> bool:
        """Return whether to wait no longer; call it again and again while waiting."""
        last_s, self._looked_s = self._looked_s, self._clock()
        threads = self._look(self._pid)
        if threads is None:  # not Linux
            self._left_s -= self._looked_s - last_s
        elif not threads.busy:
            self._left_s -= min(self._looked_s - last_s, _LONGEST_LOOK_S)
        return self._left_s < 0.0 or self._looked_s > self._until_s


def stuck(
    processes: Iterable[Process], idle_s: float, most_s: float, meanwhile: Callable[[], None],
) -> Iterator[Process]:
    """
    Wait until all processes have ended; yield each that does not, and is waited for no longer.

    Parameters
    ----------
    processes
        What is waited for.
    idle_s, most_s
        The patience with each [s].
    meanwhile
        Called again and again.

    """
    left = {process: Patience(process.pid, idle_s, most_s) for process in processes}
    while left:
        meanwhile()
        for process, patience in list(left.items()):
            if process.poll() is not None:
                del left[process]
            elif patience.is_over():
                del left[process]
                yield process
        time.sleep(_POLL_S * bool(left))
