# SPDX-License-Identifier: Apache-2.0
"""
Compiled loops over the pixels of the image, in float32; C-contiguous planes of (rows, cols).

Their definitions in NumPy are in :mod:`lowsnr_sensor.conditioning.pixels` and
:mod:`lowsnr_sensor.conditioning.frame_change`; tests hold the loops equal to them.  The innermost
loops go along a row, which compilers turn into vector instructions.
"""

from __future__ import annotations

from lowsnr_common.core.compiled import compiled
import numpy as np

_ONE, _ZERO = np.float32(1.0), np.float32(0.0)
# Rows whose columns are summed one after another.  The groups do not depend on the bands of rows
# that threads share, and so neither do the sums.
GROUP = 64


@compiled
def update(
    frame: np.ndarray, stripes: tuple[np.ndarray, np.ndarray], level: np.ndarray,
    variance: np.ndarray, age: np.ndarray, local: np.ndarray, corner: tuple[int, int],
    scalars: tuple[float, ...], first: int, last: int, new_level: np.ndarray,
    new_variance: np.ndarray, new_age: np.ndarray, deviations: np.ndarray,
) -> None:
    """
    Write some rows of the planes after a frame, and of its deviations.

    ``stripes`` are the offsets of its rows and columns, ``scalars`` those of `_row`.
    """
    cols = frame.shape[1]
    around, slope = np.empty(cols, dtype=np.float32), np.empty(cols, dtype=np.float32)
    flat = np.empty(cols, dtype=np.float32)
    blocks, across = local.shape
    striped, there = np.any(stripes[0]) or np.any(stripes[1]), -1
    for row in range(first, last):
        block = min(max((row + corner[0]) // 4, 0), blocks - 1)
        if block != there:
            for col in range(cols):
                around[col] = local[block, min(max((col + corner[1]) // 4, 0), across - 1)]
            there = block
        _steepness(level, row, slope)
        here = frame[row]
        if striped:
            _without_stripes(frame[row], stripes[0][row], stripes[1], flat)
            here = flat
        _row(
            here, level[row], variance[row], age[row], around, slope, scalars,
            new_level[row], new_variance[row], new_age[row], deviations[row])


@compiled
def _without_stripes(
    frame: np.ndarray, offset: float, offsets: np.ndarray, flat: np.ndarray,
) -> None:
    """Write the pixels of a row less the offset of the row and those of the columns."""
    for col in range(len(flat)):
        flat[col] = frame[col] - (offset + offsets[col])


@compiled
def _steepness(level: np.ndarray, row: int, slope: np.ndarray) -> None:
    """Write the largest difference of the pixels of a row to their neighbours."""
    rows, cols = level.shape
    here, above, below = level[row], level[max(row - 1, 0)], level[min(row + 1, rows - 1)]
    for col in range(cols):
        one, two = abs(above[col] - here[col]), abs(below[col] - here[col])
        slope[col] = one if one > two else two
    for col in range(cols - 1):
        step = abs(here[col + 1] - here[col])
        slope[col] = step if step > slope[col] else slope[col]
    for col in range(1, cols):
        step = abs(here[col - 1] - here[col])
        slope[col] = step if step > slope[col] else slope[col]


@compiled
def _row(
    frame: np.ndarray, level: np.ndarray, variance: np.ndarray, age: np.ndarray,
    around: np.ndarray, slope: np.ndarray, scalars: tuple[float, ...], new_level: np.ndarray,
    new_variance: np.ndarray, new_age: np.ndarray, deviations: np.ndarray,
) -> None:
    """Update the pixels of a row."""
    (gain, offset, growth, level_frames, noise_frames, warm_up, level_limit, limit, least, jitter,
     unobserved, cut, mean_square, own_share, own_age, open_limit) = scalars
    for col in range(len(frame)):
        mean, old, years = gain * level[col] + offset, growth * variance[col], age[col]
        known = abs(frame[col]) < unobserved
        value = frame[col] if known else _ZERO
        inverse = _ONE / (years if years > _ONE else _ONE)
        young = own_age / (years + own_age)
        own = own_share * (_ONE - young) * old
        noise = growth * around[col]
        noise = noise if noise > own else own
        noise = noise if noise > least else least
        edge = jitter * slope[col]
        noise += young * edge * edge
        spread = np.sqrt(noise * (_ONE + inverse))
        rest = value - mean
        deviation = rest / spread
        most = level_limit * (_ONE + open_limit * inverse * inverse) * spread
        step = rest if rest < most else most
        step = step if step > -most else -most
        older, square = years + _ONE, deviation * deviation
        frames = older if older < level_frames else level_frames
        square = noise * (square if square < cut else cut) / mean_square
        both = known and years > _ZERO
        new_level[col] = mean + step / frames if both else (value if known else mean)
        new_variance[col] = (old + (square - old) * inverse if both else old) / growth
        new_age[col] = (older if older < noise_frames else noise_frames) if known else years
        deviation = deviation if deviation < limit else limit
        deviation = deviation if deviation > -limit else -limit
        deviations[col] = deviation if known and years >= warm_up else _ZERO


@compiled
def stripe_sums(
    frame: np.ndarray, stripes: tuple[np.ndarray, np.ndarray], level: np.ndarray,
    age: np.ndarray, scalars: np.ndarray, first: int, last: int, row_sums: np.ndarray,
    group_sums: np.ndarray,
) -> None:
    """
    Add the limited residual of some rows to the sums of rows, and of columns in groups of rows.

    ``stripes`` are the offsets of rows and columns so far, ``scalars`` as in the wrapper.
    """
    gain, offset, limit, unobserved = scalars[0], scalars[1], scalars[2], scalars[3]
    rest = np.empty(frame.shape[1], dtype=np.float32)
    flat = np.empty(frame.shape[1], dtype=np.float32)
    striped = np.any(stripes[0]) or np.any(stripes[1])
    for row in range(first, last):
        here = frame[row]
        if striped:
            _without_stripes(frame[row], stripes[0][row], stripes[1], flat)
            here = flat
        mean, years, col_sums = level[row], age[row], group_sums[row // GROUP]
        for col in range(len(rest)):
            value = here[col] - (gain * mean[col] + offset)
            value = value if value < limit else limit
            value = value if value > -limit else -limit
            value = value if abs(here[col]) < unobserved and years[col] > _ZERO else _ZERO
            rest[col] = value
            col_sums[col] += value
        size = len(rest)
        while size > 1:
            half = (size + 1) // 2
            for col in range(size - half):
                rest[col] += rest[half + col]
            size = half
        row_sums[row] = rest[0]


@compiled
def block_sums(
    values: np.ndarray, known: np.ndarray, above: float, most: np.ndarray, first: int,
    last: int, total: np.ndarray, count: np.ndarray,
) -> None:
    """Write sums of values up to ``most`` where ``known > above``, and numbers, of some blocks."""
    rows, cols = values.shape
    sums, numbers = np.empty(cols, dtype=np.float32), np.empty(cols, dtype=np.float32)
    limit = np.empty(cols, dtype=np.float32)
    for block in range(first, last):
        sums[:] = _ZERO
        numbers[:] = _ZERO
        for col in range(cols):
            limit[col] = most[block, col // 4]
        for row in range(4 * block, min(4 * block + 4, rows)):
            value, flag = values[row], known[row]
            for col in range(cols):
                least = value[col] if value[col] < limit[col] else limit[col]
                sums[col] += least if flag[col] > above else _ZERO
                numbers[col] += _ONE if flag[col] > above else _ZERO
        for other in range(total.shape[1]):
            left, right = 4 * other, min(4 * other + 4, cols)
            summed, known_ones = _ZERO, _ZERO
            for col in range(left, right):
                summed += sums[col]
                known_ones += numbers[col]
            total[block, other] = summed
            count[block, other] = known_ones


@compiled
def surroundings(
    total: np.ndarray, count: np.ndarray, before: np.ndarray, mean: np.ndarray,
) -> None:
    """Write the mean of the 3 x 3 blocks around each, or ``before`` where nothing is known."""
    rows, cols = total.shape
    sums, numbers = np.empty(cols, dtype=np.float32), np.empty(cols, dtype=np.float32)
    none = np.zeros(cols, dtype=np.float32)
    for row in range(rows):
        _three(total, row, none, sums)
        _three(count, row, none, numbers)
        for col in range(cols):
            known = numbers[col] > _ZERO
            mean[row, col] = sums[col] / numbers[col] if known else before[row, col]


@compiled
def _three(plane: np.ndarray, row: int, none: np.ndarray, sums: np.ndarray) -> None:
    """Write the sums of the 3 x 3 values around those of a row."""
    rows, cols = plane.shape
    here = plane[row]
    above = plane[row - 1] if row > 0 else none
    below = plane[row + 1] if row + 1 < rows else none
    column = np.empty(cols, dtype=np.float32)
    for col in range(cols):
        column[col] = here[col] + above[col] + below[col]
    sums[:] = column
    for col in range(1, cols):
        sums[col] += column[col - 1]
    for col in range(cols - 1):
        sums[col] += column[col + 1]
