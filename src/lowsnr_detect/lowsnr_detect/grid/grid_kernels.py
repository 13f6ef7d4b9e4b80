# SPDX-License-Identifier: Apache-2.0
"""
Loops of the grid filter over cells and histories.

As in :mod:`lowsnr_detect.parts.path_kernels`, each writes the rows from ``first`` to ``last``.
"""

from __future__ import annotations

from lowsnr_common.core.compiled import compiled
import numpy as np

# Rows whose probabilities are summed together, so that the sum does not depend on the bands.
BLOCK = 16


@compiled
def move_and_weigh(
    belief: np.ndarray, kernel: np.ndarray, moves: np.ndarray, move_factor: np.ndarray,
    weight: np.ndarray, stays: np.ndarray, born: np.ndarray, first: int, last: int,
    after: np.ndarray, sums: np.ndarray,
) -> None:
    """
    Write ``(moved belief * stays + born) * weight`` for all histories, cells and runs.

    The belief is (dropped, kept, B, rows, cols), ``kernel`` (kept, n, dropped) as in
    :class:`lowsnr_detect.parts.moves.MoveModel`, ``move_factor`` (kept, n, rows, cols) or empty,
    ``weight`` (B, rows, cols), ``stays`` (B,), ``born`` (H, B) the same in all cells.  The
    result ``after`` is (H, B, rows, cols) with the newest move fastest in H, or the sum over all
    moves where H is 1.  ``sums`` (2, B, blocks, cols) gets the sums of the moved belief and of
    the result, by column and block of rows.
    """
    kept, count, dropped = kernel.shape
    cols = weight.shape[2]
    spread, moved = np.empty(cols), np.zeros(cols)
    for run in range(len(weight)):
        for row in range(first, last):
            if row % BLOCK == 0:
                sums[:, run, row // BLOCK] = 0.0
            for past in range(kept):
                for move in range(count):
                    source = row - moves[move, 0]
                    if not 0 <= source < weight.shape[1]:
                        pass
                    elif dropped == 1 and move_factor.size == 0:
                        _shift(
                            belief[0, past, run, source], kernel[past, move, 0], moves[move, 1],
                            moved)
                    else:
                        _spread(belief, kernel, move_factor, past, move, run, source, spread)
                        _shift(spread, 1.0, moves[move, 1], moved)
                    history = past * count + move
                    if len(after) == 1:
                        history = 0
                        if move < count - 1:
                            continue
                    _weigh(
                        moved, weight, stays[run], born[history, run], run, row, history, sums,
                        after)


@compiled
def _spread(
    belief: np.ndarray, kernel: np.ndarray, move_factor: np.ndarray, past: int, move: int,
    run: int, row: int, spread: np.ndarray,
) -> None:
    """Write the probability of a move from each cell of a row."""
    here, prob = belief[0, past, run, row], kernel[past, move, 0]
    for col in range(len(spread)):
        spread[col] = prob * here[col]
    for before in range(1, len(belief)):
        here, prob = belief[before, past, run, row], kernel[past, move, before]
        for col in range(len(spread)):
            spread[col] += prob * here[col]
    if move_factor.size > 0:
        spread *= move_factor[past, move, row]


@compiled
def _shift(spread: np.ndarray, prob: float, step: int, moved: np.ndarray) -> None:
    """Add a row times a probability, shifted by ``step`` columns."""
    size = len(moved) - abs(step)
    here, into = spread[max(-step, 0):], moved[max(step, 0):]
    for col in range(size):
        into[col] += prob * here[col]


@compiled
def _weigh(
    moved: np.ndarray, weight: np.ndarray, stays: float, born: float, run: int, row: int,
    history: int, sums: np.ndarray, after: np.ndarray,
) -> None:
    """Write a row of the result, and clear ``moved`` for the next."""
    inside, mass = sums[0, run, row // BLOCK], sums[1, run, row // BLOCK]
    factor, new = weight[run, row], after[history, run, row]
    for col in range(len(moved)):
        inside[col] += moved[col]
        value = (moved[col] * stays + born) * factor[col]
        mass[col] += value
        new[col] = value
        moved[col] = 0.0
