"""What a frame holds beside objects: its background in time and in space, and its noise."""

from __future__ import annotations

import math

import numpy as np
from scipy import ndimage
from scipy import special

# Deviations from the median that count in full towards the level, in standard deviations.
_BULK = 2.0
# Values that count in full towards the noise, in standard deviations.
_REGULAR = 2.5


def past_median(history: np.ndarray) -> np.ndarray:
    """Return the median over frames (n, ..., rows, cols); of an even number without the oldest."""
    odd = history[1 - len(history) % 2:]
    middle = len(odd) // 2
    return np.partition(odd, middle, axis=0)[middle]


def past_level(history: np.ndarray, median: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """
    Return the level of past frames: nearly as precise as their mean, unmoved by what passes.

    One step of Huber's estimate of location from the median (Huber 1964).  Of n frames of white
    noise its variance is ``1 / n`` of that of one, within 2 % for n from 3 on, where that of
    the median is up to 1.57 times as much.  As with the mean, its error and the noise of the
    frames in it cancel in the residuals of successive frames, which stay white in time.

    Parameters
    ----------
    history : (n, ..., rows, cols) ndarray
        Past frames.
    median : (..., rows, cols) ndarray
        Their median.
    noise : (..., rows, cols) ndarray
        Standard deviation of the noise in a frame.

    """
    most = (_BULK * noise).astype(history.dtype)
    away = history - median
    np.clip(away, -most, most, out=away)
    return median + away.mean(axis=0) / (2.0 * special.ndtr(_BULK) - 1.0)


def steepness(plane: np.ndarray) -> np.ndarray:
    """
    Return how much a plane changes from a pixel to the next, (..., rows, cols).

    It is the largest difference to any of the four neighbours, so that both sides of an edge
    have it.
    """
    slope = np.zeros_like(plane)
    for axis in (-1, -2):
        side, step = np.moveaxis(slope, axis, -1), np.moveaxis(abs(np.diff(plane, axis=axis)),
                                                               axis, -1)
        for part in (side[..., :-1], side[..., 1:]):
            np.maximum(part, step, out=part)
    return slope


def box_mean(plane: np.ndarray, reach: int) -> np.ndarray:
    """Return the mean over the cells within ``reach`` rows and columns that are in the frame."""
    side = 2 * reach + 1
    size = (1,) * (plane.ndim - 2) + (side, side)
    total = ndimage.uniform_filter(plane, size, mode='constant') * side**2
    if plane.min() >= 0.0:
        # The filter's running sums may leave a rounding error below zero.
        total = np.maximum(total, 0.0)
    return total / box_count(plane.shape, reach)


def box_count(shape: tuple[int, ...], reach: int) -> np.ndarray:
    """Return how many cells of a frame are within ``reach`` of each, (rows, cols)."""
    counts = [
        np.minimum(np.arange(size) + reach, size - 1) - np.maximum(np.arange(size) - reach, 0) + 1
        for size in shape[-2:]]
    return np.outer(*counts).astype(float)


def flattened(plane: np.ndarray, reach: int) -> np.ndarray:
    """
    Take off the mean of the surroundings, with white noise kept at its variance.

    Of n cells in the mean, the cell itself among them, ``1 - 1 / n`` of the variance is left.
    ``reach`` 0 leaves the plane as it is.

    """
    count = box_count(plane.shape, reach)
    if reach == 0 or count.max() == 1.0:
        return plane
    return (plane - box_mean(plane, reach)) / np.sqrt(1.0 - 1.0 / count)


def binned(plane: np.ndarray, side: int) -> np.ndarray:
    """
    Return sums over squares of ``side`` cells on a side, divided by ``side``.

    The noise of white cells keeps its standard deviation.  Rows and columns that fill no square
    are left out.

    """
    rows, cols = (size // side for size in plane.shape[-2:])
    cut = plane[..., :rows * side, :cols * side]
    return cut.reshape(*plane.shape[:-2], rows, side, cols, side).sum(axis=(-3, -1)) / side


def frame_scale(plane: np.ndarray) -> np.ndarray:
    """Return the noise of a frame around zero by its median absolute value, (..., 1, 1)."""
    return np.median(abs(plane), axis=(-2, -1), keepdims=True) / special.ndtri(0.75)


def limited_square(values: np.ndarray) -> np.ndarray:
    """
    Return squares that no outlier dominates, with mean one for unit normal values.

    Huber's second proposal (1964): what lies beyond a limit counts as if it lay there.

    """
    beyond = special.ndtr(-_REGULAR)
    density = math.exp(-_REGULAR**2 / 2.0) / math.sqrt(2.0 * math.pi)
    mean = 1.0 - 2.0 * (beyond + _REGULAR * density) + 2.0 * _REGULAR**2 * beyond
    return np.minimum(values**2, _REGULAR**2) / mean
