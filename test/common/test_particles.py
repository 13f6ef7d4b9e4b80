# SPDX-License-Identifier: Apache-2.0
"""Particle arithmetic against SciPy, and in the limits where weights vanish."""

from hypothesis import given
from hypothesis import settings
from hypothesis import strategies as st
from lowsnr_common.core.particles import log_sum_exp
from lowsnr_common.core.particles import normalise
from lowsnr_common.core.particles import systematic_resample
from lowsnr_common.core.particles import weighted_moments
import numpy as np
import pytest
from scipy.special import logsumexp

FIXED = settings(deadline=None, derandomize=True)
LOG_WEIGHTS = st.lists(
    st.one_of(st.just(-np.inf), st.floats(-1e4, 1e4)), min_size=1, max_size=40).map(np.array)


class Fixed:
    """A source of randomness that always draws the same numbers."""

    def __init__(self, value):
        self.value = value

    def random(self, shape):
        return np.broadcast_to(self.value, shape)


@FIXED
@given(LOG_WEIGHTS)
def test_log_sum_exp_is_scipy_s(values):
    with np.errstate(divide='ignore'):
        expected = logsumexp(values)
    assert log_sum_exp(values) == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_log_sum_exp_takes_any_axis(rng):
    values = rng.standard_normal((3, 4, 5))
    for axis in range(3):
        np.testing.assert_allclose(log_sum_exp(values, axis), logsumexp(values, axis=axis))


@FIXED
@given(LOG_WEIGHTS, st.floats(-1e5, 1e5))
def test_normalised_weights_sum_to_one_at_any_scale(values, offset):
    weights, total = normalise(values + offset)
    assert np.exp(weights).sum() == pytest.approx(1.0)
    if np.isfinite(total):
        np.testing.assert_allclose(np.exp(weights), np.exp(normalise(values)[0]), atol=1e-9)
        assert np.all(np.isneginf(weights[np.isneginf(values)]))
    else:
        np.testing.assert_allclose(np.exp(weights), 1.0 / len(values))


def test_zero_weights_of_one_set_become_uniform():
    weights, total = normalise(np.array([[0.0, -np.inf], [-np.inf, -np.inf]]))
    np.testing.assert_array_equal(np.exp(weights), [[1.0, 0.0], [0.5, 0.5]])
    np.testing.assert_array_equal(total, [0.0, -np.inf])


@FIXED
@given(LOG_WEIGHTS, st.integers(1, 60), st.integers(0, 2**32))
def test_counts_are_floor_or_ceiling_of_expected(values, count, seed):
    index = systematic_resample(values, count, np.random.default_rng(seed))
    expected = count * np.exp(normalise(values)[0])
    drawn = np.bincount(index, minlength=len(values))
    assert index.shape == (count,)
    assert np.all(np.diff(index) >= 0)
    assert np.all(drawn >= np.floor(expected - 1e-6))
    assert np.all(drawn <= np.ceil(expected + 1e-6))


def test_counts_are_expected_on_average(rng):
    weights, count, trials = np.array([0.05, 0.31, 0.0, 0.44, 0.2]), 7, 20_000
    with np.errstate(divide='ignore'):
        index = systematic_resample(np.tile(np.log(weights), (trials, 1)), count, rng)
    share = np.mean(index[..., None] == np.arange(5), axis=(0, 1)) * count
    # A count that is one of two neighbours has a standard deviation of at most 1/2.
    assert np.all(abs(share - count * weights) < 4 * 0.5 / np.sqrt(trials))


@pytest.mark.parametrize('draw', [0.0, 0.5, np.nextafter(1.0, 0.0)])
@pytest.mark.parametrize('weights', [
    [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.1, 0.0, 0.2, 0.7, 0.0],
])
def test_particle_without_weight_is_never_drawn(weights, draw):
    with np.errstate(divide='ignore'):
        index = systematic_resample(np.log(weights), 1000, Fixed(draw))
    assert np.all(np.array(weights)[index] > 0.0)


@pytest.mark.parametrize('draw', [0.0, np.nextafter(1.0, 0.0)])
def test_weights_that_sum_to_less_than_one_draw_every_particle(draw):
    # 10,000 times 1e-4 is not 1 in floating point, and neither is their cumulative sum.
    index = systematic_resample(np.full(10_000, np.log(1e-4)), 10_000, Fixed(draw))
    assert index.min() == 0
    assert index.max() == 9_999


def test_zero_weights_are_drawn_evenly(rng):
    index = systematic_resample(np.full(4, -np.inf), 8, rng)
    np.testing.assert_array_equal(np.bincount(index), [2, 2, 2, 2])


def test_sets_of_a_batch_are_drawn_independently(rng):
    values = rng.standard_normal((2, 3, 6))
    draws = rng.random((2, 3, 1))
    index = systematic_resample(values, 9, Fixed(draws))
    assert index.shape == (2, 3, 9)
    for run in np.ndindex(2, 3):
        single = systematic_resample(values[run], 9, Fixed(draws[run]))
        np.testing.assert_array_equal(index[run], single)


def test_moments_are_numpy_s(rng):
    states, weights = rng.standard_normal((2, 3, 40, 4)), rng.random((2, 3, 40))
    weights /= weights.sum(axis=-1, keepdims=True)
    mean, cov = weighted_moments(states, np.log(weights))
    for run in np.ndindex(2, 3):
        np.testing.assert_allclose(
            mean[run], np.average(states[run], axis=0, weights=weights[run]))
        np.testing.assert_allclose(
            cov[run], np.cov(states[run].T, aweights=weights[run], ddof=0))


def test_moments_of_one_particle_are_its_state_and_zero():
    state = np.array([[3.0, -1.0, 2.0, 0.5]])
    mean, cov = weighted_moments(state, np.zeros(1))
    np.testing.assert_array_equal(mean, state[0])
    assert not cov.any()
