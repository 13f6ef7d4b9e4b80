# SPDX-License-Identifier: Apache-2.0
"""CUSUM keeps the best path of any start, and stops declaring an object that has gone."""

from dataclasses import replace
import itertools

from lowsnr_common.core.measurement import SensorModel
from lowsnr_detect.detectors.cusum import CUSUM
from lowsnr_detect.parts.moves import move_model
import numpy as np
import pytest

SHAPE = (4, 3)
SENSOR = SensorModel(snr_db=4.0)


def best_sum(ratio, model, drift):
    """Return the largest sum over every path and start that ends in each cell."""
    log_move = dict(zip(map(tuple, model.moves), np.log(model.kernel.ravel())))
    best = np.full(ratio.shape[1:], -np.inf)
    for count in range(1, len(ratio) + 1):
        for cell in np.ndindex(*SHAPE):
            for sequence in itertools.product(log_move, repeat=count - 1):
                path = np.cumsum([cell, *sequence], axis=0)
                if np.any(path < 0) or np.any(path >= SHAPE):
                    continue
                total = sum(ratio[(k - count, *where)] for k, where in enumerate(path))
                total += sum(log_move[move] - drift for move in sequence)
                end = tuple(path[-1])
                best[end] = max(best[end], total)
    return best


@pytest.mark.parametrize('drift', [0.0, 0.4])
def test_sum_is_the_best_over_all_paths_and_starts(rng, drift):
    detector = CUSUM(sensor=SENSOR, drift=drift, threshold=100.0)
    frames = rng.standard_normal((4, *SHAPE)) + 0.5
    state = detector.init(SHAPE)
    for frame in frames:
        state, declared = detector.step(state, frame, None)
    model = move_model(detector.motion, SENSOR, 0)
    expected = best_sum(SENSOR.log_likelihood_ratio(frames), model, drift)
    assert state == pytest.approx(expected)
    assert declared.peak == pytest.approx(expected.max())


def test_outlier_is_declared_for_a_few_frames_only():
    detector = CUSUM(sensor=SENSOR, threshold=6.0, headroom=5.0)
    frame = np.zeros((9, 9))
    frame[4, 4] = 1e6
    state, declared = detector.step(detector.init(frame.shape), frame, None)
    assert declared.any
    for _ in range(6):
        state, declared = detector.step(state, np.zeros((9, 9)), None)
    assert not declared.any


def test_position_is_the_centroid_of_the_sums_around(rng):
    sensor = SensorModel(snr_db=6.0, cell_size_m=2.0)
    detector = CUSUM(sensor=sensor, threshold=3.0, thinning_reach=10)
    frames = 0.3 * rng.standard_normal((3, 9, 7))
    frames[:, 3, 2] += 2.0
    state = detector.init((9, 7))
    for frame in frames:
        state, declared = detector.step(state, frame, None)
    window = np.exp(state[1:6, 0:5] - state.max())
    weight = window / window.sum()
    rows, cols = np.mgrid[1:6, 0:5]
    x, y = 2.0 * (weight * cols).sum(), 2.0 * (weight * rows).sum()
    assert declared.state[0, [0, 2]] == pytest.approx([x, y])
    assert declared.cov[0, 0, 0] == pytest.approx(
        (weight * (2.0 * cols - x)**2).sum() + 4.0 / 12.0)
    assert declared.cov[0, 0, 2] == pytest.approx(
        (weight * (2.0 * cols - x) * (2.0 * rows - y)).sum())
    assert np.isnan(declared.state[0, [1, 3]]).all()
    assert np.isnan(declared.cov[0, 1]).all()


def test_centroid_at_the_edge_of_the_frame_stays_inside():
    frame = np.zeros((5, 7))
    frame[0, 6] = 9.0
    detector = replace(CUSUM(sensor=SENSOR), threshold=3.0)
    _, declared = detector.step(detector.init(frame.shape), frame, None)
    assert declared.state[0, 0] == pytest.approx(6.0, abs=0.01)
    assert declared.state[0, 2] == pytest.approx(0.0, abs=0.01)
