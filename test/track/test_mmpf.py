# SPDX-License-Identifier: Apache-2.0
"""The multiple-model particle filter against Kalman filters and the Markov chain itself."""

from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import process_noise_cov
from lowsnr_track.mmpf import predict
from lowsnr_track.mmpf import resample
from lowsnr_track.mmpf import update
from lowsnr_track.particles import concatenate
from lowsnr_track.particles import equally_weighted
from lowsnr_track.particles import Particles
import numpy as np
import pytest
from track import oracles

MEAN = np.array([3.0, 0.4, 5.0, -0.2])
COV = np.diag([0.5, 0.04, 0.3, 0.09])
NOISE = np.array([[0.4, 0.1], [0.1, 0.3]])


def gaussian_particles(count, motion, rng):
    states = rng.multivariate_normal(MEAN, COV, size=(1, count))
    return equally_weighted(states, rng.integers(motion.count, size=(1, count)))


def log_likelihood(particles, z):
    offset = np.asarray(z) - particles.states[..., POS]
    exponent = -0.5 * np.einsum('...i,ij,...j', offset, np.linalg.inv(NOISE), offset)
    return exponent - 0.5 * np.log(np.linalg.det(2 * np.pi * NOISE))


def test_single_mode_filter_matches_kalman_filter(rng):
    motion = MotionModes(turn_rates_deg_s=(0.0,), acceleration_density=0.01)
    matrix, noise = motion.transition_matrices(0.7)[0], process_noise_cov(0.7, 0.01)
    count = 50_000
    particles, kalman = gaussian_particles(count, motion, rng), oracles.gaussian(MEAN, COV, 1)
    for _ in range(8):
        kalman = oracles.predict(kalman, matrix[None], noise, np.ones((1, 1)))
        z = rng.multivariate_normal(oracles.H @ kalman.mean[0], NOISE)
        kalman, likelihood = oracles.update(kalman, [z], NOISE, 1.0, 1.0)
        mean, cov = kalman.moments()
        particles = predict(particles, motion, 0.7, 1, rng)
        particles, log_evidence = update(particles, log_likelihood(particles, z))
        found_mean, found_cov = particles.moments
        particles = resample(particles, 0.5, 0.5, 1.0, rng)
        # Effective sizes stay above N / 10; five standard errors of a mean and a variance.
        error = 5 * np.sqrt(10 / count)
        std = np.sqrt(np.diag(cov))
        assert np.all(abs(found_mean[0] - mean) < error * std)
        assert np.all(abs(found_cov[0] - cov) < error * 1.5 * np.outer(std, std))
        assert log_evidence[0] == pytest.approx(np.log(likelihood), abs=error)


def test_mode_probabilities_match_exact_mixture(rng):
    motion = MotionModes(
        turn_rates_deg_s=(0.0, 40.0, -40.0), mode_sojourn_s=4.0, acceleration_density=0.01)
    matrices, chain = motion.transition_matrices(1.0), motion.mode_transition(1.0)
    truth = np.array([[3.3, 5.0], [3.8, 5.2], [4.1, 5.6], [4.1, 6.1], [3.9, 6.5]])
    count, runs = 20_000, 4
    particles = gaussian_particles(count * runs, motion, rng)
    particles = Particles(*(part.reshape(runs, count, *part.shape[2:]) for part in (
        particles.states, particles.modes, particles.log_weights + np.log(runs))))
    mixture = oracles.gaussian(MEAN, COV, 3)
    noise = NOISE / 10
    for z in truth:
        mixture = oracles.predict(mixture, matrices, process_noise_cov(1.0, 0.01), chain)
        mixture, _ = oracles.update(mixture, [z], noise, 1.0, 1.0)
        particles = predict(particles, motion, 1.0, 1, rng)
        particles, _ = update(particles, 10 * log_likelihood(particles, z))
        found = particles.mode_probabilities(3)
        mean = particles.moments[0].mean(axis=0)
        particles = resample(particles, 0.5, 0.5, 0.0, rng)
        # The effective sizes stay above N / 50: 4 standard errors of four filters.
        assert found.mean(axis=0) == pytest.approx(
            mixture.modes(3), abs=4 * 0.5 / np.sqrt(count * runs / 50))
        assert mean == pytest.approx(mixture.moments()[0], abs=0.03)


