# SPDX-License-Identifier: Apache-2.0
"""Simulated frames: moments of the noise, SNR of the objects, equal bytes for equal seeds."""

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.records import Truth
from lowsnr_common.noise.settings import Noise
from lowsnr_sensor.simulator import fluctuating
from lowsnr_sensor.simulator import simulate_frame
from lowsnr_sensor.simulator import simulate_frames
import numpy as np
import pytest

NEAR = Truth('near', np.array([1.0, 0.0, 5.0, 0.0]))
FAINT = Truth('faint', np.array([3.0, 0.0, 2.0, 0.0]), snr_offset_db=-4.0)
RUNS = 4_000


def test_empty_frames_hold_gaussian_noise(rng, grid_shape):
    frames = simulate_frames(RUNS * [[]], SensorModel(noise_std=1.7), grid_shape, rng)
    frames = frames.astype(float)
    count = frames.size
    assert abs(frames.mean()) < 4 * 1.7 / np.sqrt(count)
    assert abs(frames.var() / 1.7**2 - 1.0) < 4 * np.sqrt(2 / count)
    # Var of the sample kurtosis of Gaussians: 24 / n.
    assert abs(np.mean((frames / 1.7) ** 4) - 3.0) < 4 * np.sqrt(96 / count)


def test_noise_is_independent_between_cells_and_frames(rng, grid_shape):
    frames = simulate_frames(RUNS * [[]], SensorModel(), grid_shape, rng).astype(float)
    for shifted, rest in [(frames[1:], frames[:-1]), (frames[:, 1:], frames[:, :-1]),
                          (frames[..., 1:], frames[..., :-1])]:
        assert abs(np.mean(shifted * rest)) < 4 / np.sqrt(rest.size)


def test_objects_have_the_given_snr(rng, grid_shape):
    sensor = SensorModel(snr_db=6.0, noise_std=0.8)
    frames = simulate_frames(RUNS * [[NEAR, FAINT]], sensor, grid_shape, rng).astype(float)
    expected = np.zeros(grid_shape)
    expected[5, 1], expected[2, 3] = 0.8 * 10 ** (6 / 20), 0.8 * 10 ** (2 / 20)
    # 35 cells at 4 sigma: the test fails by chance for 0.2 % of seeds.
    assert np.all(abs(frames.mean(axis=0) - expected) < 4 * 0.8 / np.sqrt(RUNS))


@pytest.mark.parametrize('blur_m', [0.0, 0.8])
def test_objects_add_up_on_the_same_noise(blur_m, grid_shape):
    sensor = SensorModel(blur_m=blur_m)

    def frame(objects):
        return simulate_frame(objects, sensor, grid_shape, np.random.default_rng(3))

    signal = sensor.signal(NEAR.state, grid_shape) + 10 ** (-4 / 20) * sensor.signal(
        FAINT.state, grid_shape)
    np.testing.assert_allclose(frame([NEAR, FAINT]) - frame([]), signal, atol=1e-6)


def test_counts_of_photons_have_a_variance_that_grows_with_the_object(rng, grid_shape):
    sensor = SensorModel(noise=Noise(model='poisson', background=9.0), noise_std=2.0)
    frames = simulate_frames(RUNS * [[NEAR]], sensor, grid_shape, rng).astype(float)
    counts = 9.0 + 3.0 * frames / 2.0
    assert np.allclose(counts, np.rint(counts), atol=1e-4)
    mean, other = counts[:, 5, 1], counts[:, 0, 0]
    expected = 9.0 + 3.0 * 10 ** (6 / 20)
    assert abs(mean.mean() - expected) < 4 * np.sqrt(expected / RUNS)
    assert abs(mean.var() / expected - 1.0) < 4 * np.sqrt(2.5 / RUNS)
    assert abs(other.var() / 9.0 - 1.0) < 4 * np.sqrt(2.5 / RUNS)


def test_objects_fluctuate_each_on_its_own(rng):
    truth = 200 * [[NEAR, FAINT]]
    for fluctuation, fast in (('swerling1', False), ('swerling2', True), ('unknown', False)):
        sensor = SensorModel(fluctuation=fluctuation)
        found = fluctuating(truth, sensor, rng)
        near, faint = np.array([[item.snr_offset_db for item in each] for each in found]).T
        assert np.unique(near).size == (200 if fast else 1)
        assert not np.intersect1d(near, faint + 4.0).size
    assert fluctuating(truth, SensorModel(), rng) == truth


def test_same_seed_gives_the_same_bytes(grid_shape):
    def run(seed):
        truth = [[NEAR], [], [NEAR, FAINT]]
        rng = np.random.default_rng(seed)
        return simulate_frames(truth, SensorModel(), grid_shape, rng)

    assert run(5).tobytes() == run(5).tobytes()
    assert run(5).tobytes() != run(6).tobytes()


def test_run_equals_frames_simulated_one_by_one(grid_shape):
    truth, sensor = [[NEAR], [], [FAINT]], SensorModel(blur_m=0.5)
    run = simulate_frames(truth, sensor, grid_shape, np.random.default_rng(9))
    rng = np.random.default_rng(9)
    singly = [simulate_frame(objects, sensor, grid_shape, rng) for objects in truth]
    assert run.dtype == np.float32
    np.testing.assert_array_equal(run, singly)
