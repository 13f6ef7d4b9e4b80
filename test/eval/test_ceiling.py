# SPDX-License-Identifier: Apache-2.0
"""The ceiling of P_D, against the test itself on simulated frames, and against the limits."""

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.noise.settings import Noise
from lowsnr_eval.report.ceiling import ceiling
from lowsnr_eval.report.ceiling import has_ceiling
import numpy as np
import pytest


@pytest.mark.parametrize('snr_db', [-3.0, 3.0, 9.0])
@pytest.mark.parametrize('pfa', [0.01, 0.2])
def test_ceiling_is_the_share_that_the_test_of_a_known_path_detects(snr_db, pfa, rng):
    """200,000 runs: the standard error of a share is at most 0.0011, of the mean of six less."""
    sensor, frames, runs = SensorModel(snr_db=snr_db, noise_std=2.0), 6, 200_000
    noise = sensor.noise_std * rng.standard_normal((runs, frames))
    seen = np.cumsum(noise + sensor.intensity, axis=1)
    empty = np.cumsum(sensor.noise_std * rng.standard_normal((runs, frames)), axis=1)
    thresholds = np.quantile(empty, 1.0 - pfa, axis=0)
    assert ceiling(sensor, np.array(pfa), frames) == pytest.approx(
        np.mean(seen > thresholds), abs=0.006)


def test_ceiling_of_hardly_any_signal_is_the_false_alarm_rate_and_rises_with_both():
    pfa = np.geomspace(1e-4, 0.9, 20)
    assert ceiling(SensorModel(snr_db=-30.0), pfa, 1) == pytest.approx(pfa, rel=0.15)
    curves = [ceiling(SensorModel(snr_db=snr), pfa, 9) for snr in (0.0, 3.0, 6.0)]
    assert (np.diff(curves, axis=0) > 0.0).all()
    assert (np.diff(curves, axis=1) > 0.0).all()


@pytest.mark.parametrize('sensor', [
    SensorModel(blur_m=0.7), SensorModel(fluctuation='swerling1'),
    SensorModel(noise=Noise(model='student_t'))])
def test_other_sensors_have_no_such_ceiling(sensor):
    assert has_ceiling(SensorModel())
    assert not has_ceiling(sensor)
