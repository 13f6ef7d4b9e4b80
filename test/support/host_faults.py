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
        self._write(0, 0.0)
        library = folder / 'host_faults.so'
        subprocess.run([compiler, '-shared', '-fPIC', '-o', library, _SOURCE], check=True)
        self.environment = {'LD_PRELOAD': str(library), 'HOST_FAULTS': str(self._faults)}

    def set_clock(self, hours: float) -> None:
        """Set the clock ahead of, or behind, the true one."""
        self._write(hours, 0.0)
        FAULTS['clock of the host set'] += 1

    def lose_datagrams(self, share: float) -> None:
        """Have the network drop this share of all datagrams, from now on."""
        self._write(0, share)
        FAULTS[f'datagrams {"lost" if share else "delivered again"}'] += 1

    def _write(self, hours: float, share: float) -> None:
        with self._faults.open('r+b' if self._faults.exists() else 'wb') as file:
            file.write(struct.pack(
                '=qq', round(hours * 3_600_000_000_000), round(share * 10_000)))
