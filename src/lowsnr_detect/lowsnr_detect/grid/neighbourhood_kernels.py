# SPDX-License-Identifier: Apache-2.0
"""Loops over neighbourhoods of the cells of one plane (rows, cols)."""

from __future__ import annotations

from lowsnr_common.core.compiled import compiled
import numpy as np


@compiled
def box_sums(plane: np.ndarray, reach: int) -> np.ndarray:
    """Return the sums of a plane within ``reach`` cells on each side of every cell."""
    rows, cols = plane.shape
    part, sums = np.zeros_like(plane), np.zeros_like(plane)
    for row in range(rows):
        total = part[row]
        for near in range(max(row - reach, 0), min(row + reach + 1, rows)):
            here = plane[near]
            for col in range(cols):
                total[col] += here[col]
    most = min(reach, cols - 1)
    for row in range(rows):
        for shift in range(-most, most + 1):
            here, into = part[row, max(shift, 0):], sums[row, max(-shift, 0):]
            for col in range(cols - abs(shift)):
                into[col] += here[col]
    return sums


@compiled
def objects(mass: np.ndarray, bound: float, cells: np.ndarray, found: np.ndarray) -> int:
    """
    Find objects one after the other: the 3 x 3 cells that hold most of the mass that is left.

    Writes the middle cells (n, 2) and the mass (n,) of their 3 x 3 cells, and returns how many
    they are; all but the first have a mass of at least ``bound``.
    """
    rows, cols = mass.shape
    left, near, most = mass.copy(), box_sums(mass, 1), np.empty(rows)
    for row in range(rows):
        most[row] = near[row].max()
    for count in range(len(cells)):
        row = int(most.argmax())
        if count > 0 and most[row] < bound:
            return count
        col = int(near[row].argmax())
        cells[count, 0], cells[count, 1], found[count] = row, col, most[row]
        left[max(row - 1, 0):row + 2, max(col - 1, 0):col + 2] = 0.0
        for down in range(max(row - 2, 0), min(row + 3, rows)):
            for across in range(max(col - 2, 0), min(col + 3, cols)):
                near[down, across] = left[
                    max(down - 1, 0):down + 2, max(across - 1, 0):across + 2].sum()
            most[down] = near[down].max()
    return len(cells)


@compiled
def predicted_objects(
    planes: np.ndarray, scale: np.ndarray, step: np.ndarray, first_entry: np.ndarray,
    source: np.ndarray, prob: np.ndarray, cells: np.ndarray, owner: np.ndarray,
    owned: np.ndarray,
) -> None:
    """
    Write the predicted mass of every object around its middle cell, (n, side, side).

    An object has the mass of the 3 x 3 cells around its middle that are nearer to it than to
    another, and ``owner`` (rows, cols) gets its number, -1 elsewhere.  ``planes`` (C, rows,
    cols) and ``scale`` (rows, cols) are before the prediction; the rest is as in
    :class:`lowsnr_detect.grid.transitions.Transitions`.
    """
    rows, cols = scale.shape
    half = owned.shape[1] // 2
    owner[:] = -1
    nearest = np.full(scale.shape, 3)
    for number, (row, col) in enumerate(cells):
        for down in range(max(row - 1, 0), min(row + 2, rows)):
            for across in range(max(col - 1, 0), min(col + 2, cols)):
                distance = (down - row)**2 + (across - col)**2
                if distance < nearest[down, across]:
                    nearest[down, across], owner[down, across] = distance, number
    for number, (row, col) in enumerate(cells):
        for down in range(max(row - 1, 0), min(row + 2, rows)):
            for across in range(max(col - 1, 0), min(col + 2, cols)):
                if owner[down, across] == number:
                    for group in range(len(step)):
                        value = 0.0
                        for entry in range(first_entry[group], first_entry[group + 1]):
                            value += prob[entry] * planes[source[entry], down, across]
                        owned[
                            number, down - row + step[group, 0] + half,
                            across - col + step[group, 1] + half] += (
                                scale[down, across] * value)


@compiled
def add_windows(owned: np.ndarray, cells: np.ndarray, plane: np.ndarray) -> None:
    """Add values around cells, (n, side, side), to a plane; outside the frame are none."""
    rows, cols = plane.shape
    side = owned.shape[1]
    for number in range(len(cells)):
        top, left = cells[number, 0] - side // 2, cells[number, 1] - side // 2
        for row in range(max(top, 0), min(top + side, rows)):
            for col in range(max(left, 0), min(left + side, cols)):
                plane[row, col] += owned[number, row - top, col - left]


@compiled
def update_objects(
    owned: np.ndarray, cells: np.ndarray, occupied: np.ndarray, likelihood: np.ndarray,
    least: float,
) -> None:
    """Replace the predicted mass of every object by its posterior, in place."""
    rows, cols = likelihood.shape
    side = owned.shape[1]
    for number in range(len(cells)):
        top, left = cells[number, 0] - side // 2, cells[number, 1] - side // 2
        before, after = 0.0, 0.0
        for row in range(max(top, 0), min(top + side, rows)):
            for col in range(max(left, 0), min(left + side, cols)):
                own, ratio = owned[number, row - top, col - left], likelihood[row, col]
                others = min(max(occupied[row, col] - own, 0.0), 1.0)
                weighed = own * ratio / (1.0 - others + others * ratio)
                owned[number, row - top, col - left] = weighed
                before += own
                after += weighed
        owned[number] /= max(1.0 - before, least) + after
