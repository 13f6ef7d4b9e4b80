# SPDX-License-Identifier: Apache-2.0
"""Log-likelihood ratios in any noise: closed forms, numerical integration, whole frames."""

import math

from lowsnr_common.core.likelihood import cell_log_ratio
from lowsnr_common.core.likelihood import point_log_ratio
from lowsnr_common.core.likelihood import relative_likelihood
from lowsnr_common.core.likelihood import state_log_ratio
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.noise.intensity import draw_offsets_db
from lowsnr_common.noise.settings import Noise
import numpy as np
import pytest
from scipy import integrate
from scipy import stats

SHAPE = (7, 5)
STUDENT, RAYLEIGH = Noise(model='student_t'), Noise(model='rayleigh')
# Density of the amplitude of an object, relative to the stated one.
AMPLITUDES = {
    'swerling1': stats.rayleigh(scale=math.sqrt(0.5)).pdf,
    'swerling2': stats.rayleigh(scale=math.sqrt(0.5)).pdf,
    'swerling3': lambda a: 2.0 * a * stats.gamma.pdf(a**2, 2.0, scale=0.5),
    'swerling4': lambda a: 2.0 * a * stats.gamma.pdf(a**2, 2.0, scale=0.5),
    'unknown': lambda a: (abs(20.0 * math.log10(a)) <= 6.0) / 12.0 * 20.0 / math.log(10.0) / a}


def envelope(z):
    """Return the envelope, of noise of power 1, of a value with mean 0 and variance 1."""
    return math.sqrt(math.pi) / 2.0 + math.sqrt(1.0 - math.pi / 4.0) * z


def frame_ratio(sensor, frame, x, y, amplitude=1.0):
    """Return the log ratio of the densities of a whole frame with an object in (x, y) cells."""
    size, model = sensor.cell_size_m, sensor.noise_model
    signal = amplitude * sensor.signal(np.array([x * size, 0.0, y * size, 0.0]), frame.shape)
    return sum(float(model.log_density(frame[cell], signal[cell])
                     - model.log_density(frame[cell], 0.0))
               for cell in np.ndindex(*frame.shape) if signal[cell] > 1e-6)


@pytest.mark.parametrize('noise', [STUDENT, RAYLEIGH, Noise(model='k'), Noise(model='poisson')])
def test_ratio_of_a_cell_is_that_of_its_densities(noise):
    sensor = SensorModel(noise=noise, noise_std=1.3, snr_db=7.0)
    z, model = np.linspace(-1.5, 20.0, 500).reshape(20, 25), sensor.noise_model
    exact = model.log_density(z, sensor.intensity) - model.log_density(z, 0.0)
    assert sensor.log_likelihood_ratio(z) == pytest.approx(exact, abs=2e-3)


@pytest.mark.parametrize('snr_db', [3.0, 9.0, 20.0])
def test_swerling_1_in_rayleigh_noise_is_the_closed_form(snr_db):
    # The envelope of an object is then Rayleigh distributed, of the sum of both powers.
    power = 10.0 ** (snr_db / 10.0)
    sensor = SensorModel(noise=RAYLEIGH, fluctuation='swerling1', snr_db=snr_db)
    z = np.linspace(-1.8, 12.0, 300)[None]
    exact = envelope(z)**2 * power / (1.0 + power) - math.log1p(power)
    assert sensor.log_likelihood_ratio(z) == pytest.approx(exact, abs=3e-3)


@pytest.mark.parametrize('fluctuation', AMPLITUDES)
@pytest.mark.parametrize('model', ['gaussian', 'student_t'])
def test_ratio_of_an_unknown_intensity_is_the_integral(fluctuation, model):
    sensor = SensorModel(noise=Noise(model=model), fluctuation=fluctuation, snr_db=9.0)
    density, noise = AMPLITUDES[fluctuation], sensor.noise_model
    z = np.array([[-2.0, 0.0, 1.7, 4.0, 9.0]])
    low, high = (10**-0.3, 10**0.3) if fluctuation == 'unknown' else (0.0, 5.0)
    for value, found in zip(z[0], sensor.log_likelihood_ratio(z)[0], strict=True):
        exact = integrate.quad(
            lambda a, value=value: density(a) * math.exp(
                noise.log_density(value, a * sensor.intensity) - noise.log_density(value, 0.0)),
            low, high, limit=200)[0]
        assert found == pytest.approx(math.log(exact), abs=2e-3)


