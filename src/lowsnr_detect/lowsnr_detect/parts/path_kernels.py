"""
Loops over the cells of planes.

Each writes the rows from ``first`` to ``last``, so that bands of rows may be worked on in
parallel; arrays are C-contiguous, and B counts independent runs.  The innermost loops go along
a row, over arrays as long as the row, which is what compilers turn into vector instructions.
What they compute is said by the functions that call them, and held to plain NumPy by the tests.
"""

from __future__ import annotations

from lowsnr_common.core.compiled import compiled
import numpy as np

# Rows that are worked on plane by plane, so that what the planes share stays near.
BLOCK = 64
# No path; of the type of the planes, so that what it meets is not widened.
_NONE, _ALL = np.float32(-np.inf), np.float32(np.inf)


@compiled
def extend_paths(
    state: np.ndarray, frame: np.ndarray, factor: float, offset: float, start: np.ndarray,
    radius: int, unused: bool, bounds: tuple[float, float, float], first: int, last: int,
    paths: np.ndarray, decided: np.ndarray, peak: np.ndarray,
) -> None:
    """
    Extend paths (D - 1, B, rows, cols) by a frame (B, rows, cols) into as many.

    The best within ``radius`` gains ``factor * frame - offset``; a new path gains ``start``
    (rows, cols) too, where that is not empty, and starts where ``unused`` by others, or anywhere.
    A path ends at the first of the ``bounds``; above the second, or with D frames, it is up for
    decision.  Of these ``peak`` (B, rows) is given the best of each row, and ``decided``
    (B, rows, cols) that of each cell, in no other rows than hold one above the third bound.
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
            _begin(frame[run], block, stop, factor, offset, ratio)
            if unused or start.size > 0:
                fresh[:] = ratio
            if start.size > 0:
                fresh[:stop - block] += start[block:stop]
            # The longest come first: the others give up to them.
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
def _begin(
    frame: np.ndarray, first: int, stop: int, factor: float, offset: float, ratios: np.ndarray,
) -> None:
    """Write the log ratios of the cells."""
    for row in range(first, stop):
        cell, ratio = frame[row], ratios[row - first]
        for col in range(len(cell)):
            ratio[col] = np.float32(cell[col]) * factor - offset


@compiled
def _use(left: np.ndarray, tall: np.ndarray, right: np.ndarray, fresh: np.ndarray) -> None:
    """Let no path start where one may go on."""
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
    """Extend the best paths around each cell; ``wide`` has margins of -inf."""
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
            _widen(plane, top + 1, bottom, tall)
            left = right = _beside(wide, radius, around)
        if unused:
            _use(left, tall, right, fresh[row - first])
        early, ratio, new = 0, ratios[row - first], out[row - first]
        for col in range(cols):
            most = left[col] if left[col] > right[col] else right[col]
            value = (tall[col] if tall[col] > most else most) + ratio[col]
            early += value > upper
            new[col] = value if value > lower else _NONE
        if early:
            _give_up(new, upper, decided[row - first])


@compiled
def _widen(plane: np.ndarray, first: int, last: int, most: np.ndarray) -> None:
    """Let ``most`` be the largest of itself and rows of a plane."""
    for row in range(first, last):
        other = plane[row]
        for col in range(len(most)):
            most[col] = other[col] if other[col] > most[col] else most[col]


@compiled
def _beside(wide: np.ndarray, radius: int, most: np.ndarray) -> np.ndarray:
    """Return the largest within ``radius`` along a row."""
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
    """Write the sums that are above ``lower``."""
    for row in range(len(out)):
        early, value, new = 0, fresh[row], out[row]
        for col in range(len(new)):
            early += value[col] > upper
            new[col] = value[col] if value[col] > lower else _NONE
        if early:
            _give_up(new, upper, decided[row])


@compiled
def _give_up(new: np.ndarray, upper: float, decided: np.ndarray) -> None:
    """Close the paths above ``upper``, and remember the best of them."""
    for col in range(len(new)):
        if new[col] > upper:
            decided[col] = max(new[col], decided[col])
            new[col] = _NONE


@compiled
def _decide(
    best: np.ndarray, threshold: float, decided: np.ndarray, peak: np.ndarray,
) -> None:
    """Write the largest of each row, and the rows with one above the threshold."""
    for row in range(len(decided)):
        here = best[row]
        peak[row] = _largest(here)
        if peak[row] > threshold:
            decided[row] = here


@compiled
def _largest(row: np.ndarray) -> float:
    """Return the largest of a row, by four that do not wait for one another."""
    one = two = three = four = row[0]
    even = len(row) // 4 * 4
    for col in range(0, even, 4):
        one = row[col] if row[col] > one else one
        two = row[col + 1] if row[col + 1] > two else two
        three = row[col + 2] if row[col + 2] > three else three
        four = row[col + 3] if row[col + 3] > four else four
    for col in range(even, len(row)):
        one = row[col] if row[col] > one else one
    return max(one, two, three, four)


@compiled
def best_moves(
    planes: np.ndarray, moves: np.ndarray, bonus: np.ndarray, first: int, last: int,
    best: np.ndarray,
) -> None:
    """
    Write the largest of what may move into each cell of planes (P, rows, cols).

    A move (rows, cols) of ``moves`` (n, 2) from a cell adds its ``bonus``, (n, rows, cols), or
    (n, 1, 1) where it is that of all cells.
    """
    count, rows, cols = planes.shape
    alike = bonus.shape[1] * bonus.shape[2] == 1
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
                if alike:
                    gain = bonus[move, 0, 0]
                    for col in range(size):
                        value = here[col] + gain
                        into[col] = value if value > into[col] else into[col]
                else:
                    gains = bonus[move, source, left:left + size]
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
