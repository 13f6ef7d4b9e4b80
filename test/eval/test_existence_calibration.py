# SPDX-License-Identifier: Apache-2.0
"""Calibration of the existence that tracks state, against counts done by hand."""

from lowsnr_eval.track_metrics.existence_calibration import ExistenceCalibration
import numpy as np
import pytest
from track_frames import frame

GATE = 1.5
AWAY = (np.nan, np.nan)


def test_calibration_counts_tracks_by_what_they_state():
    metric = ExistenceCalibration(GATE)
    one = {'a': (0.0, 0.0)}
    metric.add(frame(0, one, {'1': (0.5, 0.0), '2': (0.2, 0.0)}, [0.95, 0.55]))  # 2 is nearer
    metric.add(frame(1, one, {'1': (0.0, 0.0), '2': (9.0, 0.0)}, [1.0, 0.5]))
    metric.add(frame(2, {}, {'1': (0.0, 0.0), '2': AWAY}, [0.91, np.nan]))
    found = metric.figures()
    assert found['tracks'] == [0, 0, 0, 0, 0, 2, 0, 0, 0, 3]
    assert found['stated'][5::4] == pytest.approx([0.525, (0.95 + 1.0 + 0.91) / 3])
    assert found['with_object'][5::4] == pytest.approx([1 / 2, 1 / 3])
    assert found['error'] == pytest.approx((abs(1.05 - 1) + abs(2.86 - 1)) / 5)
    assert found['with_object'][0] is None
    assert ExistenceCalibration(GATE).figures()['error'] is None


def test_tracks_that_state_the_truth_are_calibrated(rng):
    metric, stated = ExistenceCalibration(GATE), rng.random(20_000)
    for k, part in enumerate(np.split(stated, 200)):
        tracks = {str(n): (10.0 * n, 0.0) for n in range(len(part))}
        there = rng.random(len(part)) < part
        objects = {name: place for (name, place), has in zip(tracks.items(), there) if has}
        metric.add(frame(k, objects, tracks, part))
    assert metric.figures()['error'] < 0.03  # 4 sigma of 2,000 tracks a bin is 0.045 for each
