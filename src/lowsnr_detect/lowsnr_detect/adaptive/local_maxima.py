# SPDX-License-Identifier: Apache-2.0
"""Local maxima of planes, compiled."""

from __future__ import annotations

from lowsnr_common.core.compiled import compiled
import numpy as np

_NONE = np.float32(-np.inf)


@compiled
def local_maxima(plane: np.ndarray, reach: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return rows, columns and values of the cells that exceed all others within ``reach`` cells.

    Parameters
    ----------
    plane : (rows, cols) ndarray of float32
        Values; -inf for none.  Of equal neighbours none is a maximum.
    reach
        Cells on each side, at least 1.

    """
    rows, cols = plane.shape
    # Of each row the largest value around each cell: the cell included, and the others alone.
    around = np.empty((rows, cols), np.float32)
    most = np.empty((rows, cols), np.float32)
    for row in range(rows):
        most[row] = _NONE
        _raise_by_row(plane[row], reach, most[row])
        for col in range(cols):
            value = plane[row, col]
            around[row, col] = value if value > most[row, col] else most[row, col]
    count, found = 0, np.empty((rows * cols // 2 + 1, 2), np.intp)
    for row in range(rows):
        line, others = plane[row], most[row]
        for other in range(max(row - reach, 0), min(row + reach + 1, rows)):
            if other != row:
                _raise(around[other], others)
        for col in range(cols):
            if line[col] > others[col]:
                found[count, 0], found[count, 1] = row, col
                count += 1
    row_of, col_of = found[:count, 0].copy(), found[:count, 1].copy()
    values = np.empty(count, np.float32)
    for n in range(count):
        values[n] = plane[row_of[n], col_of[n]]
    return row_of, col_of, values


@compiled
def _raise_by_row(line: np.ndarray, reach: int, most: np.ndarray) -> None:
    """Raise values to the largest of the other cells of a line within the reach."""
    for step in range(1, min(reach, len(line) - 1) + 1):
        _raise(line[:-step], most[step:])
        _raise(line[step:], most[:-step])


@compiled
def _raise(line: np.ndarray, most: np.ndarray) -> None:
    """Raise values to those of a line."""
    for col in range(len(most)):
        most[col] = line[col] if line[col] > most[col] else most[col]
