# SPDX-License-Identifier: Apache-2.0
"""What the threads of a process do: whether it is slow, or stuck."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
import time

_RUNNING = 'RD'  # running or waiting for a processor; waiting for a disk
# Time between two looks that counts at most, in case that this process itself did not run [s].
_LONGEST_LOOK_S = 0.1
_MOST_S = 30.0


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
