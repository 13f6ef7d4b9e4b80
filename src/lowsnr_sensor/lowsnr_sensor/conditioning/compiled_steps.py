# SPDX-License-Identifier: Apache-2.0
"""The steps that pixels, cells and frame_change define, computed by the compiled loops."""

from __future__ import annotations

from lowsnr_sensor.conditioning import cell_kernels
from lowsnr_sensor.conditioning import cells
from lowsnr_sensor.conditioning import pixel_kernels
from lowsnr_sensor.conditioning import pixels
from lowsnr_sensor.conditioning.pixels import Planes
import numpy as np


def update(
    frame: np.ndarray, planes: Planes, local: np.ndarray, corner: tuple[int, int],
    change: pixels.Change, limits: pixels.Limits,
) -> tuple[Planes, np.ndarray]:
    """Compute :func:`lowsnr_sensor.conditioning.pixels.update`."""
    after = Planes(*(np.empty_like(frame) for _ in range(3)))
    deviations = np.empty_like(frame)
    scalars = tuple(np.float32(value) for value in (
        change.gain, change.offset, change.variance, *limits,
        pixels.UNOBSERVED, pixels.NOISE_LIMIT**2, pixels.MEAN_SQUARE, pixels.OWN, pixels.OWN_AGE,
        pixels.OPEN_LIMIT))
    pixel_kernels.update(change.flat(frame), *planes, local, corner, scalars, *after, deviations)
    if change.wide is not None:
        after.level[:] += change.wide
    return after, deviations


def stripe_sums(
    frame: np.ndarray, planes: Planes, change: pixels.Change, limit: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute :func:`lowsnr_sensor.conditioning.frame_change.stripe_sums`."""
    rows, cols = (np.zeros(size, dtype=np.float32) for size in frame.shape)
    scalars = np.array(
        [change.gain, change.offset, limit, pixels.UNOBSERVED], dtype=np.float32)
    pixel_kernels.stripe_sums(change.flat(frame), planes.level, planes.age, scalars, rows, cols)
    return rows, cols


def block_sums(planes: Planes, local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute :func:`lowsnr_sensor.conditioning.pixels.block_sums`."""
    total, count = np.empty_like(local), np.empty_like(local)
    most = np.float32(pixels.BLOCK_LIMIT) * local
    pixel_kernels.block_sums(planes.variance, planes.age, 1.0, most, total, count)
    return total, count


def surroundings(total: np.ndarray, count: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Compute :func:`lowsnr_sensor.conditioning.pixels.surroundings`."""
    mean = np.empty_like(before)
    pixel_kernels.surroundings(total, count, before, mean)
    return mean


def filtered(values: np.ndarray, rows: cells.Taps, cols: cells.Taps) -> np.ndarray:
    """Compute :func:`lowsnr_sensor.conditioning.cells.filtered`."""
    out = np.empty((len(rows.scale), len(cols.scale)), dtype=np.float32)
    cell_kernels.filter_pixels(
        values, rows.weights, rows.start, rows.scale, cols.weights, cols.start, cols.scale,
        rows.stride, out)
    return out


def flattened(plane: np.ndarray, reach: int) -> np.ndarray:
    """Compute :func:`lowsnr_sensor.conditioning.cells.flattened`."""
    if reach == 0:
        return plane
    flat = np.empty_like(plane)
    cell_kernels.flatten(plane, reach, flat)
    return flat


def cell_noise(
    flat: np.ndarray, trace: np.ndarray, persistence: float, unit: float, local: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Compute :func:`lowsnr_sensor.conditioning.cells.cell_noise`."""
    out, new_trace = np.empty_like(flat), np.empty_like(flat)
    total, count = np.empty_like(local), np.empty_like(local)
    cell_kernels.cell_noise(
        flat, trace, persistence, unit, local, (pixels.NOISE_LIMIT**2, pixels.MEAN_SQUARE), out,
        new_trace, total, count)
    return out, new_trace, total, count


def transients_limited(values: np.ndarray, before: np.ndarray, reach: int) -> np.ndarray:
    """Compute :func:`lowsnr_sensor.conditioning.cells.transients_limited`."""
    out = np.empty_like(values)
    scalars = (np.float32(cells.TRANSIENT), np.float32(cells.BRIGHTER))
    cell_kernels.limit_transients(values, before, reach, scalars, out)
    return out
