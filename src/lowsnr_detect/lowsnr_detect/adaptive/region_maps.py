"""Maps of regions of a frame: pooled over neighbours, quantiles, and from regions to cells."""

from __future__ import annotations

from lowsnr_common.core.compiled import compiled
import numpy as np


def pooled(counts: np.ndarray) -> np.ndarray:
    """Add half the counts of the regions beside each, and a quarter of those at its corners."""
    for axis in (1, 2):
        source = np.moveaxis(counts, axis, 0)
        summed = source.copy()
        summed[1:] += 0.5 * source[:-1]
        summed[:-1] += 0.5 * source[1:]
        counts = np.moveaxis(summed, 0, axis)
    return counts


def bin_quantile(counts: np.ndarray, part: float) -> np.ndarray:
    """Return the quantile of each histogram (..., bins), in bins from the first edge."""
    summed = np.cumsum(counts, axis=-1)
    wanted = np.maximum(part * summed[..., -1:], 1e-9)
    number = np.argmax(summed >= wanted, axis=-1)[..., None]
    inside = np.maximum(np.take_along_axis(counts, number, -1), 1e-9)
    left = (np.take_along_axis(summed, number, -1) - wanted) / inside
    return np.asarray((number + 1.0 - np.clip(left, 0.0, 1.0))[..., 0])


def to_cells(values: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return values (R, C) of regions, interpolated at every cell of a frame of a shape."""
    sides = zip(shape, values.shape, strict=True)
    down, across = (_between_centres(np.arange(size), size, parts) for size, parts in sides)
    return np.asarray(_interpolated(values.astype(np.float32), *down, *across))


def at_cells(
    values: np.ndarray, row: np.ndarray, col: np.ndarray, shape: tuple[int, int],
) -> np.ndarray:
    """Return values (R, C) of regions, interpolated at cells (n,) of a frame of a shape."""
    top, bottom, down = _between_centres(row, shape[0], values.shape[0])
    left, right, across = _between_centres(col, shape[1], values.shape[1])
    upper = values[top, left] + across * (values[top, right] - values[top, left])
    lower = values[bottom, left] + across * (values[bottom, right] - values[bottom, left])
    return np.asarray(upper + down * (lower - upper))


def _between_centres(
    cell: np.ndarray, size: int, regions: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the regions whose centres are before and after each cell, and the latter's weight."""
    place = np.clip((cell + 0.5) * regions / size - 0.5, 0.0, regions - 1.0)
    before = place.astype(np.intp)
    return before, np.minimum(before + 1, regions - 1), (place - before).astype(np.float32)


@compiled
def _interpolated(
    values: np.ndarray, top: np.ndarray, bottom: np.ndarray, down: np.ndarray,
    left: np.ndarray, right: np.ndarray, across: np.ndarray,
) -> np.ndarray:
    """Return the values between the centres of regions around each row and column."""
    out = np.empty((len(top), len(left)), np.float32)
    for row in range(len(top)):
        line = values[top[row]] + down[row] * (values[bottom[row]] - values[top[row]])
        for col in range(len(left)):
            before = line[left[col]]
            out[row, col] = before + across[col] * (line[right[col]] - before)
    return out
