# SPDX-License-Identifier: Apache-2.0
"""
Where a declared object is: the mean of the best local mode of its posterior.

A posterior with several modes has its mean between them, where no object is.  The estimate is
the mean of the posterior within the 3 x 3 cells that hold most of its mass, and so is its
covariance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import POS
from lowsnr_common.core.particles import normalise
from lowsnr_common.core.particles import weighted_moments
import numpy as np

# Points per cell and axis in which the weights of particles are summed.
PARTICLE_RESOLUTION = 4
# From p_x, p_y, v_x, v_y to the order of a state.
_ORDER = [0, 2, 1, 3]


@dataclass(frozen=True)
class Posterior:
    """
    Where the object of each run is, if there is one.

    Parameters
    ----------
    mass
        Takes which runs, (...,) of bool, and returns the probability of each point of these,
        (n, R rows, R cols), in proportion.
    moments
        Takes these and a cell of each, (n, 2), and returns mean (n, 4) and covariance (n, 4, 4)
        of the state in the 3 x 3 cells around it [m, m/s].
    cell_size_m
        Side of a cell [m].
    resolution
        Points R per cell and axis.
    before
        Takes the same as ``moments`` and returns what the frame says of these cells, the log
        of the mean likelihood ratio in them (n,) [nat], with mean and covariance of the state
        before the frame; None where that is not known.

    """

    mass: Callable[[np.ndarray], np.ndarray]
    moments: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
    cell_size_m: float
    resolution: int = 1
    before: Callable[
        [np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]] | None = None


def no_moments(shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return means and covariances of nothing."""
    return np.full((*shape, 4), np.nan), np.full((*shape, 4, 4), np.nan)


def best_cells(mass: np.ndarray) -> np.ndarray:
    """
    Return the cell whose 3 x 3 cells hold the largest mass.

    Parameters
    ----------
    mass : (n, rows, cols) ndarray
        Probability of each cell; none outside the frame.

    Returns
    -------
    (n, 2) ndarray of int
        Row and column.

    """
    wide = np.pad(mass, ((0, 0), (1, 1), (1, 1)))
    tall = wide[:, :-2] + wide[:, 1:-1] + wide[:, 2:]
    box = tall[:, :, :-2] + tall[:, :, 1:-1] + tall[:, :, 2:]
    best = box.reshape(len(box), -1).argmax(axis=-1)
    return np.stack(np.divmod(best, mass.shape[2]), axis=-1)


