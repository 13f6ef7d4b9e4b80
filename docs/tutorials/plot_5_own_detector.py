# SPDX-License-Identifier: Apache-2.0
r"""
Your own detector
=================

A detector is a frozen dataclass with two functions: ``init`` makes its memory, and ``step`` takes
a frame and returns the memory after it and what is declared. Its settings, its calibration and its
node follow from the class.
"""

import importlib
from pathlib import Path
import sys
from tempfile import TemporaryDirectory

import lowsnr
import matplotlib.pyplot as plt
import numpy as np

# %%
# This one keeps a fading sum of log-likelihood ratios in every cell,
# :math:`S_k = \lambda S_{k-1} + \ln L(z_k)`. It is a file of its own:

SOURCE = '''
"""MEMORY: a fading sum of log-likelihood ratios in every cell, against a threshold."""

from dataclasses import dataclass

from lowsnr_common.settings.declare import setting
from lowsnr_detect.parts.cell_detector import CellDetector
from lowsnr_detect.parts.registry import register
import numpy as np


@register('memory')
@dataclass(frozen=True, kw_only=True)
class Memory(CellDetector):
    """Declare the cells with ``S_k = fading * S_{k-1} + ln L(z_k) > ln th``."""

    fading: float = setting(0.7, 'fraction of the sum that a frame keeps', ge=0.0, lt=1.0)

    def init(self, shape):
        """Return the sums before the first frame, (..., rows, cols)."""
        return np.zeros(shape)

    def step(self, state, frame, rng):
        """Add a frame (..., rows, cols) to the sums and declare the cells above the threshold."""
        sums = self.fading * state + self.sensor.log_likelihood_ratio(frame)
        return sums, self.declare(sums)
'''

PLACE = TemporaryDirectory()
Path(PLACE.name, 'memory.py').write_text(SOURCE)
sys.path.append(PLACE.name)
importlib.import_module('memory')  # which registers it

# %%
# From then on it has a name. The calibration simulates its threshold for a false alarm in 1 % of
# the empty frames:

SNR_DB = 9
print(lowsnr.calibrate((20, 20), 'memory', SNR_DB, progress=False).threshold)

# %%
# At the same false-alarm rate it can be compared with others. An object that stays in its cell is
# what it was made for; one that moves leaves its sum behind:

RUNS = 20
moving = [lowsnr.simulate('example4', snr_db=SNR_DB, seed=seed) for seed in range(RUNS)]
for name in ('cdt', 'memory', 'sdt'):
    hits = []
    for run in moving:
        found = lowsnr.detect(run.frames, name, SNR_DB, progress=False).detections
        hits += [
            bool(np.any((found.frame == there.frame)
                        & (np.hypot(found.x - there.x, found.y - there.y) <= 1.5)))
            for there in run.truth]
    print(f'{name:<8}{np.mean(hits):.3f} of {len(hits)} objects hit')

# %%
# Its settings are checked like all others:

try:
    lowsnr.detect(moving[0].frames, 'memory', SNR_DB, settings={'memory.fading': 1.5})
except ValueError as error:
    print(error)

# %%
# To run it as a node put the file into ``src/lowsnr_detect/lowsnr_detect/detectors/``: then
# ``bringup.py --detector memory`` starts it, ``--set memory.fading=0.9`` sets it, and the tests
# that every detector has to pass include it. ``CONTRIBUTING.md`` says what else belongs to it.

result = lowsnr.detect(moving[0].frames, 'memory', SNR_DB, progress=False)
figure, axis = plt.subplots(figsize=(5, 4.5), layout='constrained')
axis.plot(moving[0].truth.x, moving[0].truth.y, color='#009E73', label='truth')
axis.plot(result.detections.x, result.detections.y, 'x', label='memory')
axis.set(xlim=(-0.5, 19.5), ylim=(19.5, -0.5), xlabel='x [pixels]', ylabel='y [pixels]')
axis.legend()
PLACE.cleanup()
plt.show()
