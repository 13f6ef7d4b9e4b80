# SPDX-License-Identifier: Apache-2.0
"""The bridge to a destination against conditioning of the whole base motion."""

from dataclasses import replace

from lowsnr_common.core.destination import bridge_gain
from lowsnr_common.core.destination import Destination
from lowsnr_common.core.destination import move_towards
from lowsnr_common.core.destination import state_likelihood
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import process_noise_cov
from lowsnr_common.core.motion import transition_matrix
import numpy as np
import pytest
from scipy.stats import multivariate_normal

PERIOD = 0.8
AREA = 300.0
DENSITY = 0.05
SURE = 1.0 - 1e-9
STRAIGHT = MotionModes(turn_rates_deg_s=(0.0,), acceleration_density=DENSITY)
TURNS = MotionModes(acceleration_density=DENSITY)
TO = Destination(probability=0.7, x_m=3.0, y_m=-1.0, std_m=0.6, arrival_frame=6,
                 acceleration_density=DENSITY)
STATE = np.array([0.5, 0.4, 0.3, -0.2])


def conditioned(destination, frame):
    """
    Return law and noise of the step into a frame, from the joint Gaussian of all states and d.

    The states from the frame before on are stacked: x = offset + response @ noise.
    """
    step, noise = transition_matrix(PERIOD), process_noise_cov(PERIOD, DENSITY)
    count = destination.arrival_frame - frame + 2
    first, response = [np.eye(4)], [np.zeros((4, 4 * count))]
    for k in range(1, count):
        first.append(step @ first[-1])
        response.append(step @ response[-1])
        response[-1][:, 4 * k:4 * k + 4] = np.eye(4)
    cov = np.kron(np.eye(count), noise)
    see = response[-1][POS]
    total = see @ cov @ see.T + destination.std_m**2 * np.eye(2)
    gain = np.linalg.solve(total, see @ cov @ response[1].T).T
    left = response[1] @ cov @ response[1].T - gain @ see @ cov @ response[1].T
    return first[1] - gain @ first[-1][POS], gain, left, total


@pytest.mark.parametrize('frame', [1, 3, 5, 6])
@pytest.mark.parametrize('std', [1e-3, 0.6, 20.0])
def test_bridge_is_the_base_motion_conditioned_on_its_end(frame, std):
    to = replace(TO, std_m=std)
    law, gain, cov, total = conditioned(to, frame)
    found, variance = bridge_gain(to, DENSITY, frame, PERIOD)
    whole = np.kron(np.eye(2), found[:, None])
    ahead = np.kron(np.eye(2), [[1.0, (6 - frame) * PERIOD]])
    step, noise = transition_matrix(PERIOD), process_noise_cov(PERIOD, DENSITY)
    assert whole == pytest.approx(gain, abs=1e-10)
    assert step - whole @ ahead @ step == pytest.approx(law, abs=1e-10)
    assert noise - whole @ ahead @ noise == pytest.approx(cov, abs=1e-10)
    assert variance * np.eye(2) == pytest.approx(total, abs=1e-10)


@pytest.mark.parametrize('frame', [2, 6])
def test_draws_have_the_moments_of_the_bridge(rng, frame):
    to, trials = replace(TO, probability=SURE), 40_000
    moved, weight = move_towards(
        to, STRAIGHT, np.tile(STATE, (trials, 1)), np.zeros(trials, int), frame, PERIOD, AREA,
        rng)
    law, gain, cov, _ = conditioned(to, frame)
    error = moved - law @ STATE - gain @ [to.x_m, to.y_m]
    assert np.all(abs(error.mean(axis=0)) < 4 * np.sqrt(np.diag(cov) / trials))
    sigma = np.sqrt((np.outer(np.diag(cov), np.diag(cov)) + cov**2) / trials)
    assert np.all(abs(np.cov(error.T) - cov) < 4 * sigma)
    assert weight == pytest.approx(0.0, abs=1e-9)


