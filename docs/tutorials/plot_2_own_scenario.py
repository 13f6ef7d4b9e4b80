# SPDX-License-Identifier: Apache-2.0
"""
Your own scenario
=================

A scenario is a YAML file: the size of the frames, their number, and the objects with their paths
and SNRs. :doc:`Those that come with lowsnr </generated/scenarios>` explain every key.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import lowsnr
import matplotlib.pyplot as plt
import numpy as np

SCENARIO = """
description: one object that passes, and one that circles
frames: 50
rows: 32
cols: 48
snr_db: 9.0
objects:
  - id: passes
    first_frame: 5
    last_frame: 50
    waypoints:
      - {frame: 5, x_m: 3.0, y_m: 26.0}
      - {frame: 50, x_m: 36.0, y_m: 22.0}
  - id: circles
    first_frame: 10
    last_frame: 45
    start: {x_m: 30.0, y_m: 12.0, heading_deg: 180.0}
    legs:
      - {until_frame: 45, speed_mps: 0.7, turn_rate_deg_s: 8.0}
"""

# %%
# The library takes the file as it is. A value that is wrong is named in one line.

with TemporaryDirectory() as place:
    path = Path(place, 'two.yaml')
    path.write_text(SCENARIO)
    run = lowsnr.simulate(path)
    path.write_text(SCENARIO.replace('last_frame: 45', 'last_frame: 5'))
    try:
        lowsnr.simulate(path)
    except ValueError as error:
        print(str(error).replace(place, ''))

# %%
# Detect and track, and compare with the truth:

result = lowsnr.track(run.frames, 'sdt', run.snr_db, progress=False)
figure, axis = plt.subplots(figsize=(8, 5), layout='constrained')
axis.imshow(run.frames[-1], cmap='gray', vmin=-3, vmax=5)
for name in np.unique(run.truth.id):
    own = run.truth[run.truth.id == name]
    axis.plot(own.x, own.y, color='#009E73', lw=4, alpha=0.6, label=f'truth: {name}')
for number in np.unique(result.tracks.id):
    own = result.tracks[result.tracks.id == number]
    axis.plot(own.x, own.y, '.-', label=f'track {number}')
axis.set(xlabel='x [pixels]', ylabel='y [pixels]')
axis.legend(loc='lower left')

# %%
# The graph takes the same file: ``python scripts/bringup.py --scenario two.yaml --detector sdt``.
plt.show()
