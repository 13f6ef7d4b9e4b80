# SPDX-License-Identifier: Apache-2.0
r"""
Signal-to-noise ratio
=====================

A cell of a frame measures noise of the standard deviation :math:`\sigma`, and where an object is
also its intensity :math:`I`. Its signal-to-noise ratio is

.. math:: \mathrm{SNR} = 10 \log_{10} \frac{I^2}{\sigma^2} \ \mathrm{dB}.
"""

import lowsnr
import matplotlib.pyplot as plt
import numpy as np

# %%
# The same object, in the same frame of the same noise, at four SNRs. At 12 dB it is four standard
# deviations strong; in 400 cells of noise the strongest one has three, so that the object can be
# seen. At 9 dB it is one of several bright cells, and at 3 dB there is nothing to see.

SNRS_DB, FRAME = (3, 6, 9, 12), 20
figure, axes = plt.subplots(1, 4, figsize=(10, 2.9), layout='constrained')
for axis, snr_db in zip(axes, SNRS_DB, strict=True):
    run = lowsnr.simulate('example4', snr_db=snr_db)
    here = run.truth[run.truth.frame == FRAME]
    axis.imshow(run.frames[FRAME], cmap='gray', vmin=-3, vmax=4)
    axis.plot(here.x, here.y, 'o', mec='#009E73', mfc='none', ms=13)
    axis.set(title=f'{snr_db} dB', xticks=[], yticks=[])

# %%
# Why: the distributions of a cell with and without the object overlap. A threshold that keeps
# most of the noise out at 3 dB keeps most of the object out too.

z = np.linspace(-4, 8, 400)
figure, axis = plt.subplots(figsize=(7, 3), layout='constrained')
axis.fill_between(z, np.exp(-z**2 / 2) / np.sqrt(2 * np.pi), color='0.8', label='noise alone')
for snr_db in SNRS_DB:
    intensity = 10 ** (snr_db / 20)
    axis.plot(z, np.exp(-(z - intensity)**2 / 2) / np.sqrt(2 * np.pi), label=f'{snr_db} dB')
axis.set(xlabel='measurement [standard deviations of the noise]', ylabel='density')
axis.legend()
plt.show()

# %%
# What helps is time: an object is there in the next frame too, and noise is not. :doc:`Sums along
# paths <plot_3_paths>` make use of that.
