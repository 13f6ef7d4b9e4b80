# SPDX-License-Identifier: Apache-2.0
"""
The Bayes-Markov filter on a grid: the arithmetic of one step, forwards and backwards.

A belief is an array ``(dropped, kept, ..., rows, cols)``: the probability of each history of
moves (see :class:`lowsnr_detect.parts.moves.MoveModel`) and cell, with the leading axes of the
frame between them.
"""

from __future__ import annotations

from lowsnr_common.images.bands import in_bands
from lowsnr_detect.grid import grid_kernels
from lowsnr_detect.grid.grid_kernels import BLOCK
from lowsnr_detect.parts.moves import MoveModel
from lowsnr_detect.parts.moves import shifted
import numpy as np


def move_and_weigh(
    model: MoveModel, belief: np.ndarray, weight: np.ndarray, stays: np.ndarray,
    born: np.ndarray, move_factor: np.ndarray | None = None, regions: int = 1,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Move a belief on by one frame, mix it with births, and weigh it by the frame.

    Parameters
    ----------
    model
        Probabilities of the moves.
    belief : (dropped, kept, ..., rows, cols) ndarray
        Probability of each history and cell.
    weight : (..., rows, cols) ndarray
        Likelihood of each cell.
    stays : (...,) ndarray
        Factor of the moved belief.
    born : (...,) ndarray
        Probability that an object appears, uniformly in the frame.
    move_factor : (kept, n, rows, cols) ndarray, optional
        Factor of every move by the cell that it starts in.
    regions
        Sub-regions that are processed in parallel.

    Returns
    -------
    (dropped, kept, ..., rows, cols) ndarray
        ``weight * (stays * moved + born)``, not normalised.
    (...,) ndarray
        Sum of the moved belief: the part that is still inside the frame.
    (...,) ndarray
        Sum of the first array.

    """
    batch, (rows, cols) = weight.shape[:-2], weight.shape[-2:]
    weights = weight.reshape(-1, rows, cols)
    planes = np.ascontiguousarray(belief).reshape(*belief.shape[:2], *weights.shape)
    births = np.outer(model.history / (rows * cols), np.broadcast_to(born, batch))
    survives = np.array(np.broadcast_to(stays, batch)).ravel()
    after = np.empty((model.history.size, *weights.shape))
    sums = np.empty((2, len(weights), -(-rows // BLOCK), cols))
    factor = np.ascontiguousarray(
        np.empty((0, 0, 0, 0)) if move_factor is None else move_factor)
    in_bands(
        lambda first, last: grid_kernels.move_and_weigh(
            planes, model.kernel, model.moves, factor, weights, survives, births, first, last,
            after, sums),
        rows, regions, BLOCK)
    inside, mass = sums.sum(axis=(2, 3)).reshape(2, *batch)
    return after.reshape(belief.shape), inside, mass


def expect_belief(
    model: MoveModel, value: np.ndarray, move_factor: np.ndarray | None = None,
) -> np.ndarray:
    """
    Return the expectation of a value after the move, given history and cell before it.

    It is the adjoint of the move in :func:`move_and_weigh`.

    Parameters
    ----------
    model
        Probabilities of the moves.
    value : (dropped, kept, ..., rows, cols) ndarray
        Value of each history and cell after the move; zero outside the frame.
    move_factor : (kept, n, rows, cols) ndarray, optional
        Factor of every move by the cell that it starts in.

    Returns
    -------
    (dropped, kept, ..., rows, cols) ndarray
        Its expectation before the move.

    """
    kept, count = model.history.shape[1], len(model.moves)
    by_move = value.swapaxes(0, 1) if kept == 1 else value
    by_move = np.broadcast_to(by_move, (kept, count, *value.shape[2:]))
    back = np.stack([
        shifted(by_move[:, number], -move, 0.0) for number, move in enumerate(model.moves)],
        axis=1)
    if move_factor is not None:
        back *= over_runs(move_factor, value.ndim - 4)
    expected = model.kernel.swapaxes(1, 2) @ back.reshape(kept, count, -1)
    return np.asarray(expected.swapaxes(0, 1).reshape(value.shape))


def birth_belief(model: MoveModel, shape: tuple[int, ...]) -> np.ndarray:
    """Return b(x), the distribution of a birth, (dropped, kept, 1, ..., 1): uniform in cells."""
    rows, cols = shape[-2:]
    return over_runs(model.history[..., None, None] / (rows * cols), len(shape) - 2)


def over_runs(planes: np.ndarray, axes: int) -> np.ndarray:
    """Return (a, b, rows, cols) with as many axes of length one before the rows."""
    return planes.reshape(*planes.shape[:2], *[1] * axes, *planes.shape[2:])


def as_plane(value: np.ndarray) -> np.ndarray:
    """Return (...,) with axes of length one for rows and columns."""
    return value[..., None, None]


def total(belief: np.ndarray) -> np.ndarray:
    """Return the sum over histories and cells, (...,)."""
    return np.asarray(belief.sum(axis=(0, 1, -2, -1)))
