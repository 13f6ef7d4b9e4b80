# SPDX-License-Identifier: Apache-2.0
"""
From deviations of pixels to cells: a matched filter, bins, and the noise of the cells.

This is the definition in NumPy; :mod:`lowsnr_sensor.conditioning.kernels` holds compiled loops.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

from lowsnr_sensor.conditioning.pixels import BLOCK
from lowsnr_sensor.conditioning.pixels import expand
from lowsnr_sensor.conditioning.pixels import MEAN_SQUARE
from lowsnr_sensor.conditioning.pixels import NOISE_LIMIT
import numpy as np
import scipy

# A cell may exceed the first, only up to the second times what was near it in the frame before: of
# the two dozen cells there white noise brings one to 2, and must not explain a cosmic ray.
TRANSIENT, BRIGHTER = 3.5, 1.25
# Cells that hold less of the matched filter's energy than this are not observed.
_LEAST_ENERGY = 0.25


def transients_limited(cells: np.ndarray, before: np.ndarray, reach: int) -> np.ndarray:
    """
    Limit cells that nothing within ``reach`` of them in the frame before explains, (rows, cols).

    An object was near its place in the frame before, about as bright; a cosmic ray was not.
    """
    near = scipy.ndimage.maximum_filter(before, 2 * reach + 1, mode='nearest')
    limited: np.ndarray = np.minimum(cells, np.maximum(TRANSIENT, BRIGHTER * near))
    return limited


class Taps(NamedTuple):
    """
    The filter along one axis: of bins, or of the pixels of a shifted frame.

    Cell n is the sum of ``weights`` times the pixels from ``start + stride * n`` on, times
    ``scale[n]``, which makes the noise of a cell at the border that of any other.
    """

    weights: np.ndarray
    start: int
    stride: int
    scale: np.ndarray


@functools.lru_cache(maxsize=16)
def taps(size: int, cells: int, binning: int, width: float, shift: float) -> Taps:
    """
    Return the matched filter along an axis of ``size`` pixels, for ``cells`` cells.

    It is a Gaussian point spread whose standard deviation is ``width`` pixels, bins included, and
    normalised to unit noise.  The centre of cell n is pixel ``binning * n + (binning - 1) / 2 -
    shift``, which may lie between pixels: the filter interpolates.

    """
    own = math.sqrt(max(width**2 - (binning**2 - 1) / 12.0, 0.01))
    reach = math.ceil(binning / 2.0 + 3.0 * own)
    centre = (binning - 1) / 2.0 - shift
    start = math.ceil(centre) - reach
    place = start + np.arange(2 * reach) - centre
    edges = scipy.special.ndtr((place + np.array([[0.5], [-0.5]]) * binning) / own)
    weights = edges[0] - edges[1]
    weights /= math.sqrt(np.sum(weights**2))
    at = start + binning * np.arange(cells)[:, None] + np.arange(len(weights))
    energy = ((at >= 0) & (at < size)) @ weights**2
    scale = np.where(energy < _LEAST_ENERGY, 0.0, 1.0 / np.sqrt(np.maximum(energy, _LEAST_ENERGY)))
    return Taps(weights.astype(np.float32), start, binning, scale.astype(np.float32))


def filtered(values: np.ndarray, rows: Taps, cols: Taps) -> np.ndarray:
    """Return the cells of limited pixels, (rows, cols), of unit noise for white noise."""
    plane: np.ndarray = along(along(values, rows).T, cols).T
    return plane


def along(values: np.ndarray, axis: Taps) -> np.ndarray:
    """Apply a filter along the first axis of a plane."""
    at = axis.start + axis.stride * np.arange(len(axis.scale))
    plane = np.zeros((len(at), values.shape[1]), dtype=values.dtype)
    for tap, weight in enumerate(axis.weights):
        inside = (at + tap >= 0) & (at + tap < len(values))
        plane[inside] += weight * values[at[inside] + tap]
    filtered_plane: np.ndarray = plane * axis.scale[:, None]
    return filtered_plane


def flattened(plane: np.ndarray, reach: int) -> np.ndarray:
    """
    Subtract the mean of the surroundings, and restore the variance of white noise.

    With n cells in the mean, the cell itself included, ``1 - 1 / n`` of the variance is left.
    ``reach`` 0 returns the plane unchanged.

    """
    count = box_count(plane.shape, reach)
    if reach == 0 or count.max(initial=1.0) == 1.0:
        return plane
    side = 2 * reach + 1
    total = scipy.ndimage.uniform_filter(
        plane.astype(float), side, mode='constant') * float(side**2)
    flat: np.ndarray = np.where(
        plane != 0.0, (plane - total / count) / np.sqrt(1.0 - 1.0 / np.maximum(count, 2.0)), 0.0)
    return flat


def box_count(shape: tuple[int, ...], reach: int) -> np.ndarray:
    """Return the number of cells of a frame within ``reach`` of each, (rows, cols)."""
    counts = [
        np.minimum(np.arange(size) + reach, size - 1) - np.maximum(np.arange(size) - reach, 0) + 1
        for size in shape[-2:]]
    return np.outer(*counts).astype(float)


def cell_noise(
    flat: np.ndarray, trace: np.ndarray, persistence: float, unit: float, local: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """
    Return cells over their noise, their fading sum, and sums and numbers of limited squares.

    Noise that stays in place counts for more than white noise: it is estimated from the fading
    sum ``trace = persistence * trace + flat``, whose variance is ``unit`` for white noise.

    Parameters
    ----------
    flat, trace : (rows, cols) ndarray
        Cells, and the sum before them; cells that are exactly zero are not observed.
    persistence, unit
        As above.
    local : (rows // 4, cols // 4) ndarray
        Variance of each block of cells.

    """
    trace = persistence * trace + flat
    variance, known = expand(local, flat.shape, (0, 0)), flat != 0.0
    squares = variance * np.minimum(
        trace**2 / (unit * variance), NOISE_LIMIT**2) / MEAN_SQUARE
    total, count = np.zeros((2, *local.shape))
    rows, cols = (np.arange(size) // BLOCK for size in flat.shape)
    places = tuple(np.broadcast_arrays(rows[:, None], cols))
    np.add.at(total, places, np.where(known, squares, 0.0))
    np.add.at(count, places, known)
    return flat / np.sqrt(variance), trace, total, count