@pytest.mark.parametrize('fluctuation', AMPLITUDES)
def test_power_of_a_fluctuating_object_has_mean_one(fluctuation, rng):
    power = 10.0 ** (np.array([
        draw_offsets_db(fluctuation, 6.0, 4, rng) for _ in range(20_000)]) / 10.0)
    fast = fluctuation in ('swerling2', 'swerling4')
    assert np.all(np.ptp(power, axis=1) > 0.0) if fast else np.all(np.ptp(power, axis=1) == 0.0)
    exact = integrate.quad(
        lambda a: a**2 * AMPLITUDES[fluctuation](a), 0.0, 6.0, points=[10**-0.3, 10**0.3])[0]
    assert power.mean() == pytest.approx(exact, rel=0.03)
    if fluctuation != 'unknown':
        assert exact == pytest.approx(1.0)
        # The variance of the power is 1 in the cases 1 and 2, and 1 / 2 in 3 and 4.
        expected = 1.0 if fluctuation in ('swerling1', 'swerling2') else 0.5
        assert power.var() == pytest.approx(expected, rel=0.08)


def test_constant_intensity_draws_nothing(rng):
    before = rng.bit_generator.state
    assert not draw_offsets_db('constant', 6.0, 5, rng).any()
    assert rng.bit_generator.state == before


@pytest.mark.parametrize('blur_m', [0.5, 0.7, 1.5])
@pytest.mark.parametrize('cell_size_m', [1.0, 0.8])
def test_snr_with_blur_is_that_of_the_energy(blur_m, cell_size_m):
    sensor = SensorModel(blur_m=blur_m, cell_size_m=cell_size_m, snr_db=7.0, noise_std=1.4)
    places = (np.arange(8) + 0.5) / 8 - 0.5
    energy = np.mean([
        np.sum(sensor.signal(
            cell_size_m * np.array([14 + x, 0.0, 14 + y, 0.0]), (29, 29))**2)
        for x in places for y in places])
    assert 10.0 * math.log10(energy / 1.4**2) == pytest.approx(7.0, abs=0.01)
    brightest = sensor.signal(cell_size_m * np.array([14.0, 0.0, 14.0, 0.0]), (29, 29)).max()
    assert sensor.peak_snr_db == pytest.approx(20.0 * math.log10(brightest / 1.4))


@pytest.mark.parametrize(
    'noise', [Noise(), STUDENT, RAYLEIGH, Noise(model='k'), Noise(model='poisson')])
def test_ratio_of_a_point_is_that_of_the_whole_frame(noise, rng):
    sensor = SensorModel(blur_m=0.7, noise_std=1.3, cell_size_m=0.9, noise=noise)
    frame = sensor.draw_noise(SHAPE, rng) + 0.4
    found = point_log_ratio(sensor, frame, 2)
    for row, col in ((0, 0), (5, 3), (6, 9), (13, 4)):
        exact = frame_ratio(sensor, frame, (col + 0.5) / 2 - 0.5, (row + 0.5) / 2 - 0.5)
        # Tables, and cells with less than .005 of the noise, which are left out.
        assert found[row, col] == pytest.approx(exact, abs=1e-3 if noise == Noise() else 0.02)


@pytest.mark.parametrize('noise', [STUDENT, RAYLEIGH, Noise(model='poisson')])
def test_ratio_of_a_blurred_object_that_fluctuates_is_the_integral(noise, rng):
    sensor = SensorModel(blur_m=0.7, noise=noise, fluctuation='swerling2')
    frame = sensor.draw_noise(SHAPE, rng) + 0.4
    nodes, weights = np.polynomial.legendre.leggauss(50)
    amplitudes = 2.2 * (nodes + 1.0)
    ratios = [frame_ratio(sensor, frame, 0, 0, each) for each in amplitudes]
    weights *= 2.2 * AMPLITUDES['swerling2'](amplitudes)
    assert sensor.log_likelihood_ratio(frame)[0, 0] == pytest.approx(
        math.log(np.sum(weights * np.exp(ratios))), abs=0.03)


