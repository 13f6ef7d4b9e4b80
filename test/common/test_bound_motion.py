# SPDX-License-Identifier: Apache-2.0
"""Objects that carry a destination against the joint Gaussian of a general CM_L sequence."""

from lowsnr_common.core.bound_motion import Bound
from lowsnr_common.core.bound_motion import DestinationDensity
from lowsnr_common.core.bound_motion import draw_bound
from lowsnr_common.core.bound_motion import move_bound
from lowsnr_common.core.bound_motion import PlaceDensity
from lowsnr_common.core.bound_motion import UNBOUND
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import process_noise_cov
from lowsnr_common.core.motion import transition_matrix
import numpy as np
import pytest

PERIOD, DENSITY, LAST = 0.8, 0.05, 6
STRAIGHT = MotionModes(turn_rates_deg_s=(0.0,), acceleration_density=DENSITY)
TURNS = MotionModes(acceleration_density=DENSITY)
TRIALS = 40_000
MEAN = np.array([0.5, 0.4, 0.3, -0.2])
COV = np.diag([0.3, 0.02, 0.5, 0.04])
TO = DestinationDensity(x_m=6.0, y_m=-1.0, std_m=0.7, earliest_frame=LAST, latest_frame=LAST)


def law_of(frame):
    """
    Return the matrices of ``x_k = of_origin x_1 + of_destination d + e``, and the law of e.

    They come from the joint Gaussian of x_k and the position in the last frame, given x_1.
    """
    step, noise = transition_matrix(PERIOD), process_noise_cov(PERIOD, DENSITY)

    def after(count):
        power, cov = np.eye(4), np.zeros((4, 4))
        for _ in range(count):
            power, cov = step @ power, step @ cov @ step.T + noise
        return power, cov

    until, cov = after(frame - 1)
    whole, whole_cov = after(LAST - 1)
    rest, _ = after(LAST - frame)
    cross = (cov @ rest.T)[:, POS]
    gain = cross @ np.linalg.inv(whole_cov[np.ix_(POS, POS)])
    return until - gain @ whole[POS], gain, cov - gain @ cross.T


@pytest.fixture(scope='module')
def sequences():
    """Return states (frames, trials, 4) and destinations of objects with origins of their own."""
    rng = np.random.default_rng(3)
    states = [rng.multivariate_normal(MEAN, COV, TRIALS)]
    bound = draw_bound([TO], (TRIALS,), rng)
    for frame in range(2, LAST + 1):
        states.append(move_bound(
            STRAIGHT, states[-1], np.zeros(TRIALS, int), bound.place,
            bound.left_s(frame, PERIOD), PERIOD, rng))
    return np.array(states), bound


@pytest.mark.parametrize('frame', [2, 3, 5, 6])
def test_states_have_the_moments_of_the_sequence(sequences, frame):
    states, _ = sequences
    of_origin, of_destination, rest = law_of(frame)
    mean = of_origin @ MEAN + of_destination @ [TO.x_m, TO.y_m]
    cov = (of_origin @ COV @ of_origin.T + TO.std_m**2 * of_destination @ of_destination.T + rest)
    found = states[frame - 1]
    assert np.all(abs(found.mean(axis=0) - mean) < 4 * np.sqrt(np.diag(cov) / TRIALS))
    sigma = np.sqrt((np.outer(np.diag(cov), np.diag(cov)) + cov**2) / TRIALS)
    assert np.all(abs(np.cov(found.T) - cov) < 4 * sigma + 1e-12)


def test_origin_and_destination_are_independent_and_every_object_arrives(sequences):
    states, bound = sequences
    assert abs(states[-1][:, POS] - bound.place).max() < 1e-9
    both = np.corrcoef(states[0].T, bound.place.T)[:4, 4:]
    assert abs(both).max() < 4 / np.sqrt(TRIALS)
    # What lies between depends on both.
    of_origin, of_destination, _ = law_of(3)
    cross = (states[2] - states[2].mean(axis=0)).T @ (
        bound.place - bound.place.mean(axis=0)) / TRIALS
    assert cross == pytest.approx(TO.std_m**2 * of_destination, abs=0.02)


def test_objects_are_shared_out_to_destinations_and_arrivals():
    rng = np.random.default_rng(1)
    densities = [
        DestinationDensity(x_m=100.0, probability=0.5, earliest_frame=10, latest_frame=13),
        DestinationDensity(x_m=-100.0, probability=0.2, std_m=0.0, earliest_frame=3,
                           latest_frame=3)]
    bound = draw_bound(densities, (TRIALS,), rng)
    one, other = bound.place[:, 0] > 50.0, bound.place[:, 0] < -50.0
    for share, expected in ((one, 0.5), (other, 0.2), (bound.arrival == UNBOUND, 0.3)):
        assert share.mean() == pytest.approx(expected, abs=4 * 0.5 / np.sqrt(TRIALS))
    counts = np.bincount(bound.arrival[one])[10:]
    assert counts == pytest.approx(np.full(4, one.sum() / 4), abs=4 * np.sqrt(TRIALS / 8))
    assert set(bound.arrival[other]) == {3}
    assert np.array_equal(bound.place[other], np.tile([-100.0, 0.0], (other.sum(), 1)))


def test_objects_without_a_destination_or_after_their_arrival_have_the_base_motion():
    states, modes = np.tile(MEAN, (60, 1)), np.arange(60) % 3
    arrival = np.repeat([UNBOUND, 4, 9], 20)
    bound = Bound(np.full((60, 2), 5.0), arrival)
    found = move_bound(TURNS, states, modes, bound.place, bound.left_s(5, PERIOD), PERIOD,
                       np.random.default_rng(1))
    base = TURNS.move(states, modes, PERIOD, np.random.default_rng(1))
    assert np.array_equal(found[:40], base[:40])
    assert abs(found[40:] - base[40:]).min() > 0.0


@pytest.mark.parametrize('mode', [1, 2])
def test_objects_that_turn_arrive_too(mode):
    rng = np.random.default_rng(2)
    states, modes = np.tile(MEAN, (100, 1)), np.full(100, mode)
    bound = Bound(np.tile([3.0, 2.0], (100, 1)), np.full(100, LAST))
    for frame in range(2, LAST + 1):
        states = move_bound(
            TURNS, states, modes, bound.place, bound.left_s(frame, PERIOD), PERIOD, rng)
    assert abs(states[:, POS] - (3.0, 2.0)).max() < 1e-9


def test_place_density_has_its_moments(rng):
    found = PlaceDensity(x_m=2.0, y_m=-3.0, std_m=0.5).draw((TRIALS,), rng)
    assert found.mean(axis=0) == pytest.approx([2.0, -3.0], abs=4 * 0.5 / np.sqrt(TRIALS))
    assert np.cov(found.T) == pytest.approx(0.25 * np.eye(2), abs=4 * 0.25 * np.sqrt(2 / TRIALS))
