# SPDX-License-Identifier: Apache-2.0
"""
Compiled loops over cells, in float32; C-contiguous planes of (rows, cols).

Their definitions in NumPy are in :mod:`lowsnr_sensor.conditioning.cells`; tests hold the loops
equal to them.
"""

from __future__ import annotations

from lowsnr_common.core.compiled import compiled
import numpy as np

_ONE, _ZERO = np.float32(1.0), np.float32(0.0)


@compiled
def filter_pixels(
    values: np.ndarray, row_weights: np.ndarray, row_start: int, row_scale: np.ndarray,
    col_weights: np.ndarray, col_start: int, col_scale: np.ndarray, stride: int, top: int,
    bottom: int, cells: np.ndarray,
) -> None:
    """Write some rows of the cells of the matched filter."""
    rows, cols = values.shape
    left = max(-col_start, 0)
    size = left + abs(col_start) + max(cols, stride * cells.shape[1]) + len(col_weights) + stride
    line = np.empty(size, dtype=np.float32)
    for cell in range(top, bottom):
        first = row_start + stride * cell
        line[:] = _ZERO
        here = line[left:left + cols]
        for tap in range(max(-first, 0), min(len(row_weights), rows - first)):
            weight, source = row_weights[tap] * row_scale[cell], values[first + tap]
            for col in range(cols):
                here[col] += weight * source[col]
        _gather(line, left + col_start, stride, col_weights, col_scale, cells[cell])


@compiled
def _gather(
    line: np.ndarray, start: int, stride: int, weights: np.ndarray, scale: np.ndarray,
    cells: np.ndarray,
) -> None:
    """Write the weighted sums of a row; ``line`` has zeros beyond its pixels."""
    cells[:] = _ZERO
    # The pixels of each phase lie beside each other, for vector instructions.
    size = len(cells) + (len(weights) - 1) // stride
    phases = np.empty((stride, size), dtype=np.float32)
    for phase in range(stride):
        for place in range(size):
            phases[phase, place] = line[start + phase + stride * place]
    for tap in range(len(weights)):
        weight, first = weights[tap], tap // stride
        source = phases[tap % stride, first:first + len(cells)]
        for cell in range(len(cells)):
            cells[cell] += weight * source[cell]
    for cell in range(len(cells)):
        cells[cell] *= scale[cell]


@compiled
def limit_transients(
    cells: np.ndarray, before: np.ndarray, reach: int, scalars: tuple[float, float], first: int,
    last: int, out: np.ndarray,
) -> None:
    """Write rows of the cells, limited where nothing near in the frame before is as bright."""
    rows, cols = cells.shape
    least, brighter = scalars
    for row in range(first, last):
        for col in range(cols):
            value = cells[row, col]
            if value > least:
                near = _ZERO
                for other in range(max(row - reach, 0), min(row + reach + 1, rows)):
                    for place in range(max(col - reach, 0), min(col + reach + 1, cols)):
                        near = max(near, before[other, place])
                value = min(value, max(least, brighter * near))
            out[row, col] = value


@compiled
def flatten(cells: np.ndarray, reach: int, flat: np.ndarray) -> None:
    """Write the cells less the mean of their surroundings, at unit noise for white noise."""
    rows, cols = cells.shape
    sums, wide = np.zeros(cols, dtype=np.float32), np.empty(cols, dtype=np.float32)
    numbers = np.empty(cols, dtype=np.float32)
    for col in range(cols):
        numbers[col] = min(col + reach, cols - 1) - max(col - reach, 0) + 1
    for row in range(min(reach, rows)):
        for col in range(cols):
            sums[col] += cells[row, col]
    for row in range(rows):
        if row + reach < rows:
            new = cells[row + reach]
            for col in range(cols):
                sums[col] += new[col]
        if row - reach - 1 >= 0:
            old = cells[row - reach - 1]
            for col in range(cols):
                sums[col] -= old[col]
        _running(sums, reach, wide)
        high = np.float32(min(row + reach, rows - 1) - max(row - reach, 0) + 1)
        here, out = cells[row], flat[row]
        for col in range(cols):
            count = high * numbers[col]
            share = _ONE - _ONE / count
            rest = (here[col] - wide[col] / count) / np.sqrt(share if share > _ZERO else _ONE)
            out[col] = rest if here[col] != _ZERO else _ZERO


@compiled
def _running(sums: np.ndarray, reach: int, wide: np.ndarray) -> None:
    """Write the sums within ``reach`` along a row."""
    cols = len(sums)
    total = np.float64(0.0)
    for col in range(min(reach, cols)):
        total += sums[col]
    for col in range(cols):
        comes = sums[col + reach] if col + reach < cols else _ZERO
        leaves = sums[col - reach - 1] if col - reach - 1 >= 0 else _ZERO
        total += np.float64(comes) - np.float64(leaves)
        wide[col] = total


@compiled
def cell_noise(
    flat: np.ndarray, trace: np.ndarray, persistence: float, unit: float, local: np.ndarray,
    limits: tuple[float, float], first: int, last: int, out: np.ndarray,
    new_trace: np.ndarray, total: np.ndarray, count: np.ndarray,
) -> None:
    """
    Write cells over their noise, their fading sum, and sums and numbers of its squares.

    It does so for the rows of the blocks from ``first`` to before ``last``.
    """
    rows, cols = flat.shape
    cut, mean_square = np.float32(limits[0]), np.float32(limits[1])
    keep, over = np.float32(persistence), _ONE / np.float32(unit)
    around = np.empty(cols, dtype=np.float32)
    sums, numbers = np.empty(cols, dtype=np.float32), np.empty(cols, dtype=np.float32)
    for block in range(first, last):
        sums[:] = _ZERO
        numbers[:] = _ZERO
        for col in range(cols):
            around[col] = local[block, col // 4]
        for row in range(4 * block, min(4 * block + 4, rows)):
            here, past, now, result = flat[row], trace[row], new_trace[row], out[row]
            for col in range(cols):
                value = keep * past[col] + here[col]
                now[col] = value
                noise = around[col]
                square, most = value * value * over, cut * noise
                square = (square if square < most else most) / mean_square
                sums[col] += square if here[col] != _ZERO else _ZERO
                numbers[col] += _ONE if here[col] != _ZERO else _ZERO
                result[col] = here[col] / np.sqrt(noise)
        for other in range(total.shape[1]):
            total[block, other] = _ZERO
            count[block, other] = _ZERO
            for col in range(4 * other, min(4 * other + 4, cols)):
                total[block, other] += sums[col]
                count[block, other] += numbers[col]
