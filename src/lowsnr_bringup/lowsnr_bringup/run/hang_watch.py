# SPDX-License-Identifier: Apache-2.0
"""
Which nodes hang, and which only take long.

A node has one thread that does its work, its main thread, and that thread reports once a second.
Where reports stay away, the kernel tells why: a thread that computes is running when it is looked
at, or waits for a processor or a disk; a thread of a stopped or locked process sleeps and is never
scheduled.  So no message that somebody forges, and no load of the machine, makes a node look as
if it hangs.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterable
from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field
import time

from lowsnr_bringup.run.processes import NodeProcess
from lowsnr_bringup.run.processes import notify
from lowsnr_bringup.run.threads import Threads
from lowsnr_bringup.run.threads import threads_of

_LOOK_EVERY_S = 0.5
# Time between two looks that counts at most, in case that bring-up itself did not run.
_LONGEST_LOOK_S = 2.0 * _LOOK_EVERY_S
# A node is due to report once a second; with less patience an ordinary delay would be a fault.
_LEAST_S = 4.0
# A calibration or a compilation may take long, but not longer than this.
_MOST_SILENT_S = 600.0
# Time beyond which a silent node that does not hang is named: its main thread may have been
# scheduled for the last time a look after its last report.
_MARGIN_S = 2.0
STOOD_STILL, NEVER_REPORTED, SILENT = 'stood still', 'never reported', 'reported nothing'


@dataclass
class Pulse:
    """
    The signs of life of one process since its last report [s].

    ``silent_s`` is the time since then, ``idle_s`` the part of it in which no thread was busy, and
    ``still_s`` the part of that since the main thread was last scheduled.
    """

    within_s: float
    reported: bool = False
    silent_s: float = 0.0
    idle_s: float = 0.0
    still_s: float = 0.0
    _switches: int = -1

    def report(self) -> None:
        """Take a report."""
        self.reported = True
        self.silent_s = self.idle_s = self.still_s = 0.0

    def look(self, threads: Threads | None, seconds: float) -> None:
        """Take a look at a process that has not reported for so many seconds more."""
        self.silent_s += seconds
        if threads is None:
            return
        moved, self._switches = threads.switches != self._switches, threads.switches
        self.idle_s += 0.0 if threads.busy else seconds
        self.still_s = 0.0 if moved else self.still_s + (0.0 if threads.busy else seconds)

    @property
    def hangs(self) -> str:
        """How the process hangs: one of the constants of this module; empty if it does not."""
        if self.still_s > self.within_s:
            return STOOD_STILL
        if not self.reported and self.idle_s > max(self.within_s, self.silent_s / 2.0):
            return NEVER_REPORTED
        return SILENT if self.silent_s > _MOST_SILENT_S else ''


@dataclass
class HangWatch:
    """
    Finds the nodes that hang, and prints which do not report and which report again.

    Parameters
    ----------
    within_s
        Time after which a node that gives no sign of life hangs [s]; at least four seconds.
    look, clock
        What tells the threads of a process, and the time [s].

    """

    within_s: float
    look: Callable[[int], Threads | None] = threads_of
    clock: Callable[[], float] = time.monotonic
    _looked_s: float = -_LONGEST_LOOK_S
    _pulses: dict[int, Pulse] = field(default_factory=dict)
    _named: dict[int, str] = field(default_factory=dict)  # what was printed, by process

    def update(
        self, members: Iterable[NodeProcess], heard: Mapping[str, tuple[str, float]],
    ) -> dict[NodeProcess, str]:
        """
        Look at the processes, at most twice a second.

        Parameters
        ----------
        members
            The processes.
        heard
            Process and time of the newest report of each node, by the full name of the node.

        Returns
        -------
        dict
            The processes that hang, and in a few words how.

        """
        last_s, now_s = self._looked_s, self.clock()
        if now_s - last_s < _LOOK_EVERY_S:
            return {}
        self._looked_s = now_s
        hanging = {}
        for member in members:
            pid = member.process.pid
            if member.process.poll() is not None:
                self._pulses.pop(pid, None)
                self._named.pop(pid, None)
                continue
            pulse = self._pulses.setdefault(pid, Pulse(max(_LEAST_S, self.within_s)))
            process, heard_s = heard.get(member.node.path, ('', -1.0))
            if process == str(pid) and heard_s >= last_s:
                self._on_report(member, pulse)
            else:
                pulse.look(self.look(pid), min(now_s - last_s, _LONGEST_LOOK_S))
                if pulse.hangs:
                    hanging[member] = f'{pulse.hangs} for {pulse.silent_s:.0f} s'
                elif pulse.silent_s > pulse.within_s + _MARGIN_S:
                    does = 'computes' if pulse.idle_s < pulse.silent_s / 2.0 else 'runs'
                    self.name(member, f'{SILENT} for {pulse.silent_s:.0f} s',
                              f', but its process {does}: bring-up waits for it')
        return hanging

    def name(self, member: NodeProcess, how: str, more: str) -> None:
        """Print how a node hangs, and more; once, until it reports again."""
        pid, kind = member.process.pid, self._pulses[member.process.pid].hangs
        if self._named.get(pid) != kind:
            self._named[pid] = kind
            notify(f'{member.node.label} {how}{more}')

    def _on_report(self, member: NodeProcess, pulse: Pulse) -> None:
        if self._named.pop(member.process.pid, None) is not None:
            notify(f'{member.node.label} reports again after {pulse.silent_s:.0f} s')
        pulse.report()
