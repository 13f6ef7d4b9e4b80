# SPDX-License-Identifier: Apache-2.0
"""The compiled loops over the particles of all tracks, against plain NumPy and SciPy."""

from lowsnr_common.core.motion import MotionModes
from lowsnr_track import track_kernels
from lowsnr_track.data_association.association import likelihood_ratios
from lowsnr_track.measurements import Measurements
from lowsnr_track.particles import normalised
from lowsnr_track.particles import paired_noise
from lowsnr_track.particles import Particles
import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

TRACKS, COUNT, GATE = 3, 40, 4


@pytest.fixture
def states(rng):
    return rng.normal(5.0, 2.0, (TRACKS, COUNT, 4))


@pytest.fixture
def weights(rng):
    drawn = rng.exponential(size=(TRACKS, COUNT))
    return drawn / drawn.sum(axis=1, keepdims=True)


def test_tracks_move_by_the_matrix_of_their_mode(states, rng):
    motion = MotionModes(turn_rates_deg_s=(0.0, 50.0, -30.0), mode_sojourn_s=2.0)
    modes = rng.integers(3, size=(TRACKS, COUNT))
    draw, noise = rng.random(COUNT), rng.standard_normal((COUNT, 4))
    cumulative = np.cumsum(motion.mode_transition(1.5), axis=1)
    matrices = motion.transition_matrices(1.5)
    moved, chosen = track_kernels.move_tracks(
        states, modes, cumulative[:, :-1], matrices, draw, noise)
    expected = np.sum(draw[:, None] >= cumulative[modes][..., :-1], axis=-1)
    assert np.array_equal(chosen, expected)
    assert moved == pytest.approx(
        np.einsum('tnij,tnj->tni', matrices[expected], states) + noise)


def test_boxes_hold_all_positions(states):
    position = states[..., [0, 2]]
    box = track_kernels.boxes(states)
    assert np.array_equal(box, np.stack([position.min(axis=1), position.max(axis=1)], axis=1))


def test_moments_match_numpy(states, weights):
    mean, cov = track_kernels.moments(states, weights)
    for t in range(TRACKS):
        assert mean[t] == pytest.approx(np.average(states[t], axis=0, weights=weights[t]))
        assert cov[t] == pytest.approx(np.cov(states[t].T, aweights=weights[t], ddof=0))


def test_weights_match_logsumexp(weights, rng):
    log_likelihood = rng.normal(0.0, 300.0, (TRACKS, COUNT))
    log_likelihood[1] = -np.inf
    after, linear, log_sums = normalised(np.log(weights) + log_likelihood)
    total = np.log(weights) + log_likelihood
    assert log_sums == pytest.approx(logsumexp(total, axis=1))
    total[1] = 0.0
    expected = total - logsumexp(total, axis=1, keepdims=True)
    assert after == pytest.approx(expected)
    assert linear == pytest.approx(np.exp(expected))


def test_chosen_tracks_are_copied_or_drawn(states, weights, rng):
    modes, logs = rng.integers(3, size=(TRACKS, COUNT)), np.log(weights)
    drawn = np.sort(rng.integers(COUNT, size=(1, COUNT)))
    found = track_kernels.drawn_particles(
        states, modes, logs, np.array([0, 2]), np.array([-1, 0]), drawn)
    for after, given in zip(found, (states, modes, logs), strict=True):
        assert np.array_equal(after[0], given[0])
        assert np.array_equal(after[1], given[2][drawn[0]])


def test_roughening_is_a_linear_map(states, rng):
    chosen, mean, noise = np.array([0, 2]), rng.normal(size=(2, 4)), paired_noise(COUNT, 4, rng)
    factor = np.tril(rng.normal(size=(2, 4, 4)))
    expected = states.copy()
    expected[chosen] = 0.8 * states[chosen] + 0.2 * mean[:, None] + noise @ np.swapaxes(
        factor, 1, 2)
    track_kernels.roughen(states, chosen, mean, 0.8, factor, noise)
    assert states == pytest.approx(expected)


def test_likelihood_ratios_and_mixtures_match_scipy(states, weights, rng):
    root = rng.standard_normal((5, 2, 2))
    position, cov = rng.normal(5.0, 2.0, (5, 2)), root @ np.swapaxes(root, 1, 2) + np.eye(2)
    gated = np.array([[0, 3, -1, -1], [-1, -1, -1, -1], [1, 2, 3, 4]])
    scale = rng.exponential(size=(TRACKS, GATE))
    particles = Particles(states, np.zeros(weights.shape, dtype=int), np.log(weights))
    ratio, mean = likelihood_ratios(
        particles, Measurements(position, cov, np.ones(5)), scale, gated)
    expected = np.zeros_like(ratio)
    for t, g in zip(*np.nonzero(gated >= 0)):
        normal = multivariate_normal(position[gated[t, g]], cov[gated[t, g]])
        expected[t, g] = scale[t, g] * normal.pdf(states[t][:, [0, 2]])
    assert ratio == pytest.approx(expected)
    assert mean == pytest.approx(np.einsum('tgn,tn->tg', expected, weights))
    factor, none = rng.random((TRACKS, GATE)), rng.random(TRACKS)
    found = track_kernels.mixtures(ratio, factor, none, gated)
    assert found == pytest.approx(none[:, None] + np.einsum('tg,tgn->tn', factor, expected))


@pytest.mark.parametrize('count', [10, 11])
def test_paired_noise_is_standard_normal(count, rng):
    drawn = np.array([paired_noise(count, 2, rng) for _ in range(2000)])
    even = drawn[:, :2 * (count // 2)] if count % 2 == 0 else np.delete(drawn, count // 2, axis=1)
    assert even.sum(axis=1) == pytest.approx(0.0, abs=1e-12)
    assert drawn.mean(axis=0) == pytest.approx(0.0, abs=5 / np.sqrt(2000))
    assert drawn.var(axis=0) == pytest.approx(1.0, abs=5 * np.sqrt(2 / 2000))
