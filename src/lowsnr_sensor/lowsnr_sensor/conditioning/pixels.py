# SPDX-License-Identifier: Apache-2.0
"""
The recursion of a pixel: level, variance, and the deviation of a frame in units of the noise.

This is the definition in NumPy; :mod:`lowsnr_sensor.conditioning.kernels` holds compiled loops.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
import math
from typing import NamedTuple

import numpy as np

# Side of the squares over which the variance is averaged first [pixels, and cells].
BLOCK = 4
# Values at least as large are no measurements: a blank pixel, or one beyond float32.
UNOBSERVED = 1e30
# Limit of values in the estimate of a variance [standard deviations] (Huber's second proposal).
NOISE_LIMIT = 2.5
# Frames after which the limit of the level is at twice its final value; it falls as 1 / age^2.
OPEN_LIMIT = 8.0
# Share of a pixel's own variance that counts beside its surroundings, and the frames to trust it.
OWN, OWN_AGE = 0.7, 10.0
# Values that a median is taken of, about.
_SOME = 2_048
# A pixel's variance counts in that of its surroundings up to so many times that.
BLOCK_LIMIT = 4.0


def mean_limited_square() -> float:
    """Return the mean of ``min(x^2, NOISE_LIMIT^2)`` for unit normal x."""
    beyond = math.erfc(NOISE_LIMIT * math.sqrt(0.5)) / 2.0
    density = math.exp(-NOISE_LIMIT**2 / 2.0) / math.sqrt(2.0 * math.pi)
    return 1.0 - 2.0 * (beyond + NOISE_LIMIT * density) + 2.0 * NOISE_LIMIT**2 * beyond


MEAN_SQUARE = mean_limited_square()


class Planes(NamedTuple):
    """
    What is known of each pixel, (rows, cols) of float32.

    ``level`` is its mean and ``variance`` that of its noise, in units of the frame; ``age`` is the
    number of frames in which it was observed, up to that over which the variance is estimated.
    """

    level: np.ndarray
    variance: np.ndarray
    age: np.ndarray


@dataclass(frozen=True)
class Change:
    """
    What changed in the whole frame: ``gain * level + offset + wide``, plus rows and columns.

    ``wide`` (rows, cols) is None where it is zero; ``rows`` (rows,) and ``cols`` (cols,) are the
    offsets of stripes in this frame; ``variance`` is the factor by which the noise grew.
    """

    gain: float = 1.0
    offset: float = 0.0
    variance: float = 1.0
    wide: np.ndarray | None = None
    rows: np.ndarray = field(default_factory=lambda: np.zeros(1, np.float32))
    cols: np.ndarray = field(default_factory=lambda: np.zeros(1, np.float32))

    def flat(self, frame: np.ndarray) -> np.ndarray:
        """Return a frame without its wide change and its stripes."""
        rows, cols = self.stripes(frame.shape)
        flat: np.ndarray = self.narrow(frame) - (rows[:, None] + cols)
        return flat

    def narrow(self, frame: np.ndarray) -> np.ndarray:
        """Return a frame without its wide change."""
        return frame if self.wide is None else frame - self.wide

    def stripes(self, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Return the offset of each row and each column of a frame (rows, cols)."""
        # Copies, because to Numba a view that cannot be written is of another type.
        rows, cols = (
            np.array(np.broadcast_to(offsets, size))
            for offsets, size in zip((self.rows, self.cols), shape))
        return rows, cols


class Limits(NamedTuple):
    """
    The constants of the recursion.

    Memory of level and variance [frames]; frames before a deviation counts; limits of the update
    of the level and of the deviation [standard deviations]; least variance; jitter [pixels].
    """

    level_frames: float
    noise_frames: float
    warm_up: float
    level_limit: float
    limit: float
    least: float
    jitter: float


