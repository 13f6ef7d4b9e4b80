# SPDX-License-Identifier: Apache-2.0
r"""
Paths
=====

An object that moves at most one cell from a frame to the next is on one of :math:`9^{M-1}` paths
through :math:`M` frames that end in a given cell. The sum of the log-likelihood ratios along its
own path grows with every frame; along paths through noise it falls on average. Of all paths that
end in a cell only the one with the largest sum matters, so that one number for each cell and
:math:`M` is enough:

.. math:: S_M(c) = \ln L(z_M(c)) + \max_{|c' - c| \le 1} S_{M-1}(c').
"""

from dataclasses import replace

import lowsnr
from lowsnr_common.core.measurement import SensorModel
from lowsnr_detect.detectors.sdt import SDT
import matplotlib.pyplot as plt
import numpy as np

# %%
# The sequential test (SDT) keeps these planes in its memory. After some frames with an object of
# 7 dB, which no single frame shows clearly, they look as follows.

SNR_DB, FRAME, DEPTH = 7, 20, 8
run = lowsnr.simulate('example4', snr_db=SNR_DB)
detector = SDT(sensor=SensorModel(snr_db=SNR_DB), max_iterations=DEPTH + 1, beta=1e-9)
state, rng = detector.init(run.frames[0].shape), np.random.default_rng(0)
for frame in run.frames[:FRAME + 1]:
    state, _ = detector.step(state, frame, rng)

here = run.truth[run.truth.frame == FRAME]
figure, axes = plt.subplots(1, 4, figsize=(10, 2.9), layout='constrained')
for axis, M in zip(axes, (1, 2, 4, 8), strict=True):
    plane = state.log_ratio[M - 1]
    axis.imshow(np.where(np.isfinite(plane), plane, np.nan), cmap='viridis')
    axis.plot(here.x, here.y, 'o', mec='#E69F00', mfc='none', ms=13)
    axis.set(title=f'largest sum of {M} frames', xticks=[], yticks=[])

# %%
# The price of longer paths is that noise has more of them to choose from: the largest sum in
# frames without an object grows with :math:`M` as well. The margin between the two is what a
# detector lives from. The median over 40 runs, with intervals of 80 %:

RUNS = 40
largest = {}
for name, scenario in (('with an object', 'example4'), ('noise alone', 'empty')):
    frames = np.stack([
        lowsnr.simulate(scenario, snr_db=SNR_DB, seed=seed).frames[:FRAME + 1]
        for seed in range(RUNS)], axis=1)
    endless = replace(detector, beta=1e-300)  # drops no path
    state = endless.init(frames.shape[1:])
    for frame in frames:
        state, _ = endless.step(state, frame, rng)
    largest[name] = state.log_ratio.max(axis=(-1, -2))

figure, axis = plt.subplots(figsize=(7, 3.2), layout='constrained')
M = np.arange(1, DEPTH + 1)
for name, sums in largest.items():
    low, middle, high = np.quantile(sums, (0.1, 0.5, 0.9), axis=1)
    axis.plot(M, middle, label=name)
    axis.fill_between(M, low, high, alpha=0.25)
axis.set(xlabel='frames M', ylabel='largest sum in the frame [nat]')
axis.legend()
plt.show()
