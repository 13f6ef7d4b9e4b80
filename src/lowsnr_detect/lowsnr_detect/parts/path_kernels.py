# SPDX-License-Identifier: Apache-2.0
"""
Compiled loops of the path detectors over the cells of planes.

Each writes the rows from ``first`` to ``last``, so that bands of rows may be processed in
parallel; arrays are C-contiguous, and B is the number of independent runs.  The innermost loops
go along a row, over arrays as long as the row, which compilers turn into vector instructions.
Their definitions in NumPy are :func:`lowsnr_detect.detectors.sdt.sequential_test`,
:func:`lowsnr_detect.detectors.cusum.page_recursion` and
:func:`lowsnr_detect.parts.moves.best_vicinity`; tests hold the loops equal to them.
"""

from __future__ import annotations

from lowsnr_common.core.compiled import compiled
import numpy as np

# Rows that pass through all planes together, so that they stay in the cache of the processor.
BLOCK = 64
# No path, and no bound; of the type of the planes, so that no value is widened to float64.
_NONE, _ALL = np.float32(-np.inf), np.float32(np.inf)


@compiled
def extend_paths(
    state: np.ndarray, frame: np.ndarray, factor: float, offset: float, start: np.ndarray,
    radius: int, unused: bool, bounds: tuple[float, float, float], first: int, last: int,
    paths: np.ndarray, decided: np.ndarray, peak: np.ndarray,
) -> None:
    """
    Extend open paths (D - 1, B, rows, cols) by a frame (B, rows, cols).

    The best path within ``radius`` cells gains the log ratio ``factor * frame - offset``.  A path
    starts in every cell, or with ``unused`` only outside the vicinity of all open paths; ``start``
    (rows, cols), unless empty, is added to it.  A path below the first of the ``bounds`` is
    dropped; one above the second, or with D frames, is decided.  ``peak`` (B, rows) gets the
    largest decided path of each row, and ``decided`` (B, rows, cols) that of each cell, in the
    rows whose peak exceeds the third bound.
    """
    depths, cols, size = len(state), frame.shape[2], min(BLOCK, last - first)
    lower, upper, threshold = np.float32(bounds[0]), np.float32(bounds[1]), np.float32(bounds[2])
    wide = np.full(cols + 2 * radius, _NONE, dtype=np.float32)
    around = np.empty(cols, dtype=np.float32)
    ratio = np.empty((size, cols), dtype=np.float32)
    best = np.empty_like(ratio)
    fresh = np.empty_like(ratio) if unused or start.size > 0 else ratio
    for run in range(len(frame)):
        for block in range(first, last, BLOCK):
            stop = min(block + BLOCK, last)
            _log_ratios(frame[run], block, stop, factor, offset, ratio)
            if unused or start.size > 0:
                fresh[:] = ratio
            if start.size > 0:
                fresh[:stop - block] += start[block:stop]
            # The longest paths come first: shorter ones that are declared early join them.
            if depths > 0:
                _extend(
                    state[depths - 1, run], ratio, block, stop, radius, unused, _NONE, _ALL, wide,
                    around, best, best, fresh)
            for depth in range(depths - 1, 0, -1):
                _extend(
                    state[depth - 1, run], ratio, block, stop, radius, unused, lower, upper, wide,
                    around, paths[depth, run, block:stop], best, fresh)
            if depths > 0:
                _bound(fresh, lower, upper, paths[0, run, block:stop], best)
            _decide(
                best if depths > 0 else fresh, threshold, decided[run, block:stop],
                peak[run, block:stop])


@compiled
def _log_ratios(
    frame: np.ndarray, first: int, stop: int, factor: float, offset: float, ratios: np.ndarray,
) -> None:
    """Write the log ratios of the cells."""
    for row in range(first, stop):
        cell, ratio = frame[row], ratios[row - first]
        for col in range(len(cell)):
            ratio[col] = np.float32(cell[col]) * factor - offset


@compiled
def _drop_used(left: np.ndarray, tall: np.ndarray, right: np.ndarray, fresh: np.ndarray) -> None:
    """Start no path where an open one may arrive."""
    for col in range(len(fresh)):
        most = left[col] if left[col] > right[col] else right[col]
        most = tall[col] if tall[col] > most else most
        fresh[col] = _NONE if most > _NONE else fresh[col]


@compiled
def _extend(
    plane: np.ndarray, ratios: np.ndarray, first: int, stop: int, radius: int, unused: bool,
    lower: float, upper: float, wide: np.ndarray, around: np.ndarray, out: np.ndarray,
    decided: np.ndarray, fresh: np.ndarray,
) -> None:
    """Extend the best path of each vicinity; ``wide`` has margins of -inf."""
    rows, cols = plane.shape
    tall = wide[radius:radius + cols]
    left, right = wide[:cols], wide[2 * radius:2 * radius + cols]
    for row in range(first, stop):
        top, bottom = max(row - radius, 0), min(row + radius, rows - 1)
        here, above, below = plane[row], plane[top], plane[bottom]
        for col in range(cols):
            most = above[col] if above[col] > below[col] else below[col]
            tall[col] = here[col] if here[col] > most else most
        if radius > 1:
            _column_max(plane, top + 1, bottom, tall)
            left = right = _row_max(wide, radius, around)
        if unused:
            _drop_used(left, tall, right, fresh[row - first])
        early, ratio, new = 0, ratios[row - first], out[row - first]
        for col in range(cols):
            most = left[col] if left[col] > right[col] else right[col]
            value = (tall[col] if tall[col] > most else most) + ratio[col]
            early += value > upper
            new[col] = value if value > lower else _NONE
        if early:
            _declare_early(new, upper, decided[row - first])


