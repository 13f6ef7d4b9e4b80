"""What the compiled loops over cells compute, in plain NumPy."""

import numpy as np


def vicinity_max(plane: np.ndarray, radius: int) -> np.ndarray:
    """
    Return the largest value within ``radius`` cells in both directions.

    Parameters
    ----------
    plane : (..., rows, cols) ndarray
        Values; outside the frame counts as -inf.
    radius
        Cells an object may move from a frame to the next.

    Returns
    -------
    (..., rows, cols) ndarray
        Maximum over the (2 radius + 1)^2 cells around each cell.

    """
    for axis in (-1, -2):
        plane = _running_max(plane, radius, axis)
    return plane


def _running_max(plane: np.ndarray, radius: int, axis: int) -> np.ndarray:
    plane = np.moveaxis(plane, axis, -1)
    result = plane.copy()
    for shift in range(1, min(radius, plane.shape[-1] - 1) + 1):
        np.maximum(result[..., shift:], plane[..., :-shift], out=result[..., shift:])
        np.maximum(result[..., :-shift], plane[..., shift:], out=result[..., :-shift])
    return np.moveaxis(result, -1, axis)


def best_vicinity(plane: np.ndarray, moves: np.ndarray, log_prob: np.ndarray) -> np.ndarray:
    """
    Return the best of all moves into each cell, each with its own bonus.

    Parameters
    ----------
    plane : (..., rows, cols) ndarray
        Values before the move; outside the frame counts as -inf.
    moves : (n, 2) ndarray of int
        Rows and columns of each move.
    log_prob : (n,) or (n, rows, cols) ndarray
        Log probability that is added with the move, by the cell it starts in [nat].

    Returns
    -------
    (..., rows, cols) ndarray
        ``max over moves (plane before the move + log_prob)``.

    """
    best = np.full_like(plane, -np.inf)
    for move, bonus in zip(moves, log_prob):
        (rows, rows_from), (cols, cols_from) = (_slices(int(step)) for step in move)
        target = best[..., rows, cols]
        own = bonus[rows_from, cols_from] if bonus.ndim else bonus
        np.maximum(target, plane[..., rows_from, cols_from] + own, out=target)
    return best


def extend_paths(state, ratio, radius, unused, lower, upper):
    """Return SDT's paths (D, ..., rows, cols) after a frame with log ratios (..., rows, cols)."""
    paths = np.empty((len(state) + 1, *ratio.shape), dtype=ratio.dtype)
    vicinity = vicinity_max(state, radius)
    paths[0] = ratio
    if unused and len(state):
        paths[0][vicinity.max(axis=0) > -np.inf] = -np.inf
    paths[1:] = vicinity + ratio
    early = paths[:-1] > upper
    closed = early | (paths[:-1] <= lower)
    np.maximum(
        paths[-1], np.where(early, paths[:-1], -np.inf).max(axis=0, initial=-np.inf),
        out=paths[-1])
    paths[:-1][closed] = -np.inf
    return paths


def extend_sums(before, ratio, drift, most):
    """Return CUSUM's sums (..., rows, cols) after a frame."""
    return np.clip(before - drift, 0.0, most) + ratio


def move_belief(model, belief):
    """Return the belief (dropped, kept, ..., rows, cols) of a grid filter after the move."""
    dropped, kept, *rest = belief.shape
    flat = belief.reshape(dropped, kept, -1).swapaxes(0, 1)
    spread = (model.kernel @ flat).reshape(kept, -1, *rest)
    for number, (down, across) in enumerate(model.moves):
        spread[:, number] = _shifted(spread[:, number], down, across)
    if model.history.shape == (1, 1):
        return spread.sum(axis=1, keepdims=True)
    return spread.swapaxes(0, 1) if model.history.shape[1] == 1 else spread


def _shifted(plane, down, across):
    """Return planes moved by cells, zero where nothing comes in."""
    rows, cols = plane.shape[-2:]
    padded = np.pad(plane, [(0, 0)] * (plane.ndim - 2) + [(abs(down),) * 2, (abs(across),) * 2])
    top, left = abs(down) - down, abs(across) - across
    return padded[..., top:top + rows, left:left + cols]


def _slices(step):
    if step >= 0:
        return slice(step, None), slice(None, -step or None)
    return slice(None, step), slice(-step, None)
