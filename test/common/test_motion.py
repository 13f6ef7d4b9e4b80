# SPDX-License-Identifier: Apache-2.0
"""Motion: F and Q against the differential equation, the mode chain against its generator."""

from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import process_noise_cov
from lowsnr_common.core.motion import process_noise_sqrt
from lowsnr_common.core.motion import transition_matrix
from lowsnr_common.core.motion import VEL
import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm


def dynamics(turn_rate):
    """Return A of dx/dt = A x: the velocity turns at a constant rate from x towards y."""
    return np.array([
        [0.0, 1.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, -turn_rate],
        [0.0, 0.0, 0.0, 1.0],
        [0.0, turn_rate, 0.0, 0.0],
    ])


def test_constant_velocity_matrix_is_eq_1():
    expected = [[1, 2, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]
    np.testing.assert_array_equal(transition_matrix(2.0), expected)


@pytest.mark.parametrize('turn_rate', [0.0, 1e-9, -1e-4, 0.35, -0.35, np.pi, 5.0])
@pytest.mark.parametrize('dt', [0.0, 0.1, 1.0, 2.5])
def test_transition_matrix_solves_the_turn(dt, turn_rate):
    expected = expm(dynamics(turn_rate) * dt)
    np.testing.assert_allclose(transition_matrix(dt, turn_rate), expected, atol=1e-12)


def test_positive_turn_goes_from_x_towards_y():
    quarter = transition_matrix(1.0, np.pi / 2) @ [0.0, 1.0, 0.0, 0.0]
    radius = 2.0 / np.pi
    np.testing.assert_allclose(quarter, [radius, 0.0, radius, 1.0], atol=1e-12)


def test_process_noise_has_its_closed_form():
    axis = 3.0 * np.array([[8 / 3, 2.0], [2.0, 2.0]])
    cov = process_noise_cov(2.0, 3.0)
    np.testing.assert_allclose(cov[:2, :2], axis)
    np.testing.assert_allclose(cov[2:, 2:], axis)
    assert not cov[:2, 2:].any()


@pytest.mark.parametrize('dt', [0.2, 1.0, 3.0])
def test_process_noise_integrates_white_acceleration(dt):
    density = 0.7
    white = np.diag([0.0, density, 0.0, density])

    def spread(age):
        reach = expm(dynamics(0.0) * age)
        return reach @ white @ reach.T

    expected, _ = quad_vec(spread, 0.0, dt)
    np.testing.assert_allclose(process_noise_cov(dt, density), expected, rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize(('dt', 'density'), [(1.0, 0.5), (0.1, 1e-3), (0.0, 1.0), (1.0, 0.0)])
def test_square_root_of_process_noise_squares_to_it(dt, density):
    factor = process_noise_sqrt(dt, density)
    np.testing.assert_allclose(factor @ factor.T, process_noise_cov(dt, density), atol=1e-15)


@pytest.mark.parametrize('count', [1, 2, 3, 5])
@pytest.mark.parametrize('dt', [0.0, 0.3, 1.0, 40.0])
def test_mode_chain_is_the_exponential_of_its_generator(count, dt):
    sojourn = 7.0
    modes = MotionModes(turn_rates_deg_s=tuple(range(count)), mode_sojourn_s=sojourn)
    generator = np.full((count, count), 1.0 / sojourn / max(count - 1, 1))
    np.fill_diagonal(generator, 0.0)
    generator -= np.diag(generator.sum(axis=1))
    np.testing.assert_allclose(modes.mode_transition(dt), expm(generator * dt), atol=1e-12)


def test_switching_has_the_chain_s_frequencies(rng):
    modes = MotionModes(mode_sojourn_s=3.0)
    trials = 40_000
    probability = modes.mode_transition(1.0)
    for before in range(modes.count):
        after = modes.switch(np.full((4, trials // 4), before), 1.0, rng)
        share = np.bincount(after.ravel(), minlength=modes.count) / trials
        sigma = np.sqrt(probability[before] * (1 - probability[before]) / trials)
        assert np.all(abs(share - probability[before]) < 4 * sigma)


def test_single_mode_never_switches(rng):
    before = np.zeros(5, dtype=int)
    np.testing.assert_array_equal(MotionModes().single().switch(before, 1.0, rng), before)


@pytest.mark.parametrize('rates', [(0.0,), (0.0, 20.0, -20.0)])
def test_move_has_the_moments_of_its_mode(rates, rng):
    modes = MotionModes(turn_rates_deg_s=rates, acceleration_density=0.3)
    start, trials, dt = np.array([1.0, 0.5, -2.0, 0.8]), 20_000, 1.5
    cov = process_noise_cov(dt, 0.3)
    for mode, rate in enumerate(rates):
        moved = modes.move(np.tile(start, (trials, 1)), np.full(trials, mode), dt, rng)
        error = moved - expm(dynamics(np.deg2rad(rate)) * dt) @ start
        assert np.all(abs(error.mean(axis=0)) < 4 * np.sqrt(np.diag(cov) / trials))
        # Var of a sample covariance of Gaussians: (C_ii C_jj + C_ij^2) / n.
        sigma = np.sqrt((np.outer(np.diag(cov), np.diag(cov)) + cov**2) / trials)
        assert np.all(abs(np.cov(error.T) - cov) < 4 * sigma)


def test_move_takes_leading_axes(rng):
    modes = MotionModes(acceleration_density=0.0)
    states, mode = rng.standard_normal((2, 3, 4)), np.array([[0, 1, 2], [2, 1, 0]])
    moved = modes.move(states, mode, 1.0, rng)
    matrices = modes.transition_matrices(1.0)
    for index in np.ndindex(2, 3):
        np.testing.assert_allclose(moved[index], matrices[mode[index]] @ states[index])


def test_turning_keeps_the_speed(rng):
    modes = MotionModes(acceleration_density=0.0)
    states = rng.standard_normal((50, 4))
    moved = modes.move(states, rng.integers(3, size=50), 1.0, rng)
    np.testing.assert_allclose(np.hypot(*moved[:, VEL].T), np.hypot(*states[:, VEL].T))


def test_drawn_velocities_fill_the_limits(rng):
    modes = MotionModes(min_speed_mps=0.3, max_speed_mps=0.9)
    velocity = modes.draw_velocity((4, 5_000), rng)
    assert velocity.shape == (4, 5_000, 2)
    speed = np.hypot(velocity[..., 0], velocity[..., 1])
    assert speed.min() >= 0.3
    assert speed.max() <= 0.9
    # Uniform: mean 0.6, standard deviation 0.6 / sqrt(12) of each of 20,000 draws.
    assert abs(speed.mean() - 0.6) < 4 * 0.6 / np.sqrt(12 * 20_000)
    assert np.all(abs(velocity.mean(axis=(0, 1))) < 4 * 0.45 / np.sqrt(20_000))


@pytest.mark.parametrize('values', [
    {'turn_rates_deg_s': ()}, {'min_speed_mps': 2.0, 'max_speed_mps': 1.0},
    {'mode_sojourn_s': 0.0}, {'acceleration_density': -1.0},
])
def test_bad_modes_are_rejected(values):
    name = next(iter(values))
    with pytest.raises(ValueError, match=rf'^MotionModes\.{name}\b'):
        MotionModes(**values)


def test_single_keeps_everything_but_the_modes():
    modes = MotionModes(
        mode_sojourn_s=4.0, acceleration_density=0.2, min_speed_mps=0.1, max_speed_mps=3.0)
    assert modes.single() == MotionModes(
        turn_rates_deg_s=(0.0,), mode_sojourn_s=4.0, acceleration_density=0.2,
        min_speed_mps=0.1, max_speed_mps=3.0)


def test_positions_and_velocities_are_where_the_paper_has_them():
    state = np.array(['p_x', 'v_x', 'p_y', 'v_y'])
    assert list(state[POS]) == ['p_x', 'p_y']
    assert list(state[VEL]) == ['v_x', 'v_y']