@pytest.mark.parametrize('noise', [Noise(), STUDENT])
def test_ratio_of_a_cell_is_the_mean_over_its_points(noise, rng):
    sensor = SensorModel(blur_m=0.7, noise=noise)
    frame = rng.standard_normal((2, *SHAPE))
    points = np.exp(point_log_ratio(sensor, frame, 2))
    mean = points.reshape(2, 7, 2, 5, 2).mean(axis=(2, 4))
    assert cell_log_ratio(sensor, frame) == pytest.approx(np.log(mean))
    weight, peak = relative_likelihood(sensor, frame)
    assert np.log(weight) + peak[:, None, None] == pytest.approx(np.log(mean))
    weight, peak = relative_likelihood(sensor, frame, 2)
    assert weight * np.exp(peak)[:, None, None] == pytest.approx(points)


@pytest.mark.parametrize('fluctuation', ['constant', 'swerling3'])
@pytest.mark.parametrize('blur_m', [0.0, 0.8])
@pytest.mark.parametrize('noise', [Noise(), STUDENT])
def test_ratio_of_a_state_is_that_of_the_nearest_point(fluctuation, blur_m, noise, rng):
    sensor = SensorModel(
        blur_m=blur_m, noise=noise, fluctuation=fluctuation, cell_size_m=1.5)
    frame, states = rng.standard_normal(SHAPE), np.zeros((60, 4))
    states[:, [0, 2]] = 1.5 * rng.uniform(-0.9, [4.9, 6.9], (60, 2))
    found = state_log_ratio(sensor, frame, states)
    points = point_log_ratio(sensor, frame, 4)
    for state, ratio in zip(states, found, strict=True):
        col, row = np.floor(4.0 * (state[[0, 2]] / 1.5 + 0.5)).astype(int)
        if not (0 <= row < 28 and 0 <= col < 20):
            assert ratio == -np.inf
        elif not sensor.is_normal:
            assert ratio == points[row, col]


def test_amplitudes_are_those_of_all_cells_of_an_object(rng):
    sensor = SensorModel(blur_m=0.7, fluctuation='swerling1', snr_db=9.0)
    frame, sure = rng.standard_normal(SHAPE) + 0.5, SensorModel(blur_m=0.7, snr_db=9.0)
    signal = sure.signal(np.array([2.0, 0.0, 3.0, 0.0]), SHAPE)
    matched, energy = np.sum(frame * signal), np.sum(signal**2)
    exact = integrate.quad(
        lambda a: AMPLITUDES['swerling1'](a) * math.exp(a * matched - a**2 * energy / 2.0),
        0.0, 5.0)[0]
    assert sensor.log_likelihood_ratio(frame)[3, 2] == pytest.approx(math.log(exact), abs=1e-3)


@pytest.mark.parametrize('noise', [STUDENT, RAYLEIGH, Noise(model='k'), Noise(model='poisson')])
def test_standardised_noise_has_mean_zero_and_variance_one(noise, rng):
    sensor = SensorModel(noise=noise, noise_std=1.3)
    frame = sensor.draw_noise((300, 300), rng)
    found = sensor.standardised(frame)
    assert found.mean() == pytest.approx(0.0, abs=0.02)
    assert found.std() == pytest.approx(1.0, abs=0.02)
    plain = SensorModel(noise_std=1.3)
    assert np.array_equal(plain.standardised(frame), frame / 1.3)


@pytest.mark.parametrize('values', [
    {'noise': STUDENT, 'snr_db': 31.0}, {'fluctuation': 'swerling2', 'snr_db': 31.0}])
def test_bright_objects_have_no_table(values):
    with pytest.raises(ValueError, match=r'^SensorModel\.snr_db = 31\b'):
        SensorModel(**values)