def test_flat_likelihood_leaves_the_modes_to_the_markov_chain(rng):
    motion = MotionModes(mode_sojourn_s=3.0)
    count, steps = 40_000, 6
    particles = equally_weighted(np.zeros((1, count, 4)), np.zeros((1, count), dtype=int))
    for k in range(1, steps + 1):
        particles = predict(particles, motion, 1.0, 1, rng)
        particles, _ = update(particles, np.full((1, count), -7.0))
        particles = resample(particles, 1.0, 0.5, 2.0, rng)
        expected = np.linalg.matrix_power(motion.mode_transition(1.0), k)[0]
        error = 4 * np.sqrt(expected * (1 - expected) / count)
        assert np.all(abs(particles.mode_probabilities(3)[0] - expected) < error)


def test_filter_of_high_effective_size_is_not_resampled(rng):
    motion = MotionModes()
    high, low = gaussian_particles(100, motion, rng), gaussian_particles(100, motion, rng)
    low, _ = update(low, np.where(np.arange(100) < 10, 0.0, -np.inf)[None])
    both = concatenate(high, low)
    after = resample(both, 0.5, 1.0, 1.0, rng)
    assert np.array_equal(after.states[0], both.states[0])
    assert after.log_weights[1] == pytest.approx(-np.log(100))
    assert len(np.unique(after.states[1], axis=0)) == 100


@pytest.mark.parametrize('power', [0.3, 1.0])
def test_resampling_keeps_the_weight_of_every_particle(rng, power):
    """Averaged over draws, for any power of the weights."""
    particles = equally_weighted(np.arange(32.0).reshape(1, 8, 4), np.arange(8)[None])
    particles, _ = update(particles, rng.normal(0.0, 1.0, (1, 8)))
    wide = Particles(*(np.repeat(part, 4000, axis=1) for part in (
        particles.states, particles.modes, particles.log_weights - np.log(4000))))
    after = resample(wide, 1.0, power, 0.0, rng)
    # Systematic draws of 4000 copies of each: every weight is within one of them.
    assert after.mode_probabilities(8) == pytest.approx(particles.mode_probabilities(8), rel=2e-3)
    assert np.ptp(after.log_weights) == pytest.approx((1 - power) * np.ptp(wide.log_weights))


def test_roughening_keeps_mean_and_covariance(rng):
    motion = MotionModes()
    particles = gaussian_particles(100_000, motion, rng)
    after = resample(particles, 1.0, 1.0, 9.0, rng)
    before_mean, before_cov = particles.moments
    mean, cov = after.moments
    error = 4 * np.sqrt(np.diag(COV) / 100_000)
    assert np.all(abs(mean - before_mean) < error)
    assert cov[0] == pytest.approx(before_cov[0], abs=0.01 * COV.max())


def test_particles_in_one_point_can_be_resampled(rng):
    particles = equally_weighted(np.ones((1, 50, 4)), np.zeros((1, 50), dtype=int))
    after = resample(particles, 1.0, 0.5, 1.0, rng)
    assert after.states == pytest.approx(np.ones((1, 50, 4)))


def test_zero_likelihood_gives_zero_evidence_and_uniform_weights(rng):
    particles = gaussian_particles(20, MotionModes(), rng)
    after, log_evidence = update(particles, np.full((1, 20), -np.inf))
    assert log_evidence[0] == -np.inf
    assert after.log_weights == pytest.approx(-np.log(20))


def test_several_steps_switch_as_one_long_one(rng):
    motion = MotionModes(mode_sojourn_s=3.0)
    particles = equally_weighted(np.zeros((1, 40_000, 4)), np.zeros((1, 40_000), dtype=int))
    expected = motion.mode_transition(2.5)[0]
    found = predict(particles, motion, 2.5, 5, rng).mode_probabilities(3)[0]
    assert np.all(abs(found - expected) < 4 * np.sqrt(expected / 40_000))
