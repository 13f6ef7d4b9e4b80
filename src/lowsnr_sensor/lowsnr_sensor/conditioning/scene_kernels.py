# SPDX-License-Identifier: Apache-2.0
"""
Compiled loops between scene and image, in float32; C-contiguous planes of (rows, cols).

Their definitions in NumPy are in :mod:`lowsnr_sensor.conditioning.registration` and
:mod:`lowsnr_sensor.conditioning.scene`; tests hold the loops equal to them.
"""

from __future__ import annotations

from lowsnr_common.core.compiled import compiled
import numpy as np

_ONE, _ZERO = np.float32(1.0), np.float32(0.0)


@compiled
def shift(
    plane: np.ndarray, row: int, col: int, row_weights: np.ndarray, col_weights: np.ndarray,
    out: np.ndarray,
) -> None:
    """Write the plane at ``row`` and ``col`` further on, interpolated; its border goes on."""
    rows, cols = plane.shape
    size = len(row_weights)
    tall = np.empty(cols, dtype=np.float32)
    wide = np.empty(cols + size - 1, dtype=np.float32)
    for line in range(rows):
        tall[:] = _ZERO
        for tap in range(size):
            source = plane[min(max(line + row + tap - size // 2 + 1, 0), rows - 1)]
            weight = row_weights[tap]
            for place in range(cols):
                tall[place] += weight * source[place]
        first = col - size // 2 + 1
        for place in range(cols + size - 1):
            wide[place] = tall[min(max(place + first, 0), cols - 1)]
        here = out[line]
        here[:] = _ZERO
        for tap in range(size):
            weight, source = col_weights[tap], wide[tap:tap + cols]
            for place in range(cols):
                here[place] += weight * source[place]


@compiled
def sample(
    plane: np.ndarray, age: np.ndarray, row: int, col: int, step: int, weights: np.ndarray,
    values: np.ndarray,
) -> None:
    """
    Write value, row slope and column slope at every few pixels, (3, n, m); NaN where unknown.

    ``weights`` (2, 2, 4) are those of the value and of its slope along rows and columns.
    """
    rows, cols = plane.shape
    for line in range(values.shape[1]):
        top = line * step + row
        for place in range(values.shape[2]):
            left = place * step + col
            inside = 0 <= top < rows - 1 and 0 <= left < cols - 1 and age[top, left] > _ZERO
            value = down = right = _ZERO if inside else np.float32(np.nan)
            if inside:
                for tap in range(4):
                    source = plane[min(max(top + tap - 1, 0), rows - 1)]
                    here = slope = _ZERO
                    for other in range(4):
                        pixel = source[min(max(left + other - 1, 0), cols - 1)]
                        here += weights[1, 0, other] * pixel
                        slope += weights[1, 1, other] * pixel
                    value += weights[0, 0, tap] * here
                    down += weights[0, 1, tap] * here
                    right += weights[0, 0, tap] * slope
            values[0, line, place] = value
            values[1, line, place] = down
            values[2, line, place] = right


@compiled
def to_scene(
    old: tuple[np.ndarray, np.ndarray, np.ndarray], before: tuple[np.ndarray, np.ndarray],
    seen: tuple[np.ndarray, np.ndarray, np.ndarray], scalars: tuple[float, float],
    nearest: tuple[int, int], corner: tuple[int, int], parts: tuple[float, float],
    out: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    """
    Write level, variance and age of the scene after those ``seen`` in the image changed.

    The level changes as that of the image did from ``before`` (level and age), interpolated
    linearly; a pixel that is new takes that of the image.  Pixel (0, 0) of the scene is ``corner``
    and ``parts`` of a pixel in the image; variance and age are those of the ``nearest`` pixel.
    """
    rows, cols = old[0].shape
    gain, offset = scalars
    step, fresh = np.empty(cols, dtype=np.float32), np.empty(cols, dtype=np.float32)
    wide_step = np.empty(cols + 1, dtype=np.float32)
    wide_fresh = np.empty(cols + 1, dtype=np.float32)
    first, last = max(-nearest[1], 0), min(cols, cols - nearest[1])
    for row in range(rows):
        near = row + nearest[0]
        for col in range(cols):
            out[0][row, col] = gain * old[0][row, col] + offset
            out[1][row, col] = old[1][row, col]
            out[2][row, col] = old[2][row, col]
        if near < 0 or near >= rows or first >= last:
            continue
        for col in range(cols):
            step[col] = fresh[col] = _ZERO
        for side in range(2):
            source = min(max(row + corner[0] + side, 0), rows - 1)
            weight = parts[0] if side else _ONE - parts[0]
            _add_step(
                before[0][source], before[1][source], seen[0][source], scalars, weight, step,
                fresh)
        _slide(step, corner[1], wide_step)
        _slide(fresh, corner[1], wide_fresh)
        _join(
            wide_step[first:], wide_fresh[first:], parts[1], old[2][row, first:last],
            out[0][row, first:last])
        start = first + nearest[1]
        _copy(seen[1][near, start:], out[1][row, first:last])
        _copy(seen[2][near, start:], out[2][row, first:last])


@compiled
def _join(
    step: np.ndarray, fresh: np.ndarray, part: float, age: np.ndarray, level: np.ndarray,
) -> None:
    """Add the interpolated change to known levels; unknown ones become that of the image."""
    for col in range(len(level)):
        more = (_ONE - part) * step[col] + part * step[col + 1]
        image = (_ONE - part) * fresh[col] + part * fresh[col + 1]
        level[col] = level[col] + more if age[col] > _ZERO else image


@compiled
def _copy(values: np.ndarray, out: np.ndarray) -> None:
    """Write the first values."""
    for col in range(len(out)):
        out[col] = values[col]


@compiled
def _add_step(
    before: np.ndarray, age: np.ndarray, after: np.ndarray, scalars: tuple[float, float],
    weight: float, step: np.ndarray, fresh: np.ndarray,
) -> None:
    """Add the weighted change of the known levels of a row, and the weighted levels."""
    gain, offset = scalars
    for col in range(len(step)):
        change = after[col] - (gain * before[col] + offset)
        step[col] += weight * change if age[col] > _ZERO else _ZERO
        fresh[col] += weight * after[col]


@compiled
def _slide(values: np.ndarray, by: int, out: np.ndarray) -> None:
    """Write the values from ``by`` on; the first and the last go on beyond them."""
    size, count = len(values), len(out)
    low, high = min(max(-by, 0), count), max(min(size - by, count), 0)
    for place in range(low):
        out[place] = values[0]
    if low < high:
        _copy(values[low + by:], out[low:high])
    for place in range(max(high, low), count):
        out[place] = values[size - 1]
