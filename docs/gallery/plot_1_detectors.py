# SPDX-License-Identifier: Apache-2.0
"""
What detectors make of the same frame
=====================================

The statistic of every cell after 20 frames, of which the last 16 hold an object of 7 dB: a
threshold for every cell sees noise, detectors that add frames along paths see the object.
"""

import lowsnr
from lowsnr_common.core.measurement import SensorModel
from lowsnr_detect.detectors.cdt import CDT
from lowsnr_detect.detectors.cusum import CUSUM
from lowsnr_detect.detectors.sdt import SDT
import matplotlib.pyplot as plt
import numpy as np

SNR_DB, FRAME = 7, 20
run = lowsnr.simulate('example4', snr_db=SNR_DB)
sensor, rng = SensorModel(snr_db=SNR_DB), np.random.default_rng(0)
here = run.truth[run.truth.frame == FRAME]
figure, axes = plt.subplots(1, 3, figsize=(10, 3.6), layout='constrained')
for axis, detector in zip(axes, (
        CDT(sensor=sensor), SDT(sensor=sensor, max_iterations=8, beta=1e-9),
        CUSUM(sensor=sensor)), strict=True):
    state = detector.init(run.frames[0].shape)
    for frame in run.frames[:FRAME + 1]:
        state, plane = detector.statistic(state, frame)
    axis.imshow(np.where(np.isfinite(plane), plane, np.nan), cmap='viridis')
    axis.plot(here.x, here.y, 'o', mec='#E69F00', mfc='none', ms=14)
    axis.set(title=type(detector).__name__, xticks=[], yticks=[])
plt.show()
