# SPDX-License-Identifier: Apache-2.0
"""CDT has the closed form of a threshold on a normal number."""

from lowsnr_common.core.measurement import SensorModel
from lowsnr_detect.calibration.operating_point import calibrate
from lowsnr_detect.detectors.cdt import CDT
import numpy as np
import pytest
from scipy.stats import norm

SHAPE = (7, 5)


def test_detection_probability_is_that_of_theory(rng):
    # P_D = Q(Q^-1(alpha) - I / sigma) for a threshold on z of Q^-1(alpha) sigma.
    sensor = SensorModel(snr_db=9.0, noise_std=2.0)
    alpha, trials = 0.003, 4000
    bound = 2.0 * norm.isf(alpha)
    detector = CDT(
        sensor=sensor, threshold=sensor.intensity * (2 * bound - sensor.intensity) / 8.0)
    frames = 2.0 * rng.standard_normal((trials, *SHAPE))
    frames[:, 4, 1] += sensor.intensity
    _, declared = detector.step(None, frames, None)
    hit = np.any((declared.state[..., 0] == 1.0) & (declared.state[..., 2] == 4.0), axis=-1)
    exact = norm.sf(norm.isf(alpha) - sensor.intensity / 2.0)
    assert hit.mean() == pytest.approx(exact, abs=4 * np.sqrt(exact * (1 - exact) / trials))
    false = np.count_nonzero(declared.score) - np.count_nonzero(hit)
    assert false / trials / 34 == pytest.approx(alpha, abs=4 * np.sqrt(alpha / trials / 34))


@pytest.mark.parametrize(('shape', 'prob'), [((7, 5), 0.05), ((20, 20), 1e-3), ((256, 200), 0.01)])
def test_calibrated_threshold_is_that_of_theory(shape, prob):
    # No alarm in any cell: (1 - alpha)^cells = 1 - P_FA.
    sensor = SensorModel(snr_db=6.0)
    found = calibrate(CDT(sensor=sensor), prob, shape, runs=250)
    alpha = -np.expm1(np.log1p(-prob) / (shape[0] * shape[1]))
    exact = sensor.intensity * norm.isf(alpha) - sensor.intensity**2 / 2.0
    low, high = found.interval
    assert found.threshold == pytest.approx(exact, abs=1.2 * (high - low))
    assert low < found.threshold < high
