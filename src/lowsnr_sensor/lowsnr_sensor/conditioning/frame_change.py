# SPDX-License-Identifier: Apache-2.0
"""What changes in a frame as a whole: its level, gain, noise and stripes, and its encoding."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math

from lowsnr_sensor.conditioning.pixels import Change
from lowsnr_sensor.conditioning.pixels import MEAN_SQUARE
from lowsnr_sensor.conditioning.pixels import NOISE_LIMIT
from lowsnr_sensor.conditioning.pixels import Planes
from lowsnr_sensor.conditioning.pixels import UNOBSERVED
import numpy as np

StripeSums = Callable[
    [np.ndarray, Planes, Change, float], tuple[np.ndarray, np.ndarray]]

# Pixels that are looked at to find what changes in the whole frame, about.
_SAMPLE = 8_192
# Side of the squares whose level may change together [pixels], and the change that is left to the
# recursion of the pixels [standard deviations].
_WIDE, _LEFT_ALONE = 16, 1.0
# Limit of the median of n unit normal values times the root of n: five standard deviations.
_MEDIAN_LIMIT = 6.3
# Stripes are corrected if their mean square exceeds that from noise by this factor.
_STRIPES = 1.5
# Limit of a pixel in the offset of its row and column [standard deviations].
_STRIPE_LIMIT = 4.0
# Rounds in which stripes are found, at most.
_STRIPE_ROUNDS = 4
# Noise of a frame, over that of the frames before, at which it is taken to be different.
_LOUDER, _QUIETER, _KNOWN = 1.5, 0.5, 0.6


def sample_step(shape: tuple[int, int]) -> int:
    """Return the distance of the pixels that are looked at."""
    return max(1, round(math.sqrt(shape[0] * shape[1] / _SAMPLE)))


def mean_square(ratio: np.ndarray, factor: float = 1.0) -> float:
    """Return the limited mean square of deviations, one for unit normal ones."""
    known = ratio[np.isfinite(ratio)]
    squares = np.minimum(known**2 / factor, NOISE_LIMIT**2)
    return float(squares.mean()) / MEAN_SQUARE if known.size else 0.0


def noise_growth(ratio: np.ndarray, usual: float) -> float:
    """
    Return the factor of the variance of a frame whose noise differs from what was expected.

    ``ratio`` are its deviations in units of the expected noise, ``usual`` their mean square in the
    frames before.  It is one unless the difference is large.

    """
    found, wanted = mean_square(ratio), max(usual, 1.0)
    if _QUIETER * usual < found < _LOUDER * wanted or (found < usual < _KNOWN):
        return 1.0
    if found < usual:
        return max(found / usual, 0.01)
    growth = 1.0
    for _ in range(12):
        growth *= max(mean_square(ratio, growth) / wanted, 1.0)
    return growth


def wide_change(residual: np.ndarray, noise: np.ndarray, step: int, shape: tuple[int, int],
                ) -> np.ndarray | None:
    """
    Return the change of level of parts of the frame, (rows, cols), or None where there is none.

    It is the median over squares, less what is within the noise, and linear between their centres.

    Parameters
    ----------
    residual, noise : (n, m) ndarray
        Every ``step`` th pixel without the known level, NaN if unknown; its standard deviation.
    step, shape
        Distance of these pixels, and the size of the frame.

    """
    side = max(_WIDE // step, 4)
    parts = [size // side for size in residual.shape]
    if 0 in parts:
        return None
    ratio, spread = (
        plane[:parts[0] * side, :parts[1] * side].reshape(parts[0], side, parts[1], side)
        .transpose(0, 2, 1, 3).reshape(*parts, side**2)
        for plane in (np.nan_to_num(residual / noise), noise))
    middle = np.median(ratio, axis=-1)
    within = max(_LEFT_ALONE, _MEDIAN_LIMIT / side)
    change = np.sign(middle) * np.maximum(abs(middle) - within, 0.0)
    if not change.any():
        return None
    change *= np.median(spread, axis=-1)
    along = [
        _linear(np.arange(size), (np.arange(count) * side + (side - 1) / 2.0) * step)
        for size, count in zip(shape, parts)]
    wide: np.ndarray = along[0] @ change @ along[1].T
    return wide.astype(np.float32)


def _linear(places: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Return the matrix (places, centres) of linear interpolation, constant beyond the centres."""
    return np.stack([np.interp(places, centres, unit) for unit in np.eye(len(centres))], axis=1)


def stripe_sums(
    frame: np.ndarray, planes: Planes, change: Change, limit: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the sums over rows and columns of the limited residual of the known pixels."""
    rest = change.flat(frame) - (change.gain * planes.level + change.offset)
    known = (abs(frame) < UNOBSERVED) & (planes.age > 0.0)
    rest = np.where(known, np.clip(rest, -limit, limit), 0.0)
    return rest.sum(axis=1), rest.sum(axis=0)


def with_stripes(
    change: Change, frame: np.ndarray, planes: Planes, spread: float, sums: StripeSums,
) -> Change:
    """
    Return the change of a frame with the offsets of its rows and columns.

    They are zero unless they are significant, and shrunk by the share of noise in them (James and
    Stein 1961).  Since pixels are limited, large offsets take more than one round.

    Parameters
    ----------
    change
        The change so far.
    frame, planes
        The frame, and the planes before it in its pixels.
    spread
        Noise of a pixel.
    sums
        :func:`stripe_sums`, or its compiled equal.

    """
    rows, cols = (np.zeros(size, np.float32) for size in frame.shape)
    for _ in range(_STRIPE_ROUNDS):
        more = sums(frame, planes, change, _STRIPE_LIMIT * spread)
        down, right = (
            _shrunk(total / count, count, spread)
            for total, count in zip(more, (len(cols), len(rows))))
        if not (down.any() or right.any()):
            break
        rows, cols = rows + down, cols + right
        change = replace(change, rows=rows, cols=cols)
    return change


def _shrunk(means: np.ndarray, count: int, spread: float) -> np.ndarray:
    """Return means of ``count`` values less their noise, or zeros if they are all noise."""
    excess = float(np.mean(means**2)) * count / spread**2
    found = min(len(means), count) >= 4 and excess > _STRIPES
    offsets: np.ndarray = means * np.float32(1.0 - 1.0 / excess if found else 0.0)
    return offsets
