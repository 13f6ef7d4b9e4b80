# SPDX-License-Identifier: Apache-2.0
"""
Bags
====

A bag keeps frames and, where there is one, the truth. This program makes one of an array, runs a
detector on it, records that run, and scores the recording again without starting a node.
"""

from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory

import lowsnr
import numpy as np

ROOT = Path(lowsnr.__file__).resolve().parents[3]  # the checkout
PLACE = TemporaryDirectory()
HERE = Path(PLACE.name)


def run(*words: object) -> None:
    """Run a command of the checkout and print what it prints."""
    print(subprocess.run(
        [sys.executable, *map(str, words)], cwd=ROOT, stdout=subprocess.PIPE, text=True,
        check=True).stdout.replace(f'{HERE}/', ''))


# %%
# Frames ``[T, rows, cols]``, and where they are known the places of the object ``[T, 2]`` and the
# times of the frames:

simulated = lowsnr.simulate('example4', snr_db=12)
truth = np.full((len(simulated.frames), 2), np.nan)
truth[simulated.truth.frame] = np.stack([simulated.truth.x, simulated.truth.y], axis=1)
np.savez(HERE / 'frames.npz', frames=simulated.frames, truth=truth,
         t_s=np.arange(len(simulated.frames), dtype=float))
run('scripts/convert.py', HERE / 'frames.npz', '--out', HERE / 'sky')

# %%
# ``--replay`` takes the bag, or any file that ``convert.py`` reads; ``--record`` keeps what the
# nodes made of it:

run('scripts/bringup.py', '--replay', HERE / 'sky', '--detector', 'sdt', '--snr', '12',
    '--condition', 'off', '--lockstep', '--record', HERE / 'recorded', '--results', HERE / 'run')

# %%
# A recording knows its parameters. ``evaluate.py`` scores it again, and another detector can be
# run on the very same frames by ``bringup.py --replay recorded --detector hmm``.

run('scripts/evaluate.py', HERE / 'recorded', '--results', HERE / 'again')
print(*sorted(path.name for path in (HERE / 'again').iterdir()), sep='\n')
PLACE.cleanup()

# %%
# :doc:`/bags` has the storage formats, bags of others, and what happens to damaged ones.