@compiled
def _column_max(plane: np.ndarray, first: int, last: int, most: np.ndarray) -> None:
    """Raise ``most`` to the largest of each column of some rows of a plane."""
    for row in range(first, last):
        other = plane[row]
        for col in range(len(most)):
            most[col] = other[col] if other[col] > most[col] else most[col]


@compiled
def _row_max(wide: np.ndarray, radius: int, most: np.ndarray) -> np.ndarray:
    """Write the largest within ``radius`` along a row, and return it."""
    most[:] = _NONE
    for shift in range(2 * radius + 1):
        other = wide[shift:shift + len(most)]
        for col in range(len(most)):
            most[col] = other[col] if other[col] > most[col] else most[col]
    return most


@compiled
def _bound(
    fresh: np.ndarray, lower: float, upper: float, out: np.ndarray, decided: np.ndarray,
) -> None:
    """Write the new paths that are above ``lower``, and declare those above ``upper``."""
    for row in range(len(out)):
        early, value, new = 0, fresh[row], out[row]
        for col in range(len(new)):
            early += value[col] > upper
            new[col] = value[col] if value[col] > lower else _NONE
        if early:
            _declare_early(new, upper, decided[row])


@compiled
def _declare_early(new: np.ndarray, upper: float, decided: np.ndarray) -> None:
    """Close the paths above ``upper``, and add them to the decided ones."""
    for col in range(len(new)):
        if new[col] > upper:
            decided[col] = max(new[col], decided[col])
            new[col] = _NONE


@compiled
def _decide(
    best: np.ndarray, threshold: float, decided: np.ndarray, peak: np.ndarray,
) -> None:
    """Write the largest of each row, and the rows whose largest exceeds the threshold."""
    for row in range(len(decided)):
        here = best[row]
        peak[row] = _largest(here)
        if peak[row] > threshold:
            decided[row] = here


@compiled
def _largest(row: np.ndarray) -> float:
    """Return the largest of a row, in four independent sequences that run in parallel."""
    one = two = three = four = row[0]
    even = len(row) // 4 * 4
    for col in range(0, even, 4):
        one = row[col] if row[col] > one else one
        two = row[col + 1] if row[col + 1] > two else two
        three = row[col + 2] if row[col + 2] > three else three
        four = row[col + 3] if row[col + 3] > four else four
    for col in range(even, len(row)):
        one = row[col] if row[col] > one else one
    return max(one, two, three, four)  # type: ignore[no-any-return]


@compiled
def best_moves(
    planes: np.ndarray, moves: np.ndarray, log_prob: np.ndarray, first: int, last: int,
    best: np.ndarray,
) -> None:
    """
    Write the largest value that may move into each cell of planes (P, rows, cols).

    A move (rows, cols) of ``moves`` (n, 2) adds its ``log_prob``, (n, rows, cols) by the cell it
    starts in, or (n, 1, 1) if it is the same for all cells.
    """
    count, rows, cols = planes.shape
    uniform = log_prob.shape[1] * log_prob.shape[2] == 1
    for number in range(count):
        for row in range(first, last):
            best[number, row] = _NONE
            for move in range(len(moves)):
                source, step = row - moves[move, 0], moves[move, 1]
                if not (0 <= source < rows and abs(step) < cols):
                    continue
                left, size = max(-step, 0), cols - abs(step)
                here = planes[number, source, left:left + size]
                into = best[number, row, max(step, 0):max(step, 0) + size]
                if uniform:
                    gain = log_prob[move, 0, 0]
                    for col in range(size):
                        value = here[col] + gain
                        into[col] = value if value > into[col] else into[col]
                else:
                    gains = log_prob[move, source, left:left + size]
                    for col in range(size):
                        value = here[col] + gains[col]
                        into[col] = value if value > into[col] else into[col]


@compiled
def extend_sums(
    before: np.ndarray, frame: np.ndarray, factor: float, offset: float, drift: float,
    most: float, first: int, last: int, sums: np.ndarray,
) -> None:
    """Write ``min(max(before - drift, 0), most) + factor * frame - offset``, (B, rows, cols)."""
    for run in range(len(sums)):
        for row in range(first, last):
            best, cell, new = before[run, row], frame[run, row], sums[run, row]
            for col in range(len(new)):
                kept = best[col] - drift
                kept = kept if kept > np.float32(0.0) else np.float32(0.0)
                kept = kept if kept < most else most
                new[col] = kept + (np.float32(cell[col]) * factor - offset)
