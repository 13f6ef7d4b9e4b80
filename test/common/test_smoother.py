# SPDX-License-Identifier: Apache-2.0
"""The smoother against the joint density of all states, and against all sequences of modes."""

from itertools import product

from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import process_noise_cov
from lowsnr_common.core.motion import transition_matrix
from lowsnr_common.core.smoother import smooth
import numpy as np
import pytest
from scipy.stats import multivariate_normal

START, START_COV = np.array([3.0, 0.5, 7.0, -0.25]), np.diag([0.3, 0.2, 0.4, 0.1])
TIMES = np.array([0.0, 1.0, 1.5, 4.0, 5.0, 6.0])  # uneven
STRAIGHT = MotionModes(turn_rates_deg_s=(0.0,), acceleration_density=0.02)
TURNING = MotionModes(acceleration_density=0.005, mode_sojourn_s=4.0)


def simulate(motion, times, rng, missed=()):
    """Return states (K, 4), measured positions and their covariances."""
    state = rng.multivariate_normal(START, START_COV)
    mode = rng.integers(motion.count, size=1)
    states = [state]
    for dt in np.diff(times):
        mode = motion.switch(mode, dt, rng)
        states.append(motion.move(states[-1][None], mode, dt, rng)[0])
    noise = np.array([np.diag(rng.uniform(0.05, 0.4, 2)) + 0.01 for _ in times])
    states = np.array(states)
    seen = np.array([rng.multivariate_normal(x[POS], r) for x, r in zip(states, noise)])
    seen[[*missed]] = np.nan
    return states, seen, noise


def batch(times, rates, density, seen, noise):
    """Return mean and covariance of the joint density of all states, and the log likelihood."""
    count = 4 * len(times)
    mean, cov = np.empty(count), np.zeros((count, count))
    mean[:4], cov[:4, :4] = START, START_COV
    for k, (dt, rate) in enumerate(zip(np.diff(times), rates)):
        old, new = slice(4 * k, 4 * k + 4), slice(4 * k + 4, 4 * k + 8)
        f = transition_matrix(dt, np.deg2rad(rate))
        mean[new] = f @ mean[old]
        cov[new, :4 * k + 4] = f @ cov[old, :4 * k + 4]
        cov[:4 * k + 4, new] = cov[new, :4 * k + 4].T
        cov[new, new] = f @ cov[old, old] @ f.T + process_noise_cov(dt, density)
    known = np.flatnonzero(~np.isnan(seen[:, 0]))
    rows = np.concatenate([[4 * k, 4 * k + 2] for k in known])
    error = np.zeros((len(rows), len(rows)))
    for n, k in enumerate(known):
        error[2 * n:2 * n + 2, 2 * n:2 * n + 2] = noise[k]
    total = cov[np.ix_(rows, rows)] + error
    gain = cov[:, rows] @ np.linalg.inv(total)
    z = seen[known].ravel()
    likelihood = multivariate_normal(mean[rows], total).logpdf(z)
    return mean + gain @ (z - mean[rows]), cov - gain @ cov[rows], likelihood


@pytest.mark.parametrize('missed', [(), (0,), (2, 3), (1, 5)])
def test_one_mode_is_the_joint_normal_density(rng, missed):
    _, seen, noise = simulate(STRAIGHT, TIMES, rng, missed)
    found = smooth(STRAIGHT, TIMES, seen, noise, START, START_COV)
    mean, cov, _ = batch(TIMES, [0.0] * 5, STRAIGHT.acceleration_density, seen, noise)
    np.testing.assert_allclose(found.states, mean.reshape(-1, 4), atol=1e-9)
    for k in range(len(TIMES)):
        part = slice(4 * k, 4 * k + 4)
        np.testing.assert_allclose(found.covs[k], cov[part, part], atol=1e-9)


def test_path_of_one_frame_is_its_prior_and_measurement():
    seen = np.array([[3.5, 6.0]])
    found = smooth(TURNING, np.zeros(1), seen, 0.1 * np.eye(2)[None], START, START_COV)
    gain = 0.3 / 0.4, 0.4 / 0.5
    np.testing.assert_allclose(
        found.states, [[3.0 + gain[0] * 0.5, 0.5, 7.0 - gain[1], -0.25]])
    np.testing.assert_allclose(
        found.covs[0], np.diag([0.3 * (1 - gain[0]), 0.2, 0.4 * (1 - gain[1]), 0.1]))
    unseen = smooth(TURNING, np.zeros(1), seen * np.nan, np.eye(2)[None], START, START_COV)
    np.testing.assert_allclose(unseen.covs[0], START_COV)


def exact(times, motion, seen, noise):
    """Return the exact smoothed means: the mixture over all sequences of modes."""
    chain = [motion.mode_transition(dt) for dt in np.diff(times)]
    weights, means = [], []
    for modes in product(range(motion.count), repeat=len(times)):
        prior = sum(np.log(step[one, two]) for step, one, two in zip(chain, modes, modes[1:]))
        mean, _, likelihood = batch(
            times, [motion.turn_rates_deg_s[mode] for mode in modes[1:]],
            motion.acceleration_density, seen, noise)
        weights.append(prior + likelihood)
        means.append(mean)
    weights = np.exp(np.array(weights) - max(weights))
    return (weights @ np.array(means) / weights.sum()).reshape(-1, 4)


def test_modes_are_nearly_the_mixture_over_all_sequences(rng):
    off, spread = [], []
    for _ in range(10):
        _, seen, noise = simulate(TURNING, TIMES[:5], rng, (3,))
        found = smooth(TURNING, TIMES[:5], seen, noise, START, START_COV)
        off.append(found.states - exact(TIMES[:5], TURNING, seen, noise))
        spread.append(np.sqrt(np.diagonal(found.covs, axis1=1, axis2=2)))
        np.testing.assert_allclose(found.modes.sum(axis=1), 1.0)
    # A tenth of a standard deviation, root mean square.
    ratio = np.sqrt(np.mean((np.array(off) / spread) ** 2))
    assert ratio < 0.1


def test_smoothed_errors_are_as_large_as_stated_and_smaller_than_filtered(rng):
    times = np.arange(16.0)
    squared, filtered, last = [], [], []
    for _ in range(50):
        states, seen, noise = simulate(TURNING, times, rng, (4, 5, 11))
        found = smooth(TURNING, times, seen, noise, START, START_COV)
        past = smooth(TURNING, times[:9], seen[:9], noise[:9], START, START_COV)
        error = found.states - states
        squared.append(np.einsum('ka,kab,kb->k', error, np.linalg.inv(found.covs), error))
        filtered.append(np.sum((past.states[8] - states[8])[POS] ** 2))
        last.append(np.sum(error[8, POS] ** 2))
    nees = np.mean(squared)
    assert 3.4 < nees < 4.7  # exact 4
    assert np.mean(last) < 0.8 * np.mean(filtered)
