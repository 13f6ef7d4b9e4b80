# SPDX-License-Identifier: Apache-2.0
"""
Your own frames
===============

Frames of a camera are an array ``(K, rows, cols)`` of integers. Their background is not flat,
their noise is not the same everywhere, and nobody knows the SNR. This program makes such frames;
put your own in their place, for example ``numpy.load('frames.npy')``.
"""

import lowsnr
import matplotlib.pyplot as plt
import numpy as np

rng = np.random.default_rng(5)
K, ROWS, COLS = 100, 72, 96
rows, cols = np.mgrid[:ROWS, :COLS]
background = 900 + 3 * rows + 120 * np.sin(cols / 20)
noise_std = 8 + 8 * cols / COLS  # brighter on the right, and noisier
x, y = 12 + 0.75 * np.arange(K), 50 - 0.3 * np.arange(K)
frames = np.empty((K, ROWS, COLS), np.uint16)
for k in range(K):
    spot = np.exp(-((cols - x[k])**2 + (rows - y[k])**2) / (2 * 0.9**2))
    frames[k] = np.round(background + 34 * spot + noise_std * rng.standard_normal((ROWS, COLS)))

# %%
# One call is enough. Integers are taken for those of a camera: lowsnr follows the motion of the
# camera, removes the background, divides by the local noise, and learns the threshold from the
# frames themselves.

result = lowsnr.track(frames, progress=False)
print(f'detector {result.detector}, conditioned: {result.conditioned}')
print(f'false-alarm rate asked {result.alarm_rate.asked}, '
      f'measured {result.alarm_rate.measured:.3f}')
print(result.tracks)

# %%
# What the detector sees are the cells of :func:`lowsnr.condition`. They have the standard
# deviation one wherever there is noise alone, and ``maps`` say where they lie in the frame.

FRAME = 60
cells = lowsnr.condition(frames, progress=False).cells
figure, axes = plt.subplots(1, 3, figsize=(11, 3.2), layout='constrained')
axes[0].imshow(frames[FRAME], cmap='gray')
axes[0].set(title='frame')
axes[1].imshow(cells[FRAME], cmap='gray', vmin=-3, vmax=5)
axes[1].set(title='cells')
axes[2].plot(x, y, color='#009E73', lw=4, alpha=0.6, label='truth')
for number in np.unique(result.tracks.id):
    own = result.tracks[result.tracks.id == number]
    axes[2].plot(own.x, own.y, '.-', label=f'track {number}')
axes[2].set(title='tracks', xlim=(0, COLS), ylim=(ROWS, 0))
axes[2].legend()

# %%
# ``settings`` changes what was chosen, by the names of the :doc:`parameter files
# </generated/configuration>`, and ``result.arguments`` repeats a run exactly:

again = lowsnr.track(frames, progress=False, **result.arguments)
assert np.array_equal(again.tracks, result.tracks)

# %%
# Floating-point frames are taken for white noise plus objects, and are not conditioned unless
# ``condition='on'``. :doc:`/real_frames` says which objects in which frames are found.
plt.show()
