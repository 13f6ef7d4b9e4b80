"""
Where a declared object is: the mean of the best local mode of its posterior.

A posterior with several modes has its mean between them, where no object is.  The estimate is
the mean of the posterior within the 3 x 3 cells that hold most of its mass, and so is its
covariance.
"""

from __future__ import annotations

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.particles import normalise
from lowsnr_common.core.particles import weighted_moments
import numpy as np

# From p_x, p_y, v_x, v_y to the order of a state.
_ORDER = [0, 2, 1, 3]


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


def particle_moments(
    sensor: SensorModel, shape: tuple[int, int], states: np.ndarray, log_weights: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return mean and covariance of the particles in the 3 x 3 cells that hold most weight.

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
    (n, 4) ndarray
        Mean.
    (n, 4, 4) ndarray
        Covariance.

    """
    cells, log_weights = sensor.cells(states), normalise(log_weights)[0]
    run, particle = np.nonzero(log_weights > -np.inf)
    mass = np.zeros((len(states), *shape))
    np.add.at(mass, (run, *cells[run, particle].T), np.exp(log_weights[run, particle]))
    far = np.any(abs(cells - best_cells(mass)[:, None]) > 1, axis=-1)
    return weighted_moments(states, normalise(np.where(far, -np.inf, log_weights))[0])
