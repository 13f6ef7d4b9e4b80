"""Local maxima of planes, compiled."""

from __future__ import annotations

from lowsnr_common.core.compiled import compiled
import numpy as np


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
    count = 0
    found = np.empty((rows * cols // 2 + 1, 2), np.intp)
    for row in range(rows):
        line, col = plane[row], 0
        while col < cols:
            value = line[col]
            # Most cells fall behind a neighbour in the row.
            if (col + 1 < cols and line[col + 1] >= value) or not value > np.float32(-np.inf):
                col += 1
            elif (col > 0 and line[col - 1] >= value) or not _exceeds(
                    plane, row, col, value, reach):
                col += 2
            else:
                found[count, 0], found[count, 1] = row, col
                count += 1
                col += reach + 1
    row_of, col_of = found[:count, 0].copy(), found[:count, 1].copy()
    values = np.empty(count, np.float32)
    for n in range(count):
        values[n] = plane[row_of[n], col_of[n]]
    return row_of, col_of, values


@compiled
def _exceeds(plane: np.ndarray, row: int, col: int, value: float, reach: int) -> bool:
    """Return whether a value exceeds all others within the reach of its cell."""
    for i in range(max(row - reach, 0), min(row + reach + 1, plane.shape[0])):
        for j in range(max(col - reach, 0), min(col + reach + 1, plane.shape[1])):
            if plane[i, j] >= value and (i != row or j != col):
                return False
    return True