def expand(blocks: np.ndarray, shape: tuple[int, int], corner: tuple[int, int]) -> np.ndarray:
    """Return the value of each pixel's block; pixel (0, 0) is at ``corner`` of the blocks."""
    places = (
        np.clip((np.arange(size) + start) // BLOCK, 0, count - 1)
        for size, start, count in zip(shape, corner, blocks.shape))
    plane: np.ndarray = blocks[np.ix_(*places)]
    return plane


def update(
    frame: np.ndarray, planes: Planes, local: np.ndarray, corner: tuple[int, int], change: Change,
    limits: Limits,
) -> tuple[Planes, np.ndarray]:
    """
    Return the planes after a frame, and the limited deviations in units of the noise.

    A pixel that is not observed keeps its planes, and its deviation is zero.

    Parameters
    ----------
    frame : (rows, cols) ndarray of float32
        The frame.
    planes
        Planes before it, in the same pixels.
    local : (rows // 4, cols // 4) ndarray
        Variance of the surroundings of each block; see :func:`surroundings`.
    corner
        Row and column of pixel (0, 0) in the pixels of the blocks.
    change
        What changed in the whole frame.
    limits
        Constants.

    """
    level, variance, age = planes
    wide = np.float32(0.0) if change.wide is None else change.wide
    flat = change.flat(frame)
    level = change.gain * level + change.offset
    variance = change.variance * variance
    known, count = abs(frame) < UNOBSERVED, np.maximum(age, 1.0)
    own = OWN * age / (age + OWN_AGE) * variance
    around = change.variance * expand(local, frame.shape, corner)
    noise = np.maximum(np.maximum(around, own), limits.least)
    young = OWN_AGE / (age + OWN_AGE)
    noise = noise + young * (limits.jitter * steepness(planes.level))**2
    spread = noise * (1.0 + 1.0 / count)
    value = np.where(known, flat, 0.0)
    deviation = (value - level) / np.sqrt(spread)
    known_before = known & (age > 0.0)
    most = limits.level_limit * (1.0 + OPEN_LIMIT / count**2) * np.sqrt(spread)
    step = np.clip(value - level, -most, most) / np.minimum(age + 1.0, limits.level_frames)
    square = noise * np.minimum(deviation**2, NOISE_LIMIT**2) / MEAN_SQUARE
    after = Planes(
        np.where(known_before, level + step, np.where(known, value, level)) + wide,
        np.where(known_before, variance + (square - variance) / count, variance)
        / change.variance,
        np.where(known, np.minimum(age + 1.0, limits.noise_frames), age))
    shown = known & (age >= limits.warm_up)
    return after, np.where(shown, np.clip(deviation, -limits.limit, limits.limit), 0.0)


def own_variance(planes: Planes, at: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return what the pixels at some places have shown of their own variance."""
    age = planes.age[at]
    own: np.ndarray = OWN * age / (age + OWN_AGE) * planes.variance[at]
    return own


def steepness(plane: np.ndarray) -> np.ndarray:
    """Return the largest difference of each pixel to its four neighbours, (rows, cols)."""
    wide = np.pad(plane, 1, mode='edge')
    sides = wide[:-2, 1:-1], wide[2:, 1:-1], wide[1:-1, :-2], wide[1:-1, 2:]
    most: np.ndarray = np.max([abs(side - plane) for side in sides], axis=0)
    return most


def block_sums(planes: Planes, local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the limited variances of the known pixels in each block, summed, and their number."""
    known = planes.age > 1.0
    most = BLOCK_LIMIT * expand(local, planes.age.shape, (0, 0))
    total, count = np.zeros((2, *local.shape))
    rows, cols = (np.arange(size) // BLOCK for size in planes.age.shape)
    places = tuple(np.broadcast_arrays(rows[:, None], cols))
    np.add.at(total, places, np.where(known, np.minimum(planes.variance, most), 0.0))
    np.add.at(count, places, known)
    return total, count


def surroundings(total: np.ndarray, count: np.ndarray, before: np.ndarray) -> np.ndarray:
    """
    Return the mean variance in the 3 x 3 blocks around each; ``before`` where nothing is known.

    ``total`` and ``count`` are sums and numbers of the values of each block.
    """
    number = _three(_three(count).T).T
    known = number > 0.0
    mean = _three(_three(total).T).T / np.where(known, number, 1.0)
    around: np.ndarray = np.where(known, mean, before).astype(np.float32)
    return around


def some(values: np.ndarray) -> np.ndarray:
    """Return about 2,048 of the values, or all of fewer: enough for a median."""
    return values.ravel()[::max(values.size // _SOME, 1)]


def _three(plane: np.ndarray) -> np.ndarray:
    """Return the sums of three successive rows around each."""
    total = plane.copy()
    total[1:] += plane[:-1]
    total[:-1] += plane[1:]
    return total


def blocks_of(shape: tuple[int, int]) -> tuple[int, int]:
    """Return rows and columns of the blocks that cover a plane."""
    return -(-shape[0] // BLOCK), -(-shape[1] // BLOCK)


def moved_by(plane: np.ndarray, by: tuple[int, int], fill: float) -> np.ndarray:
    """Return ``plane[i + row, j + col]`` for ``by`` = (row, col); ``fill`` beyond its border."""
    if by == (0, 0):
        return plane
    moved = np.empty_like(plane)
    (rows, its_rows), (cols, its_cols) = (
        (slice(max(-step, 0), max(size - max(step, 0), 0)),
         slice(max(step, 0), max(size + min(step, 0), 0)))
        for step, size in zip(by, plane.shape))
    moved[rows, cols] = plane[its_rows, its_cols]
    for border in (np.s_[:rows.start], np.s_[rows.stop:], np.s_[:, :cols.start],
                   np.s_[:, cols.stop:]):
        moved[border] = fill
    return moved
