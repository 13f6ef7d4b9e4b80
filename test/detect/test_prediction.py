# SPDX-License-Identifier: Apache-2.0
"""What filters of one object say they expected, against the filter after a frame of no news."""

from lowsnr_common.core.measurement import SensorModel
from lowsnr_detect.parts.local_estimate import best_cells
from lowsnr_detect.parts.local_estimate import by_cell
from lowsnr_detect.parts.registry import detector_class
import numpy as np
import pytest
import scipy

SHAPE, SENSOR = (8, 11), SensorModel(snr_db=7.0)


def mass_of(belief):
    """Return the probability of every point given existence, (rows, cols)."""
    if hasattr(belief, 'given'):
        return belief.given.sum(axis=(0, 1, 2))
    return belief.mass


@pytest.mark.parametrize(('name', 'settings'), [
    ('hmm', {'order': 1}), ('hmm', {'order': 2}), ('pmf', {'headings': 8, 'resolution': 1}),
    ('pmf', {'headings': 8, 'resolution': 2})])
def test_prediction_is_the_posterior_without_news(rng, name, settings):
    detector = detector_class(name)(sensor=SENSOR, threshold=-1e9, **settings)
    state = detector.init(SHAPE)
    neutral = np.full(SHAPE, SENSOR.intensity / 2.0)  # no more likely with than without an object
    for k in range(5):
        frame = rng.standard_normal(SHAPE)
        frame[3, 2 + k] += 2.0
        (_, unmoved), before = detector.step(state, neutral, None), state
        state, declared = detector.step(before, frame, None)
        prior, after = (
            by_cell(mass_of(memory[-1])[None], settings.get('resolution', 1))
            for memory in (detector.step(before, neutral, None)[0], state))
        row, col = best_cells(after)[0]
        window = np.s_[max(row - 1, 0):row + 2, max(col - 1, 0):col + 2]
        prob = prior[0][window]
        ratio = np.exp(SENSOR.log_likelihood_ratio(frame))[window]
        # The odds of an object in these cells rise by the mean likelihood ratio in them.
        expected = declared.peak - np.log(np.sum(prob * ratio) / prob.sum())
        predicted = declared.estimates()[0].predicted
        assert scipy.special.logit(predicted.score) == pytest.approx(expected)
        assert unmoved.peak > -np.inf
        places = np.stack(np.indices(SHAPE)[::-1], axis=-1)[window]
        if settings.get('resolution', 1) == 1:
            mean = np.average(places.reshape(-1, 2), axis=0, weights=prob.ravel())
            assert predicted.position == pytest.approx(mean)
            assert predicted.cov == pytest.approx(np.cov(
                places.reshape(-1, 2).T, aweights=prob.ravel(), ddof=0) + np.eye(2) / 12.0)


@pytest.mark.parametrize('name', ['hmm', 'pmf'])
def test_answer_with_a_lag_has_no_prediction(rng, name):
    detector = detector_class(name)(sensor=SENSOR, threshold=-1e9, lag=1)
    state = detector.init(SHAPE)
    for _ in range(3):
        state, declared = detector.step(state, rng.standard_normal(SHAPE), None)
    assert declared.any
    assert declared.predicted is None
