# SPDX-License-Identifier: Apache-2.0
"""From the cells that cross a threshold to declarations: one for each object."""

from __future__ import annotations

import functools
import math

from lowsnr_common.core.motion import POS
from lowsnr_detect.parts.detector import Declarations
from lowsnr_detect.parts.wald_bounds import floor32
import numpy as np

# Excess, relative to that of a stronger declaration, below which a cell may be in its shadow.
_SHADOW = 0.25


def declare_cells(
    plane: np.ndarray, threshold: float, *, reach: int, most: int, cell_size_m: float,
    position_std_m: float, row_peaks: np.ndarray | None = None, shadow_reach: int = 0,
) -> Declarations:
    """
    Declare the cells of a plane above a threshold, and thin them, strongest first.

    A path or a point spread makes neighbouring cells cross the threshold together.  The
    strongest cell is kept and suppresses all others within ``reach`` cells, then the next
    strongest of the rest.

    Parameters
    ----------
    plane : (..., rows, cols) ndarray of float32
        Test statistic of each cell [nat].
    threshold
        Value that the statistic is compared with [nat].
    reach
        Cells on each side that a declaration suppresses.
    most
        Largest number D of declarations in a frame.
    cell_size_m
        Side of a cell [m].
    position_std_m
        Standard deviation of a declared position per axis [m].
    row_peaks : (..., rows) ndarray of float32, optional
        Largest statistic of each row, where it is known; rows of the plane that do not exceed
        the threshold are then not read.
    shadow_reach
        Cells on each side within which a declaration suppresses others whose excess over the
        threshold is less than a quarter of its own: memories spread a strong object that far.

    Returns
    -------
    Declarations
        Scores are ``L / (L + th)``: the posterior probability at the prior odds for which
        the threshold is the Bayes test, so 1/2 at the threshold.

    """
    if row_peaks is None:
        row_peaks = plane.max(axis=-1)
    peak = np.maximum.reduce(row_peaks, axis=-1, dtype=float)
    if not np.count_nonzero(peak > threshold):
        return Declarations(peak, *_empty_slots(plane.shape[:-2], most))
    crossed, excess = crossed_cells(
        plane, threshold, row_peaks, most * (2 * max(reach, shadow_reach) + 1) ** 2)
    return thinned(crossed, excess, plane.shape, peak, reach, most, cell_size_m, position_std_m,
                   shadow_reach)


def crossed_cells(
    plane: np.ndarray, threshold: float, row_peaks: np.ndarray, count: int,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the cells of a plane (..., rows, cols) above a threshold, and their excess over it.

    Parameters
    ----------
    plane, threshold, row_peaks
        As for :func:`declare_cells`.
    count
        Of a frame with more of them the strongest are enough, at least so many.

    Returns
    -------
    (n,) ndarray of int
        Flat index of each cell, ascending.
    (n,) ndarray
        By how much its statistic exceeds the threshold [nat].

    """
    bound = floor32(threshold)
    rows = np.flatnonzero(row_peaks > bound)
    found = plane.reshape(-1, plane.shape[-1])[rows]
    row, col = np.nonzero(found > bound)
    crossed, excess = rows[row] * plane.shape[-1] + col, found[row, col].astype(float) - threshold
    return _strongest(crossed, excess, math.prod(plane.shape[-2:]), count)


@functools.lru_cache(maxsize=8)
def _empty_slots(
    batch: tuple[int, ...], most: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return read-only score, state and covariance of a frame without a declaration."""
    slots = (
        np.zeros((*batch, most)), np.full((*batch, most, 4), np.nan),
        np.full((*batch, most, 4, 4), np.nan))
    for each in slots:
        each.setflags(write=False)
    return slots


def _strongest(
    crossed: np.ndarray, excess: np.ndarray, cells: int, count: int,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return at least the ``count`` strongest of the crossed cells (n,) of each frame.

    Each declaration suppresses at most the cells of a square, so a weaker cell than the strongest
    of that many squares as there may be declarations cannot become one.
    """
    if crossed.size <= count:
        return crossed, excess
    kept = np.ones(crossed.size, dtype=bool)
    edges = np.searchsorted(crossed, np.arange(0, crossed[-1] + cells + 1, cells))
    for first in np.flatnonzero(np.diff(edges) > count):
        frame = slice(edges[first], edges[first + 1])
        kept[frame] = excess[frame] >= np.partition(excess[frame], -count)[-count]
    return crossed[kept], excess[kept]


def thinned(
    crossed: np.ndarray, excess: np.ndarray, shape: tuple[int, ...], peak: np.ndarray, reach: int,
    most: int, cell_size_m: float, position_std_m: float, shadow_reach: int,
) -> Declarations:
    """
    Declare the strongest of the cells that :func:`crossed_cells` returns, one after the other.

    ``shape`` is that of the plane and ``peak`` its largest statistic of each frame [nat].
    """
    batch, (rows, cols) = shape[:-2], shape[-2:]
    runs = math.prod(batch)
    run, cell = np.divmod(crossed, rows * cols)
    order = np.lexsort((-excess, run))
    run, (row, col), value = run[order], np.divmod(cell[order], cols), excess[order]
    score = np.zeros((runs, most))
    state = np.full((runs, most, 4), np.nan)
    for slot in range(most):
        if run.size == 0:
            break
        first = np.flatnonzero(np.diff(run, prepend=-1))
        kept = run[first]
        score[kept, slot] = 1.0 / (1.0 + np.exp(-np.minimum(value[first], 700.0)))
        state[kept[:, None], slot, POS] = cell_size_m * np.stack([col[first], row[first]], -1)
        owner = first[np.searchsorted(kept, run)]
        distance = np.maximum(abs(row - row[owner]), abs(col - col[owner]))
        weak = value < _SHADOW * value[owner]
        far = distance > np.where(weak, max(reach, shadow_reach), reach)
        run, row, col, value = run[far], row[far], col[far], value[far]
    cov = np.full((*state.shape, 4), np.nan)
    cov[score > 0.0] = _position_cov(position_std_m)
    return Declarations(
        peak, score.reshape(*batch, most), state.reshape(*batch, most, 4),
        cov.reshape(*batch, most, 4, 4))


def _position_cov(std: float) -> np.ndarray:
    cov = np.full((4, 4), np.nan)
    cov[np.ix_(POS, POS)] = std**2 * np.eye(2)
    return cov
