# SPDX-License-Identifier: Apache-2.0
r"""
False-alarm rate
================

A detector declares an object where its statistic exceeds a threshold. A low threshold finds more
objects and declares more noise, so that a probability of detection means nothing without the rate
of false alarms at which it was reached. lowsnr states that rate as the *share of empty frames
with any declaration*, and chooses the threshold for it.
"""

import lowsnr
import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import norm

# %%
# For a threshold in every cell (CDT) this is a formula. A cell of white noise exceeds :math:`t`
# standard deviations with the probability :math:`p = Q(t)`, and one of :math:`n` cells does with
# :math:`1 - (1 - p)^n`. Larger frames therefore need higher thresholds for the same rate. The
# simulated thresholds of the detector agree with the formula:

SNR_DB, P_FA = 9, 0.01
intensity = 10 ** (SNR_DB / 20)
sides = (10, 20, 40)
for side in sides:
    exact = norm.isf(1 - (1 - P_FA) ** (1 / side**2))
    found = lowsnr.calibrate((side, side), 'cdt', SNR_DB, false_alarm_prob=P_FA, progress=False)
    simulated = found.threshold / intensity + intensity / 2  # from nat to standard deviations
    print(f'{side} x {side} cells: {exact:.2f} standard deviations, simulated {simulated:.2f}')

# %%
# For all other detectors lowsnr simulates empty frames. The largest statistic of each is kept, and
# the threshold is a quantile of them:

rng = np.random.default_rng(0)
peaks = rng.standard_normal((20_000, 20 * 20)).max(axis=1)
threshold = np.quantile(peaks, 1 - P_FA)
figure, axis = plt.subplots(figsize=(7, 3), layout='constrained')
axis.hist(peaks, 120, color='0.7', density=True)
axis.axvline(threshold, color='#E69F00', label=f'{P_FA:.0%} of the frames lie above')
axis.set(xlabel='strongest of 400 cells of noise [standard deviations]', ylabel='density')
axis.legend()

# %%
# The same threshold decides which objects are found. At 1 % of the frames an object needs about
# 12 dB to be found in half of the frames by one cell; at a laxer rate it needs less:

snrs_db = np.linspace(0, 16, 200)
figure, axis = plt.subplots(figsize=(7, 3.2), layout='constrained')
for share in (0.001, 0.01, 0.1, 0.5):
    bound = norm.isf(1 - (1 - share) ** (1 / 400))
    axis.plot(snrs_db, norm.sf(bound - 10 ** (snrs_db / 20)), label=f'{share:.1%} of empty frames')
axis.set(xlabel='SNR [dB]', ylabel='probability of detection', ylim=(0, 1))
axis.legend(title='CDT, 20 x 20 cells')
plt.show()
