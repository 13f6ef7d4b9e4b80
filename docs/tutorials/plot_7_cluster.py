# SPDX-License-Identifier: Apache-2.0
"""
Monte Carlo on a cluster
========================

A figure that compares detectors needs hundreds of runs, and a threshold for each detector and SNR.
``reproduce.py`` spreads them over the workers of a Dask scheduler. The numbers are the same
whatever the workers are, because every run has a random stream of its own.

:doc:`/cluster` starts scheduler and workers on machines of your own, with TLS, by hand, on Slurm
or on Kubernetes. Here both run on this machine.
"""

import json
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

import lowsnr

ROOT = Path(lowsnr.__file__).resolve().parents[3]  # the checkout
PLACE = TemporaryDirectory()
FILE = Path(PLACE.name, 'scheduler.json')
OPTIONS = ['--host', '127.0.0.1', '--no-dashboard', '--scheduler-file', FILE]


def dask(*words: str) -> subprocess.Popen[bytes]:
    """Return a process of Dask."""
    return subprocess.Popen(
        [sys.executable, '-m', 'dask', *words, *OPTIONS], stderr=subprocess.DEVNULL,
        cwd=PLACE.name)


# %%
# Example 3 of the paper compares two detectors. Two runs at one SNR take seconds; the documented
# figures rest on 500.

with dask('scheduler', '--port', '0') as scheduler, dask('worker', '--nthreads', '1') as worker:
    try:
        while scheduler.poll() is None and not (FILE.exists() and FILE.stat().st_size):
            time.sleep(0.1)
        address = json.loads(FILE.read_text())['address'].removeprefix('tcp://')
        subprocess.run(
            [sys.executable, 'scripts/reproduce.py', '--example', '3', '--runs', '2',
             '--snr', '6', '--detector', 'cdt', 'sdt', '--scheduler', address,
             '--results', PLACE.name],
            cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    finally:
        worker.terminate()
        scheduler.terminate()

# %%
# It leaves figures, curves, a report and every number:

folder = Path(PLACE.name, 'example3')
print(*sorted(str(path.relative_to(folder)) for path in folder.rglob('*.*')
              if path.suffix in ('.json', '.csv', '.svg', '.html')), sep='\n')
summary = json.loads((folder / 'summary.json').read_text())
print(list(summary))
PLACE.cleanup()

# %%
# An interrupted study goes on with ``--resume``. :doc:`/paper` has the results of 500 runs.