def by_cell(mass: np.ndarray, resolution: int) -> np.ndarray:
    """Return the mass of cells (n, rows, cols), from that of points (n, R rows, R cols)."""
    if resolution == 1:
        return mass
    count, rows, cols = mass.shape
    cells = (count, rows // resolution, resolution, cols // resolution, resolution)
    return np.asarray(mass.reshape(cells).sum(axis=(2, 4)))


def windows(
    values: np.ndarray, runs: np.ndarray, cells: np.ndarray, resolution: int = 1,
) -> np.ndarray:
    """
    Return the values of the points in the 3 x 3 cells around some, 0 outside the frame.

    Parameters
    ----------
    values : (C, B, R rows, R cols) ndarray
        Value of each class of velocities and point, for B runs.
    runs : (n,) ndarray of int
        Run of each window.
    cells : (n, 2) ndarray of int
        Row and column of its middle cell.
    resolution
        Points R per cell and axis.

    Returns
    -------
    (n, C, 3 R, 3 R) ndarray
        Values.

    """
    reach = np.arange(-resolution, 2 * resolution)
    row, col = (resolution * cells[:, axis, None] + reach for axis in (0, 1))
    rows, cols = values.shape[-2:]
    row_inside, col_inside = (row >= 0) & (row < rows), (col >= 0) & (col < cols)
    inside = row_inside[:, :, None] & col_inside[:, None, :]
    found = values[
        :, runs[:, None, None], row.clip(0, rows - 1)[:, :, None],
        col.clip(0, cols - 1)[:, None, :]]
    return np.where(inside[:, None], found.swapaxes(0, 1), 0.0)


def grid_moments(
    joint: np.ndarray, cells: np.ndarray, velocity: np.ndarray, velocity_cov: np.ndarray,
    cell_size_m: float,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return mean and covariance of the state in the 3 x 3 cells around some.

    Parameters
    ----------
    joint : (n, C, 3 R, 3 R) ndarray
        Probability of each class of velocities and point of the cells, not normalised.
    cells : (n, 2) ndarray of int
        Row and column of the middle cell.
    velocity : (C, 2) ndarray
        Mean v_x, v_y of each class [m/s].
    velocity_cov : (C, 2, 2) ndarray
        Its covariance.
    cell_size_m
        Side of a cell [m].

    Returns
    -------
    (n, 4) ndarray
        Mean ``[p_x, v_x, p_y, v_y]`` [m, m/s].
    (n, 4, 4) ndarray
        Covariance; around a point the position is uniform and independent of the velocity.

    """
    points = joint.shape[-1]
    spacing = 3.0 * cell_size_m / points
    offset = spacing * (np.arange(points) - (points - 1) / 2.0)
    joint = joint / joint.sum(axis=(1, 2, 3), keepdims=True)
    by_point, by_col, by_row = joint.sum(axis=1), joint.sum(axis=2), joint.sum(axis=3)
    by_class = by_col.sum(axis=2)
    between = np.stack([by_col @ offset, by_row @ offset], axis=-1)
    mean = np.concatenate([between.sum(axis=1), by_class @ velocity], axis=-1)
    cross = between.swapaxes(1, 2) @ velocity
    product = by_point @ offset @ offset
    places = np.stack([
        by_col.sum(axis=1) @ offset**2, product, product, by_row.sum(axis=1) @ offset**2], -1)
    squares = velocity[:, :, None] * velocity[:, None, :] + velocity_cov
    second = np.block([
        [places.reshape(-1, 2, 2), cross],
        [cross.swapaxes(1, 2), np.einsum('nc,cij->nij', by_class, squares)]])
    cov = second - mean[:, :, None] * mean[:, None, :]
    cov[:, :2, :2] += spacing**2 / 12.0 * np.eye(2)
    mean[:, :2] += cell_size_m * cells[:, ::-1]
    return mean[:, _ORDER], cov[:, _ORDER][:, :, _ORDER]


def particle_mass(
    sensor: SensorModel, shape: tuple[int, int], states: np.ndarray, log_weights: np.ndarray,
) -> np.ndarray:
    """
    Return the weight of the particles in every sixteenth of a cell.

    Parameters
    ----------
    sensor
        Cells of a frame.
    shape
        Rows and columns.
    states : (n, N, 4) ndarray
        Particles of n runs [m, m/s].
    log_weights : (n, N) ndarray
        Log weights, not normalised, -inf outside the frame.

    Returns
    -------
    (n, R rows, R cols) ndarray
        Weights, R = ``PARTICLE_RESOLUTION``.

    """
    log_weights = normalise(log_weights)[0]
    run, particle = np.nonzero(log_weights > -np.inf)
    pixel = states[run, particle][:, POS[::-1]] / sensor.cell_size_m + 0.5
    row, col = np.floor(PARTICLE_RESOLUTION * pixel).astype(np.intp).T
    mass = np.zeros((len(states), *(PARTICLE_RESOLUTION * size for size in shape)))
    np.add.at(mass, (run, row, col), np.exp(log_weights[run, particle]))
    return mass


def particle_moments(
    sensor: SensorModel, states: np.ndarray, log_weights: np.ndarray, middle: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return mean and covariance of the particles in the 3 x 3 cells around some.

    Parameters
    ----------
    sensor
        Cells of a frame.
    states : (n, N, 4) ndarray
        Particles of n runs [m, m/s].
    log_weights : (n, N) ndarray
        Log weights, not normalised, -inf outside the frame.
    middle : (n, 2) ndarray of int
        Row and column of the middle cells.

    Returns
    -------
    (n, 4) ndarray
        Mean.
    (n, 4, 4) ndarray
        Covariance.

    """
    log_weights = normalise(log_weights)[0]
    far = np.any(abs(sensor.cells(states) - middle[:, None]) > 1, axis=-1)
    return weighted_moments(states, normalise(np.where(far, -np.inf, log_weights))[0])


def particle_posterior(
    sensor: SensorModel, shape: tuple[int, int], states: np.ndarray, log_weights: np.ndarray,
) -> Posterior:
    """Return the posterior that particles (..., N) with log weights represent."""
    return Posterior(
        lambda runs: particle_mass(sensor, shape, states[runs], log_weights[runs]),
        lambda runs, cells: particle_moments(sensor, states[runs], log_weights[runs], cells),
        sensor.cell_size_m, PARTICLE_RESOLUTION)
