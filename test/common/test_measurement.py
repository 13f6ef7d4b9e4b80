# SPDX-License-Identifier: Apache-2.0
"""The sensor: eqs. (2) and (3) written out cell by cell, ratios against normal densities."""

from lowsnr_common.core.measurement import SensorModel
import numpy as np
import pytest
from scipy.stats import norm


def blurred(sensor, x, y, shape):
    """Return eq. (2) cell by cell."""
    frame = np.zeros(shape)
    for row, col in np.ndindex(shape):
        dx, dy = col * sensor.cell_size_m - x, row * sensor.cell_size_m - y
        frame[row, col] = (
            sensor.cell_size_m**2 * sensor.intensity / (2 * np.pi * sensor.blur_m**2)
            * np.exp(-(dx**2 + dy**2) / (2 * sensor.blur_m**2)))
    return frame


def log_ratio(frame, signal, noise_std):
    """Return the log of the ratio of the densities with and without the signal."""
    return np.sum(norm.logpdf(frame, signal, noise_std) - norm.logpdf(frame, 0.0, noise_std))


@pytest.mark.parametrize('snr_db', [-3.0, 0.0, 6.0, 12.0])
def test_intensity_has_the_stated_snr(snr_db):
    sensor = SensorModel(snr_db=snr_db, noise_std=2.5)
    assert 10 * np.log10(sensor.intensity**2 / 2.5**2) == pytest.approx(snr_db)


def test_signal_without_blur_is_one_cell(grid_shape):
    sensor = SensorModel(cell_size_m=0.5)
    frame = sensor.signal(np.array([1.6, 9.0, 2.9, 9.0]), grid_shape)  # column 3.2, row 5.8
    assert frame[6, 3] == sensor.intensity
    assert np.count_nonzero(frame) == 1


@pytest.mark.parametrize(('x', 'y'), [(-0.6, 3.0), (2.0, -0.6), (4.5, 3.0), (2.0, 6.5)])
def test_signal_outside_the_frame_is_zero(x, y, grid_shape):
    assert not SensorModel().signal(np.array([x, 0.0, y, 0.0]), grid_shape).any()


@pytest.mark.parametrize('cell_size_m', [1.0, 0.4])
def test_signal_with_blur_is_eq_2(cell_size_m, grid_shape):
    sensor = SensorModel(blur_m=0.7, cell_size_m=cell_size_m, noise_std=1.3)
    signal = sensor.signal(np.array([1.3, 5.0, 1.9, 5.0]), grid_shape)
    np.testing.assert_allclose(signal, blurred(sensor, 1.3, 1.9, grid_shape))


def test_blur_spreads_the_intensity_and_keeps_its_sum():
    sensor = SensorModel(blur_m=1.0)
    total = sensor.signal(np.array([14.3, 0.0, 10.8, 0.0]), (21, 31)).sum()
    assert total == pytest.approx(sensor.intensity, rel=1e-6)


def test_cells_are_row_and_column_of_the_nearest_centre():
    states = np.array([[2.4, 9.0, 0.6, 9.0], [2.5, 9.0, -0.5, 9.0], [-0.6, 9.0, 3.0, 9.0]])
    np.testing.assert_array_equal(SensorModel().cells(states), [[1, 2], [0, 3], [3, -1]])
    half = SensorModel(cell_size_m=0.5).cells(states[0])
    np.testing.assert_array_equal(half, [1, 5])


@pytest.mark.parametrize('noise_std', [1.0, 2.0])
def test_ratio_without_blur_is_that_of_normal_densities(noise_std, rng, grid_shape):
    sensor = SensorModel(snr_db=3.0, noise_std=noise_std)
    frame = noise_std * rng.standard_normal(grid_shape)
    ratio = sensor.log_likelihood_ratio(frame)
    for cell in np.ndindex(grid_shape):
        expected = log_ratio(frame[cell], sensor.intensity, noise_std)
        assert ratio[cell] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize('cell_size_m', [1.0, 0.4])
def test_ratio_with_blur_is_that_of_whole_frames(cell_size_m, rng, grid_shape):
    sensor = SensorModel(blur_m=0.7, noise_std=1.3, cell_size_m=cell_size_m)
    frame = rng.standard_normal(grid_shape)
    ratio = sensor.log_likelihood_ratio(frame)
    for row, col in np.ndindex(grid_shape):
        signal = blurred(sensor, col * cell_size_m, row * cell_size_m, grid_shape)
        # Beyond the reach of 5 blur widths the point spread is below 4e-6 of its peak.
        assert ratio[row, col] == pytest.approx(log_ratio(frame, signal, 1.3), abs=1e-4)


@pytest.mark.parametrize('blur_m', [0.0, 0.8])
def test_ratio_of_a_batch_is_that_of_each_frame(blur_m, rng, grid_shape):
    sensor = SensorModel(blur_m=blur_m)
    frames = rng.standard_normal((2, 3, *grid_shape))
    ratio = sensor.log_likelihood_ratio(frames)
    for index in np.ndindex(2, 3):
        np.testing.assert_array_equal(ratio[index], sensor.log_likelihood_ratio(frames[index]))


def test_reach_of_the_blur_is_counted_in_cells():
    assert SensorModel().blur_reach == 0
    assert SensorModel(blur_m=0.7).blur_reach == 4
    assert SensorModel(blur_m=0.7, cell_size_m=0.5).blur_reach == 7


@pytest.mark.parametrize('values', [
    {'snr_db': 81.0}, {'noise_std': 0.0}, {'blur_m': -0.1}, {'cell_size_m': 0.0},
    {'frame_period_s': 0.0},
])
def test_bad_settings_are_rejected(values):
    name, = values
    with pytest.raises(ValueError, match=rf'^SensorModel\.{name}\b'):
        SensorModel(**values)
