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
    old: tuple[np.ndarray, np.ndarray, np.ndarray], step: np.ndarray,
    seen: tuple[np.ndarray, np.ndarray, np.ndarray], scalars: tuple[float, float],
    nearest: tuple[int, int], corner: tuple[int, int], parts: tuple[float, float],
    out: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    """
    Write level, variance and age of the scene after those ``seen`` in the image changed.

    The level changes by ``step``, interpolated linearly; a pixel that is new takes that of the
    image.  Pixel (0, 0) of the scene is ``corner`` and ``parts`` of a pixel in the image; variance
    and age are those of the ``nearest`` pixel.
    """
    rows, cols = old[0].shape
    gain, offset = scalars
    down, right = parts
    for row in range(rows):
        near = row + nearest[0]
        top = min(max(row + corner[0], 0), rows - 1)
        low = min(max(row + corner[0] + 1, 0), rows - 1)
        for col in range(cols):
            level, years = gain * old[0][row, col] + offset, old[2][row, col]
            other = col + nearest[1]
            inside = 0 <= near < rows and 0 <= other < cols
            left = min(max(col + corner[1], 0), cols - 1)
            side = min(max(col + corner[1] + 1, 0), cols - 1)
            source = step if years > _ZERO else seen[0]
            high = (_ONE - right) * source[top, left] + right * source[top, side]
            wide = (_ONE - right) * source[low, left] + right * source[low, side]
            change = (_ONE - down) * high + down * wide
            fresh = level + change if years > _ZERO else change
            out[0][row, col] = fresh if inside else level
            out[1][row, col] = seen[1][near, other] if inside else old[1][row, col]
            out[2][row, col] = seen[2][near, other] if inside else years
