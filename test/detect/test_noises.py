# SPDX-License-Identifier: Apache-2.0
"""Detectors in other noise than Gaussian: false alarms, error rates and objects."""

from dataclasses import replace

from detect import contract
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.noise.settings import Noise
from lowsnr_common.settings.flat_values import flat_values
from lowsnr_detect.calibration.empty_frames import empty_frame_peaks
from lowsnr_detect.calibration.empty_frames import Simulation
from lowsnr_detect.calibration.operating_point import calibrate
from lowsnr_detect.calibration.operating_point import curve
from lowsnr_detect.calibration.operating_point import known_curve
from lowsnr_detect.detectors.cdt import CDT
from lowsnr_detect.detectors.cusum import CUSUM
from lowsnr_detect.parts.registry import detector_class
from lowsnr_detect.parts.registry import DETECTORS
import numpy as np
import pytest
from scipy import stats

detector_class('cdt')  # imports the detectors, which register themselves
SHAPE = (7, 5)
NOISES = {
    'student_t': Noise(model='student_t'), 'rayleigh': Noise(model='rayleigh'),
    'k': Noise(model='k'), 'poisson': Noise(model='poisson')}
EACH = [(name, list(NOISES)[number % 4]) for number, name in enumerate(sorted(DETECTORS))]


@pytest.mark.parametrize(('name', 'noise'), [
    ('cdt', 'poisson'), ('sdt', 'student_t'), ('cusum', 'k'), ('bank', 'k'),
    ('hmm', 'rayleigh'), ('tbd2', 'student_t')])
def test_false_alarms_are_at_the_calibrated_probability(name, noise):
    sensor = SensorModel(noise=NOISES[noise])
    detector = contract.make(DETECTORS[name], sensor=sensor)
    prob, runs, frames = 0.05, 100, 20
    found = calibrate(detector, prob, SHAPE, runs=runs, frames=frames)
    tuned = replace(detector, threshold=found.threshold)
    peaks = empty_frame_peaks(tuned, Simulation(runs, frames, SHAPE, contract.SEED))
    alarms = (peaks > found.threshold).mean(axis=1)
    assert abs(alarms.mean() - prob) < 4.0 * alarms.std() * np.sqrt(2.0 / runs)
    assert alarms.mean() > 0.0


@pytest.mark.parametrize(('name', 'noise'), EACH)
def test_bright_object_is_found_where_it_is(name, noise, rng):
    sensor = SensorModel(noise=NOISES[noise], snr_db=18.0, blur_m=0.5)
    errors = []
    for speed in (0.0, 1.0):
        truth = np.array([[1.0, 0.0, 5.0 - (9 - k) * speed / 2, speed / 2] for k in range(10)])
        frames = np.stack([
            sensor.noise_model.draw(sensor.signal(state, SHAPE), rng) for state in truth])
        detector = contract.make(DETECTORS[name], sensor=sensor, threshold=3.0)
        declared = contract.run(detector, frames)[-1]
        errors.append(np.hypot(*(declared.state[0, [0, 2]] - truth[-1, [0, 2]])))
    assert np.nanmin(errors) < 1.0


def test_threshold_for_gaussian_noise_is_none_for_another(rng):
    plain = CUSUM(sensor=SensorModel())
    threshold = calibrate(plain, 0.05, SHAPE, runs=100, frames=20).threshold
    sensor = SensorModel(noise=NOISES['student_t'])
    memory, alarms = plain.init((100, *SHAPE)), []
    plain = replace(plain, threshold=threshold)
    for _ in range(20):
        memory, declared = plain.step(memory, sensor.draw_noise((100, *SHAPE), rng), rng)
        alarms.append(declared.any)
    assert np.mean(alarms) > 0.15


def test_error_rates_in_rayleigh_noise_are_those_of_rice(rng):
    # The squared envelope is chi-squared, central without and not central with an object.
    sensor = SensorModel(noise=NOISES['rayleigh'], snr_db=9.0)
    alpha, trials, power = 0.02, 40_000, 10.0**0.9
    bound = np.sqrt(stats.chi2.isf(alpha, 2) / 2.0)
    z = (bound - np.sqrt(np.pi) / 2.0) / np.sqrt(1.0 - np.pi / 4.0)
    detector = CDT(sensor=sensor, threshold=float(
        sensor.log_likelihood_ratio(np.array([[z]]))[0, 0]))
    exact = stats.ncx2.sf(2.0 * bound**2, 2, 2.0 * power)
    for signal, expected in ((0.0, alpha), (sensor.intensity, exact)):
        cells = sensor.noise_model.draw(np.full((trials, 1, 1), signal), rng)
        _, declared = detector.step(None, cells, rng)
        error = np.sqrt(expected * (1.0 - expected) / trials)
        assert abs(declared.any.mean() - expected) < 4.0 * error


def test_error_rates_in_student_t_noise_are_integrals(rng):
    # The ratio is largest near the object and falls beyond it: the test declares an interval.
    sensor = SensorModel(noise=NOISES['student_t'])
    detector, trials = CDT(sensor=sensor, threshold=1.5), 40_000
    z = np.linspace(-40.0, 60.0, 400_001)
    own = stats.t(4, scale=np.sqrt(0.5))
    declares = own.logpdf(z - sensor.intensity) - own.logpdf(z) > 1.5
    assert np.sum(np.diff(declares)) == 2  # an interval
    for signal in (0.0, sensor.intensity):
        low, high = z[declares][[0, -1]] - signal
        expected = own.cdf(high) - own.cdf(low)
        cells = sensor.noise_model.draw(np.full((trials, 1, 1), signal), rng)
        _, declared = detector.step(None, cells, rng)
        error = np.sqrt(expected * (1.0 - expected) / trials)
        assert abs(declared.any.mean() - expected) < 4.0 * error


@pytest.mark.parametrize(('key', 'value'), [
    ('noise', Noise(model='student_t')), ('noise', Noise(degrees_of_freedom=5.0)),
    ('fluctuation', 'swerling2')])
def test_key_of_a_stored_calibration_contains_the_noise(tmp_path, key, value):
    size = {'folder': tmp_path, 'runs': 4, 'frames': 5}
    detector = CDT(sensor=SensorModel())
    curve(detector, SHAPE, **size)
    assert known_curve(detector, SHAPE, **size) is not None
    other = replace(detector, sensor=replace(detector.sensor, **{key: value}))
    assert flat_values(other) != flat_values(detector)
    assert known_curve(other, SHAPE, **size) is None
