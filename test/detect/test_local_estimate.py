# SPDX-License-Identifier: Apache-2.0
"""The estimate is that of one mode of the posterior, not the middle of several."""

from lowsnr_common.core.measurement import SensorModel
from lowsnr_detect.parts.local_estimate import best_cells
from lowsnr_detect.parts.local_estimate import by_cell
from lowsnr_detect.parts.local_estimate import grid_moments
from lowsnr_detect.parts.local_estimate import particle_mass
from lowsnr_detect.parts.local_estimate import particle_moments
from lowsnr_detect.parts.local_estimate import PARTICLE_RESOLUTION
from lowsnr_detect.parts.local_estimate import windows
from lowsnr_detect.parts.registry import detector_class
import numpy as np
import pytest

SHAPE = (9, 14)
SENSOR = SensorModel(cell_size_m=2.0)


@pytest.mark.parametrize('name', ['hmm', 'pmf', 'tbd1', 'mmtbd1', 'tbd2', 'mmtbd2'])
def test_of_two_bright_cells_the_brighter_is_declared(rng, name):
    detector = detector_class(name)(sensor=SENSOR, threshold=-50.0)
    frame = np.zeros(SHAPE)
    frame[2, 2], frame[7, 11] = 6.0, 6.5
    _, declared = detector.step(detector.init(SHAPE), frame, rng)
    assert declared.state[0, [0, 2]] == pytest.approx([22.0, 14.0], abs=0.3)
    # The variance of a uniform position in a cell, and little of the cells around it.
    assert np.all(np.diag(declared.cov[0])[[0, 2]] < 3.0 * 2.0**2 / 12.0)


@pytest.mark.parametrize('resolution', [1, 2, 3])
def test_moments_of_a_grid_are_those_of_its_points_in_the_best_cells(rng, resolution):
    rows, cols = SHAPE
    belief = rng.random((4, 3, resolution * rows, resolution * cols))**8
    belief[:, 1, :2, :2] = 40.0  # a corner
    velocity = rng.standard_normal((4, 2))
    factor = rng.standard_normal((4, 2, 2))
    velocity_cov = factor @ factor.swapaxes(1, 2)
    point = (np.indices(belief.shape[2:]).transpose(1, 2, 0) + 0.5) / resolution - 0.5
    mass = belief.sum(axis=0).reshape(3, rows, resolution, cols, resolution).sum(axis=(2, 4))
    cells = best_cells(mass)
    joint = windows(belief, np.arange(3), cells, resolution)
    mean, cov = grid_moments(joint, cells, velocity, velocity_cov, 2.0)
    for run in range(3):
        near = {(row, col): np.all(abs(point - (row, col)) < 1.5, axis=-1)
                for row, col in np.ndindex(*SHAPE)}
        best = max(near, key=lambda cell: belief[:, run, near[cell]].sum())
        weights, places = belief[:, run, near[best]], 2.0 * point[near[best]][:, ::-1]
        joint = np.array([
            [*place, *moving] for moving in velocity for place in places])[:, [0, 2, 1, 3]]
        flat = weights.ravel() / weights.sum()
        expected = flat @ joint
        spread = (joint - expected).T @ (flat[:, None] * (joint - expected))
        spread[np.ix_([1, 3], [1, 3])] += np.tensordot(
            weights.sum(axis=1) / weights.sum(), velocity_cov, 1)
        spread[[0, 2], [0, 2]] += (2.0 / resolution)**2 / 12.0
        assert mean[run] == pytest.approx(expected, abs=1e-12)
        assert cov[run] == pytest.approx(spread, abs=1e-12)


def test_particles_of_the_lesser_mode_do_not_count(rng):
    states = np.zeros((2, 500, 4))
    states[..., [0, 2]] = [4.0, 6.0]
    states[:, 300:, [0, 2]] = [24.0, 14.0]
    states += 0.1 * rng.standard_normal(states.shape)
    log_weights = np.full((2, 500), 800.0)  # not normalised: exp(800) is no float
    log_weights[1, 300:] += 1.0
    mass = by_cell(particle_mass(SENSOR, SHAPE, states, log_weights), PARTICLE_RESOLUTION)
    assert mass.sum(axis=(1, 2)) == pytest.approx(1.0)
    mean, cov = particle_moments(SENSOR, states, log_weights, best_cells(mass))
    for run, chosen in enumerate((np.s_[:300], np.s_[300:])):
        assert mean[run] == pytest.approx(states[run, chosen].mean(axis=0))
        assert cov[run] == pytest.approx(np.cov(states[run, chosen].T, bias=True))