def test_certain_destination_is_where_the_bridge_ends(rng):
    to = replace(TO, probability=SURE, std_m=1e-5)
    states = np.tile(STATE, (500, 1))
    for frame in range(2, 7):
        states, _ = move_towards(
            to, STRAIGHT, states, np.zeros(500, int), frame, PERIOD, AREA, rng)
    assert abs(states[:, POS] - (3.0, -1.0)).max() < 1e-3


def test_unknown_destination_leaves_the_base_motion():
    to, states, modes = replace(TO, std_m=1e6), np.tile(STATE, (50, 1)), np.arange(50) % 3
    found, weight = move_towards(
        to, TURNS, states, modes, 3, PERIOD, AREA, np.random.default_rng(1))
    base = TURNS.move(states, modes, PERIOD, np.random.default_rng(1))
    assert found == pytest.approx(base, abs=1e-4)
    assert weight == pytest.approx(0.0, abs=1e-9)


def test_arrival_likelihood_allows_for_a_wrong_destination():
    step, cov = transition_matrix(4 * PERIOD), process_noise_cov(4 * PERIOD, DENSITY)
    law = multivariate_normal((step @ STATE)[POS], cov[np.ix_(POS, POS)] + 0.36 * np.eye(2))
    expected = 0.3 + 0.7 * AREA * law.pdf((3.0, -1.0))
    assert state_likelihood(TO, STATE, 2, PERIOD, AREA) == pytest.approx(expected)
    assert state_likelihood(TO, STATE + 1e5, 2, PERIOD, AREA) == pytest.approx(0.3)


@pytest.mark.parametrize('mode', [0, 1, 2])
def test_weighted_draws_are_base_motion_weighted_by_where_it_leads(rng, mode):
    # Importance sampling of the base motion by h is the oracle, for turns as well.
    trials, frame = 200_000, 5
    states, modes = np.tile(STATE, (trials, 1)), np.full(trials, mode)
    base = TURNS.move(states, modes, PERIOD, rng)
    factor = state_likelihood(TO, base, frame, PERIOD, AREA)
    moved, weight = move_towards(TO, TURNS, states, modes, frame, PERIOD, AREA, rng)
    before = state_likelihood(TO, STATE, frame - 1, PERIOD, AREA)
    assert np.ptp(weight) < 1e-12
    assert before * np.exp(weight[0]) == pytest.approx(
        factor.mean(), abs=4 * factor.std() / np.sqrt(trials))
    for power in (1, 2):
        expected = factor @ base**power / factor.sum()
        spread = np.std(factor[:, None] * (base**power - expected), axis=0) / factor.mean()
        error = np.hypot(spread, np.std(moved**power, axis=0)) / np.sqrt(trials)
        assert np.all(abs(np.mean(moved**power, axis=0) - expected) < 4 * error)


def test_leading_axes_are_runs(rng):
    states, modes = rng.standard_normal((2, 3, 5, 4)), rng.integers(3, size=(2, 3, 5))
    moved, weight = move_towards(TO, TURNS, states, modes, 4, PERIOD, AREA, rng)
    assert moved.shape == states.shape
    assert weight.shape == modes.shape


def test_destination_counts_up_to_the_arrival():
    assert TO.is_ahead(1)
    assert TO.is_ahead(6)
    assert not TO.is_ahead(7)
    assert not Destination().is_ahead(1)


@pytest.mark.parametrize(('values', 'culprit'), [
    ({'probability': 1.0}, 'Destination.probability'),
    ({'std_m': 0.0}, 'Destination.std_m'),
    ({'arrival_frame': 0}, 'Destination.arrival_frame'),
    ({'acceleration_density': -0.1}, 'Destination.acceleration_density'),
])
def test_bad_destinations_are_refused(values, culprit):
    with pytest.raises(ValueError, match=culprit):
        Destination(**values)
