# SPDX-License-Identifier: Apache-2.0
"""
Two objects that cross
======================

Detections, and the tracks that the tracker makes of them, with the ellipses of two standard
deviations that it states. The objects are in the same cell in frame 20, and have one detection for
some frames. It moves both tracks little, so that they keep their velocities, and in this run each
leaves the crossing with its own object. Behind SDT that is so in a part of the runs only.
"""

import lowsnr
from matplotlib.patches import Ellipse
import matplotlib.pyplot as plt
import numpy as np

run = lowsnr.simulate('crossing', snr_db=12)
result = lowsnr.track(run.frames, 'sdt', 12, progress=False)

figure, axis = plt.subplots(figsize=(6.5, 6), layout='constrained')
for name in np.unique(run.truth.id):
    own = run.truth[run.truth.id == name]
    axis.plot(own.x, own.y, color='0.8', lw=5, label=f'truth: {name}')
axis.plot(result.detections.x, result.detections.y, 's', mec='#56B4E9', mfc='none', ms=5,
          label='detections')
for number, colour in zip(np.unique(result.tracks.id), ('#E69F00', '#009E73', '#CC79A7', '0.3')):
    own = result.tracks[result.tracks.id == number]
    axis.plot(own.x, own.y, '.-', color=colour, label=f'track {number}')
    for row in own[::3]:
        axis.add_patch(Ellipse(
            (row.x, row.y), 4 * row.sd_x, 4 * row.sd_y, fc='none', ec=colour, alpha=0.6))
axis.set(xlim=(-0.5, 19.5), ylim=(19.5, -0.5), xlabel='x [pixels]', ylabel='y [pixels]')
axis.legend(fontsize='small')
plt.show()
