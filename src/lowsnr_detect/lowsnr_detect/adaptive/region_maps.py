# SPDX-License-Identifier: Apache-2.0
"""Maps of regions of a frame: pooled over neighbours, quantiles, and from regions to cells."""

from __future__ import annotations

import math

from lowsnr_common.core.compiled import compiled
import numpy as np


def counted(
    index: tuple[np.ndarray, ...], shape: tuple[int, ...], weight: np.ndarray | None = None,
) -> np.ndarray:
    """Return how often each place of an array of a shape is indexed, or the sum of weights."""
    flat = np.ravel_multi_index(index, shape)
    found = np.bincount(flat, weight, minlength=math.prod(shape))
    return found.reshape(shape).astype(float, copy=False)


@compiled
def pooled(counts: np.ndarray) -> np.ndarray:
    """
    Add half the counts of the regions beside each, and a quarter of those at its corners.

    Parameters
    ----------
    counts : (P, R, C, bins) ndarray
        Counts of the regions of P planes.

    """
    planes, rows, cols, bins = counts.shape
    summed = np.empty(counts.shape)
    column = np.empty((cols, bins))
    for plane in range(planes):
        for row in range(rows):
            column[:] = counts[plane, row]
            if row > 0:
                _add_half(counts[plane, row - 1], column)
            if row + 1 < rows:
                _add_half(counts[plane, row + 1], column)
            summed[plane, row] = column
            _add_half(column[:-1], summed[plane, row, 1:])
            _add_half(column[1:], summed[plane, row, :-1])
    return summed


@compiled
def _add_half(counts: np.ndarray, summed: np.ndarray) -> None:
    """Add half of some counts (C, bins)."""
    for col in range(counts.shape[0]):
        for part in range(counts.shape[1]):
            summed[col, part] += 0.5 * counts[col, part]


def bin_quantile(counts: np.ndarray, part: float) -> np.ndarray:
    """Return the quantile of each histogram (..., bins), in bins from the first edge."""
    found = np.empty(counts.shape[:-1])
    _bin_quantiles(counts.reshape(-1, counts.shape[-1]), part, found.reshape(-1))
    return found


@compiled
def _bin_quantiles(counts: np.ndarray, part: float, found: np.ndarray) -> None:
    """Write the quantile of each histogram (n, bins); the bin is linear within."""
    for n in range(len(counts)):
        here = counts[n]
        wanted = max(part * here.sum(), 1e-9)
        summed, number = here[0], 0
        while summed < wanted and number < len(here) - 1:
            number += 1
            summed += here[number]
        if summed < wanted:  # nothing is counted
            number, summed = 0, here[0]
        left = (summed - wanted) / max(here[number], 1e-9)
        found[n] = number + 1.0 - min(max(left, 0.0), 1.0)


def _between_centres(
    cell: np.ndarray, size: int, regions: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the regions whose centres are before and after each cell, and the latter's weight."""
    place = np.clip((cell + 0.5) * regions / size - 0.5, 0.0, regions - 1.0)
    before = place.astype(np.intp)
    return before, np.minimum(before + 1, regions - 1), (place - before).astype(np.float32)


def at_cells(
    values: np.ndarray, plane: np.ndarray, row: np.ndarray, col: np.ndarray,
    shape: tuple[int, int],
) -> np.ndarray:
    """Return values (P, R, C) of regions, interpolated at cells (n,) of frames of a shape."""
    found = np.empty(len(row), values.dtype)
    _interpolate(values, plane, row, col, shape, found)
    return found


@compiled
def _interpolate(
    values: np.ndarray, plane: np.ndarray, row: np.ndarray, col: np.ndarray,
    shape: tuple[int, int], found: np.ndarray,
) -> None:
    """Write values of regions, interpolated at cells."""
    down, across = values.shape[1], values.shape[2]
    for n in range(len(found)):
        here = values[plane[n]]
        at = min(max((row[n] + 0.5) * down / shape[0] - 0.5, 0.0), down - 1.0)
        top = int(at)
        upper, lower = here[top], here[min(top + 1, down - 1)]
        at, below = min(max((col[n] + 0.5) * across / shape[1] - 0.5, 0.0), across - 1.0), at - top
        left = int(at)
        right, part = min(left + 1, across - 1), at - left
        above = upper[left] + part * (upper[right] - upper[left])
        beneath = lower[left] + part * (lower[right] - lower[left])
        found[n] = above + below * (beneath - above)


def log_odds(plane: np.ndarray, threshold: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Return ``(plane - threshold) / scale`` of cells, the latter two interpolated, of regions."""
    (rows, cols), (down, across) = plane.shape, threshold.shape
    left, right, part = _between_centres(np.arange(cols), cols, across)
    # Along the rows first, which leaves sums of lines.
    limits, scales = (
        np.ascontiguousarray(
            values[:, left] + part * (values[:, right] - values[:, left]), np.float32)
        for values in (threshold, scale))
    odds = np.empty(plane.shape, np.float32)
    _log_odds(plane, limits, scales, *_between_centres(np.arange(rows), rows, down), odds)
    return odds


@compiled
def _log_odds(
    plane: np.ndarray, limits: np.ndarray, scales: np.ndarray, top: np.ndarray,
    bottom: np.ndarray, down: np.ndarray, odds: np.ndarray,
) -> None:
    """Write the log odds of every cell, with limits and scales (R, cols) of every column."""
    for row in range(plane.shape[0]):
        _row_odds(
            plane[row], limits[top[row]], limits[bottom[row]], scales[top[row]],
            scales[bottom[row]], down[row], odds[row])


@compiled
def _row_odds(
    cells: np.ndarray, upper: np.ndarray, lower: np.ndarray, unit: np.ndarray,
    lower_unit: np.ndarray, down: float, odds: np.ndarray,
) -> None:
    """Write the log odds of a row between two lines of limits and units."""
    for col in range(len(cells)):
        limit = upper[col] + down * (lower[col] - upper[col])
        odds[col] = (cells[col] - limit) / (unit[col] + down * (lower_unit[col] - unit[col]))
