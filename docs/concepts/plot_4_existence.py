# SPDX-License-Identifier: Apache-2.0
r"""
Existence
=========

A filter that knows how objects move carries two things from frame to frame: the probability that
there is an object at all, and where it is if there is one. Before a frame the probability of
existence moves by birth and death,

.. math:: P_{k|k-1} = (1 - P_d)\,P_{k-1} + P_b\,(1 - P_{k-1}),

and the frame changes its odds by the likelihood ratio of the whole frame. No single frame has to
show the object: evidence adds up.
"""

import lowsnr
from lowsnr_common.core.measurement import SensorModel
from lowsnr_detect.detectors.hmm import HMM
import matplotlib.pyplot as plt
import numpy as np

# %%
# The grid filter (HMM) at 6 dB. The object is there in the shaded frames. The filter is surer
# the longer the object is there, and forgets it after it has gone.

SNR_DB = 6
run = lowsnr.simulate('example4', snr_db=SNR_DB, seed=1)
detector = HMM(sensor=SensorModel(snr_db=SNR_DB))
state, rng = detector.init(run.frames[0].shape), np.random.default_rng(0)
existence = []
for frame in run.frames:
    state, declared = detector.step(state, frame, rng)
    existence.append(1 / (1 + np.exp(-declared.peak)))  # the peak is the log odds

figure, axis = plt.subplots(figsize=(7, 3), layout='constrained')
axis.axvspan(run.truth.frame.min(), run.truth.frame.max(), color='0.9')
axis.plot(existence, label='grid filter, 6 dB')
axis.set(xlabel='frame', ylabel='probability of existence', ylim=(0, 1))
axis.legend()

# %%
# Tracks have such a probability too, in the column ``score``: the tracker confirms a track at
# 0.5, when its object is more likely there than not. Below 0.3 it publishes it no longer, and at
# 0.005 it deletes it.

bright = lowsnr.simulate('example4', snr_db=9)
result = lowsnr.track(bright.frames, 'sdt', 9, progress=False)
figure, axis = plt.subplots(figsize=(7, 3), layout='constrained')
axis.axvspan(bright.truth.frame.min(), bright.truth.frame.max(), color='0.9')
for number in np.unique(result.tracks.id):
    own = result.tracks[result.tracks.id == number]
    axis.plot(own.frame, own.score, '.-', label=f'track {number}')
axis.set(xlabel='frame', ylabel='probability of existence', ylim=(0, 1))
axis.legend()
plt.show()
