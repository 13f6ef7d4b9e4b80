# SPDX-License-Identifier: Apache-2.0
"""Faults of the host as the processes of a graph see it: its clock and its network."""

from pathlib import Path
import struct
import subprocess

from tally import FAULTS

_SOURCE = Path(__file__).with_name('host_faults.c')


class HostFaults:
    """
    Set the clock and stop the network of all processes started in its environment.

    A library that is loaded before all others stands between a process and the host.

    Parameters
    ----------
    folder
        Where the library goes.
    compiler
        Path of the C compiler.

    """

    def __init__(self, folder: Path, compiler: str) -> None:
        self._faults = folder / 'faults'
        self._write(0, lost=False)
        library = folder / 'host_faults.so'
        subprocess.run([compiler, '-shared', '-fPIC', '-o', library, _SOURCE], check=True)
        self.environment = {'LD_PRELOAD': str(library), 'HOST_FAULTS': str(self._faults)}

    def set_clock(self, hours: float) -> None:
        """Set the clock ahead of, or behind, the true one."""
        self._write(hours, lost=False)
        FAULTS['clock of the host set'] += 1

    def lose_datagrams(self, lost: bool) -> None:
        """Have the network drop every datagram, or deliver them again."""
        self._write(0, lost)
        FAULTS[f'datagrams {"lost" if lost else "delivered again"}'] += 1

    def _write(self, hours: float, lost: bool) -> None:
        with self._faults.open('r+b' if self._faults.exists() else 'wb') as file:
            file.write(struct.pack('=qq', round(hours * 3_600_000_000_000), lost))
