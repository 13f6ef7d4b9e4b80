"""The machine that the processes of a graph see: its clock, and its network."""

from pathlib import Path
import struct
import subprocess

from intruder import INJECTED

_SOURCE = Path(__file__).with_name('faults.c')


class Machine:
    """
    Breaks the machine of all processes that are started in its environment.

    Parameters
    ----------
    folder
        Where the library goes that stands between a process and its machine.
    compiler
        Path of the C compiler.

    """

    def __init__(self, folder, compiler):
        self._faults = folder / 'faults'
        self._write(0, lost=False)
        library = folder / 'faults.so'
        subprocess.run([compiler, '-shared', '-fPIC', '-o', library, _SOURCE], check=True)
        self.environment = {'LD_PRELOAD': str(library), 'FAULTS': str(self._faults)}

    def set_clock(self, hours):
        """Set the clock, ahead or back of the true one."""
        self._write(hours, lost=False)
        INJECTED['clock of the machine set'] += 1

    def lose_datagrams(self, lost):
        """Have the network carry nothing, or all again."""
        self._write(0, lost)
        INJECTED[f'datagrams {"lost" if lost else "carried again"}'] += 1

    def _write(self, hours, lost):
        with self._faults.open('r+b' if self._faults.exists() else 'wb') as file:
            file.write(struct.pack('=qq', hours * 3_600_000_000_000, lost))
