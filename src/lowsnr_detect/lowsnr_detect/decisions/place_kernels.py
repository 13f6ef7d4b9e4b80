# SPDX-License-Identifier: Apache-2.0
"""The search for the place where a declaration gains most, over the points of a plane."""

from __future__ import annotations

from lowsnr_common.core.compiled import compiled
from lowsnr_detect.grid.neighbourhood_kernels import box_sums
import numpy as np


@compiled
def around(plane: np.ndarray, table: np.ndarray, row: int, col: int) -> float:
    """Return the sum of a plane around a point, weighed by a table (side, side)."""
    reach, total = len(table) // 2, 0.0
    for down in range(max(-reach, -row), min(reach + 1, plane.shape[0] - row)):
        for across in range(max(-reach, -col), min(reach + 1, plane.shape[1] - col)):
            total += plane[row + down, col + across] * table[down + reach, across + reach]
    return total


@compiled
def best_places(
    mass: np.ndarray, tables: np.ndarray, places: np.ndarray, gains: np.ndarray,
) -> None:
    """
    Write the place that gains most in every plane, and its gain.

    Parameters
    ----------
    mass : (n, rows, cols) ndarray
        Mass of each point.
    tables : (4, offsets, side, side) ndarray
        For each offset of a place from a point, and each point around: the gain of its mass,
        the part of it within the cutoff, and the sums of rows and columns over that part.
    places : (n, 3) ndarray of int
        Row and column of a point, and the offset from it.
    gains : (n,) ndarray
        Gain.

    """
    reach = tables.shape[2] // 2
    for run in range(len(mass)):
        plane = mass[run]
        # A gain is at most the mass around, so that most points need not be looked at.
        most = box_sums(plane, reach)
        first = int(most.argmax())
        gains[run] = -1.0
        for number in range(-1, plane.size):
            row, col = divmod(max(number, first if number < 0 else 0), plane.shape[1])
            if most[row, col] <= gains[run]:
                continue
            for offset in range(tables.shape[1]):
                gain = around(plane, tables[0, offset], row, col)
                if gain > gains[run]:
                    gains[run] = gain
                    places[run, 0], places[run, 1], places[run, 2] = row, col, offset


@compiled
def gains_at(mass: np.ndarray, tables: np.ndarray, places: np.ndarray, gains: np.ndarray) -> None:
    """Write the gains (n,) of places (n, 3)."""
    for run in range(len(mass)):
        row, col, offset = places[run]
        gains[run] = around(mass[run], tables[0, offset], row, col)


@compiled
def centres(mass: np.ndarray, tables: np.ndarray, places: np.ndarray, middle: np.ndarray) -> None:
    """Write row and column (n, 2) of the mean of the mass within the cutoff of places (n, 3)."""
    for run in range(len(mass)):
        row, col, offset = places[run]
        inside = around(mass[run], tables[1, offset], row, col)
        middle[run, 0] = row + around(mass[run], tables[2, offset], row, col) / inside
        middle[run, 1] = col + around(mass[run], tables[3, offset], row, col) / inside
