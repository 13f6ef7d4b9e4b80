# SPDX-License-Identifier: Apache-2.0
"""Positions between the cells: the mean over a vicinity, weighted with the statistic."""

from __future__ import annotations

from dataclasses import replace

from lowsnr_common.core.motion import POS
from lowsnr_detect.parts.detector import Declarations
import numpy as np

# Maps (p_x, p_y) to a state.
_POSITION = np.eye(4)[POS]


def with_centroids(
    declared: Declarations, plane: np.ndarray, *, reach: int, cell_size_m: float,
) -> Declarations:
    """
    Move declarations from their cell to the centroid of its vicinity.

    The log ratio of a cell is taken as the log of the probability that the object is there, up
    to a constant.  The strongest cell alone is often the one with the largest noise in the last
    frame.

    Parameters
    ----------
    declared : Declarations
        Declarations at cell centres.
    plane : (..., rows, cols) ndarray
        Log-likelihood ratio of each cell [nat]; -inf for an impossible one.
    reach
        Cells of the vicinity on each side.
    cell_size_m
        Side of a cell [m].

    Returns
    -------
    Declarations
        The same declarations, with mean and covariance of the position; the variance within a
        cell is included.

    """
    found = declared.score > 0.0
    if not found.any():
        return declared
    run = np.nonzero(found.reshape(-1, found.shape[-1]))[0]
    col, row = np.rint(declared.state[found][:, POS].T / cell_size_m).astype(np.intp)
    shift, spread = centroids(
        plane.reshape(-1, *plane.shape[-2:]), (run, row, col), reach, cell_size_m)
    state, cov = declared.state.copy(), declared.cov.copy()
    state[found] += shift @ _POSITION
    # NaN stays where the velocity is not estimated.
    cov[found] = 0.0 * cov[found] + _POSITION.T @ spread @ _POSITION
    return replace(declared, state=state, cov=cov)


def centroids(
    planes: np.ndarray, cells: tuple[np.ndarray, np.ndarray, np.ndarray], reach: int,
    cell_size_m: float,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return how far centroids x, y are from the centres of cells, and their covariance.

    Parameters
    ----------
    planes : (B, rows, cols) ndarray
        Log-likelihood ratio of each cell [nat].
    cells
        Run, row and column of each cell, (n,) each.
    reach, cell_size_m
        As for :func:`with_centroids`.

    Returns
    -------
    (n, 2) ndarray, (n, 2, 2) ndarray
        In m and m^2.

    """
    window = _windows(planes, *cells, reach)
    weight = np.exp(window - window.max(axis=-1, keepdims=True))
    weight /= weight.sum(axis=-1, keepdims=True)
    offset = cell_size_m * _offsets(reach)[:, ::-1]
    shift = weight @ offset
    squares = np.einsum('dw,wi,wj->dij', weight, offset, offset, optimize=True)
    return shift, (
        squares - shift[:, :, None] * shift[:, None, :] + cell_size_m**2 / 12.0 * np.eye(2))


def _offsets(reach: int) -> np.ndarray:
    """Return the (rows, cols) offsets of a vicinity, one a row."""
    side = 2 * reach + 1
    return np.stack(np.divmod(np.arange(side**2), side), axis=-1) - reach


def _windows(
    planes: np.ndarray, run: np.ndarray, row: np.ndarray, col: np.ndarray, reach: int,
) -> np.ndarray:
    """Return the values around cells, (cells, (2 reach + 1)^2); -inf outside the frame."""
    rows, cols = _offsets(reach).T
    rows, cols = row[:, None] + rows, col[:, None] + cols
    inside = (rows >= 0) & (rows < planes.shape[1]) & (cols >= 0) & (cols < planes.shape[2])
    found = planes[run[:, None], np.where(inside, rows, 0), np.where(inside, cols, 0)]
    return np.where(inside, found, -np.inf)
