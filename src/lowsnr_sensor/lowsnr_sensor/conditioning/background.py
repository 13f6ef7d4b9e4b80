"""Background of a frame in time and in space, and its noise."""

from __future__ import annotations

import math

import numpy as np
import scipy

# Limit of deviations from the median in the estimate of the level [standard deviations].
_LEVEL_LIMIT = 2.0
# Limit of values in the estimate of the noise [standard deviations].
_NOISE_LIMIT = 2.5


def past_median(history: np.ndarray) -> np.ndarray:
    """Return the median over frames (n, ..., rows, cols); an even n drops the oldest frame."""
    odd = history[1 - len(history) % 2:]
    middle = len(odd) // 2
    median: np.ndarray = np.partition(odd, middle, axis=0)[middle]
    return median


def past_level(history: np.ndarray, median: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """
    Return the level of past frames: nearly as precise as their mean, and robust to outliers.

    It is one step of Huber's estimate of location from the median (Huber 1964).  For n frames of
    white noise its variance is ``1 / n`` of that of one, within 2 % for n from 3 on; that of the
    median is up to 1.57 times as large.  As with the mean, its error and the noise of the frames
    in it cancel in the residuals of successive frames, which stay white in time.

    Parameters
    ----------
    history : (n, ..., rows, cols) ndarray
        Past frames.
    median : (..., rows, cols) ndarray
        Their median.
    noise : (..., rows, cols) ndarray
        Standard deviation of the noise in a frame.

    """
    limit = (_LEVEL_LIMIT * noise).astype(history.dtype)
    deviation = history - median
    np.clip(deviation, -limit, limit, out=deviation)
    level: np.ndarray = (
        median + deviation.mean(axis=0) / (2.0 * scipy.special.ndtr(_LEVEL_LIMIT) - 1.0))
    return level


def steepness(plane: np.ndarray) -> np.ndarray:
    """
    Return the largest difference of each pixel to its four neighbours, (..., rows, cols).

    The pixels on both sides of an edge have it.
    """
    slope = np.zeros_like(plane)
    for axis in (-1, -2):
        side, step = np.moveaxis(slope, axis, -1), np.moveaxis(abs(np.diff(plane, axis=axis)),
                                                               axis, -1)
        for part in (side[..., :-1], side[..., 1:]):
            np.maximum(part, step, out=part)
    return slope


def box_mean(plane: np.ndarray, reach: int) -> np.ndarray:
    """Return the mean over the cells of the frame within ``reach`` rows and columns."""
    side = 2 * reach + 1
    size = (1,) * (plane.ndim - 2) + (side, side)
    total = scipy.ndimage.uniform_filter(plane, size, mode='constant') * side**2
    if plane.min() >= 0.0:
        # The filter's running sums may leave a rounding error below zero.
        total = np.maximum(total, 0.0)
    mean: np.ndarray = total / box_count(plane.shape, reach)
    return mean


def box_count(shape: tuple[int, ...], reach: int) -> np.ndarray:
    """Return the number of cells of a frame within ``reach`` of each, (rows, cols)."""
    counts = [
        np.minimum(np.arange(size) + reach, size - 1) - np.maximum(np.arange(size) - reach, 0) + 1
        for size in shape[-2:]]
    return np.outer(*counts).astype(float)


def flattened(plane: np.ndarray, reach: int) -> np.ndarray:
    """
    Subtract the mean of the surroundings, and restore the variance of white noise.

    With n cells in the mean, the cell itself included, ``1 - 1 / n`` of the variance is left.
    ``reach`` 0 returns the plane unchanged.

    """
    count = box_count(plane.shape, reach)
    if reach == 0 or count.max() == 1.0:
        return plane
    flat: np.ndarray = (plane - box_mean(plane, reach)) / np.sqrt(1.0 - 1.0 / count)
    return flat


def binned(plane: np.ndarray, side: int) -> np.ndarray:
    """
    Return sums over squares of ``side`` x ``side`` cells, divided by ``side``.

    White noise keeps its standard deviation.  Rows and columns that fill no square are left out.

    """
    rows, cols = (size // side for size in plane.shape[-2:])
    cut = plane[..., :rows * side, :cols * side]
    total: np.ndarray = cut.reshape(
        *plane.shape[:-2], rows, side, cols, side).sum(axis=(-3, -1))
    return total / side


def frame_scale(plane: np.ndarray) -> np.ndarray:
    """Return the noise of a frame around zero from its median absolute value, (..., 1, 1)."""
    deviation = np.median(abs(plane), axis=(-2, -1), keepdims=True)
    scale: np.ndarray = deviation / scipy.special.ndtri(0.75)
    return scale


def limited_square(values: np.ndarray) -> np.ndarray:
    """
    Return squares of limited values, with mean one for unit normal values.

    This is Huber's second proposal (1964): a value beyond the limit counts as the limit.

    """
    beyond = scipy.special.ndtr(-_NOISE_LIMIT)
    density = math.exp(-_NOISE_LIMIT**2 / 2.0) / math.sqrt(2.0 * math.pi)
    mean = 1.0 - 2.0 * (beyond + _NOISE_LIMIT * density) + 2.0 * _NOISE_LIMIT**2 * beyond
    squares: np.ndarray = np.minimum(values**2, _NOISE_LIMIT**2) / mean
    return squares
