# SPDX-License-Identifier: Apache-2.0
"""
The steps that pixels, cells and frame_change define, computed by the compiled loops.

``regions`` is the number of threads that share the rows; it changes no bit of the result.
"""

from __future__ import annotations

from lowsnr_common.images.bands import in_bands
from lowsnr_sensor.conditioning import cell_kernels
from lowsnr_sensor.conditioning import cells
from lowsnr_sensor.conditioning import pixel_kernels
from lowsnr_sensor.conditioning import pixels
from lowsnr_sensor.conditioning.pixels import Planes
import numpy as np


def update(
    frame: np.ndarray, planes: Planes, local: np.ndarray, corner: tuple[int, int],
    change: pixels.Change, limits: pixels.Limits, regions: int = 1,
) -> tuple[Planes, np.ndarray]:
    """Compute :func:`lowsnr_sensor.conditioning.pixels.update`."""
    after = Planes(*(np.empty_like(frame) for _ in range(3)))
    deviations = np.empty_like(frame)
    scalars = tuple(np.float32(value) for value in (
        change.gain, change.offset, change.variance, *limits,
        pixels.UNOBSERVED, pixels.NOISE_LIMIT**2, pixels.MEAN_SQUARE, pixels.OWN, pixels.OWN_AGE,
        pixels.OPEN_LIMIT))
    narrow, stripes = change.narrow(frame), change.stripes(frame.shape)
    in_bands(
        lambda first, last: pixel_kernels.update(
            narrow, stripes, *planes, local, corner, scalars, first, last, *after, deviations),
        len(frame), regions)
    if change.wide is not None:
        after.level[:] += change.wide
    return after, deviations


def stripe_sums(
    frame: np.ndarray, planes: Planes, change: pixels.Change, limit: float, regions: int = 1,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute :func:`lowsnr_sensor.conditioning.frame_change.stripe_sums`."""
    rows, group = np.zeros(len(frame), dtype=np.float32), pixel_kernels.GROUP
    groups = np.zeros((-(-len(frame) // group), frame.shape[1]), dtype=np.float32)
    scalars = np.array(
        [change.gain, change.offset, limit, pixels.UNOBSERVED], dtype=np.float32)
    narrow, stripes = change.narrow(frame), change.stripes(frame.shape)
    in_bands(
        lambda first, last: pixel_kernels.stripe_sums(
            narrow, stripes, planes.level, planes.age, scalars, first, last, rows, groups),
        len(frame), regions, multiple=group)
    return rows, groups.sum(axis=0)


def block_sums(
    planes: Planes, local: np.ndarray, regions: int = 1,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute :func:`lowsnr_sensor.conditioning.pixels.block_sums`."""
    total, count = np.empty_like(local), np.empty_like(local)
    most = np.float32(pixels.BLOCK_LIMIT) * local
    in_bands(
        lambda first, last: pixel_kernels.block_sums(
            planes.variance, planes.age, 1.0, most, first, last, total, count),
        len(local), regions)
    return total, count


def surroundings(total: np.ndarray, count: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Compute :func:`lowsnr_sensor.conditioning.pixels.surroundings`."""
    mean = np.empty_like(before)
    pixel_kernels.surroundings(total, count, before, mean)
    return mean


def filtered(
    values: np.ndarray, rows: cells.Taps, cols: cells.Taps, regions: int = 1,
) -> np.ndarray:
    """Compute :func:`lowsnr_sensor.conditioning.cells.filtered`."""
    out = np.empty((len(rows.scale), len(cols.scale)), dtype=np.float32)
    in_bands(
        lambda first, last: cell_kernels.filter_pixels(
            values, rows.weights, rows.start, rows.scale, cols.weights, cols.start, cols.scale,
            rows.stride, first, last, out),
        len(out), regions)
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
    regions: int = 1,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Compute :func:`lowsnr_sensor.conditioning.cells.cell_noise`."""
    out, new_trace = np.empty_like(flat), np.empty_like(flat)
    total, count = np.empty_like(local), np.empty_like(local)
    limits = pixels.NOISE_LIMIT**2, pixels.MEAN_SQUARE
    in_bands(
        lambda first, last: cell_kernels.cell_noise(
            flat, trace, persistence, unit, local, limits, first, last, out, new_trace, total,
            count),
        len(local), regions)
    return out, new_trace, total, count


def transients_limited(
    values: np.ndarray, before: np.ndarray, reach: int, regions: int = 1,
) -> np.ndarray:
    """Compute :func:`lowsnr_sensor.conditioning.cells.transients_limited`."""
    out = np.empty_like(values)
    scalars = (np.float32(cells.TRANSIENT), np.float32(cells.BRIGHTER))
    in_bands(
        lambda first, last: cell_kernels.limit_transients(
            values, before, reach, scalars, first, last, out),
        len(out), regions)
    return out
