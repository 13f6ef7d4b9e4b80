# SPDX-License-Identifier: Apache-2.0
"""
The paper's example
===================

Section VI of the paper has six examples. The fourth is an object that turns back: it is there from
frame 5 to frame 35 of 40. This program runs two detectors on the very same frames of it, as a
graph of ROS nodes, and looks at what they leave.
"""

import csv
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory

import lowsnr
import matplotlib.pyplot as plt

ROOT = Path(lowsnr.__file__).resolve().parents[3]  # the checkout
PLACE = TemporaryDirectory()
RESULTS = Path(PLACE.name, 'run')

# %%
# Sensor, detectors, trackers and evaluator run as one process each. ``--lockstep`` runs as fast as
# the graph answers, and gives the same results every time.


def run(*words: object) -> None:
    """Run a command of the checkout and print what it prints."""
    print(subprocess.run(
        [sys.executable, *map(str, words)], cwd=ROOT, stdout=subprocess.PIPE, text=True,
        check=True).stdout.replace(PLACE.name, ''))


run('scripts/bringup.py', '--scenario', 'example4', '--detector', 'cdt', 'sdt', '--lockstep',
    '--results', RESULTS)

# %%
# Each detector has a row for its detections and one for the tracks that the tracker makes of
# them. The results folder has the same figures as ``summary.json``, what was declared in every
# frame as tables, and a report with the frames as an animation. Here are the tables:

truth = lowsnr.simulate('example4').truth
figure, axes = plt.subplots(1, 2, figsize=(9, 4.6), layout='constrained')
for axis, name in zip(axes, ('detections', 'tracks'), strict=True):
    rows = list(csv.DictReader((RESULTS / f'{name}.csv').open()))
    print(f'{name}.csv: {len(rows)} rows with the columns {", ".join(rows[0])}')
    axis.plot(truth.x, truth.y, color='#009E73', label='truth')
    for detector, mark in (('cdt', 'x'), ('sdt', '.')):
        own = [row for row in rows if row['detector'] == detector]
        axis.plot([float(row['x']) for row in own], [float(row['y']) for row in own], mark,
                  label=detector)
    axis.set(title=name, xlim=(-0.5, 19.5), ylim=(19.5, -0.5), xlabel='x [pixels]')
    axis.legend()

# %%
# The sequential test adds measurements along paths and therefore finds the object where a
# threshold for every cell does not; the tracker drops what leads nowhere.
#
# One run says little. :doc:`Monte Carlo on a cluster <plot_7_cluster>` repeats an example many
# times, and :doc:`Section VI, reproduced </paper>` has the verdict on every claim of the paper.
PLACE.cleanup()
plt.show()
