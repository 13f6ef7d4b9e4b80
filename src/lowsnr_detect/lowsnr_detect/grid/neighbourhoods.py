# SPDX-License-Identifier: Apache-2.0
"""
Local Bernoulli filters: every place of a frame is normalised by its surroundings alone.

With m(x) the mass that was predicted in a cell, l(x) the likelihood ratio of the frame, and A
and Q the sums of m and l m over some cells, the Bernoulli filter of one object in these cells
has the posterior ``l m / (1 - A + Q)``.  Which mass competes for one object?

- An object that is found in the frame before keeps its own: m_i is what its 3 x 3 cells are
  predicted to become, and A_i and Q_i are sums of it.
- All other mass, m_0, may become an object that is not found yet.  It competes within windows
  of 9 x 9 cells.

A bright cell is evidence for one object.  With o_i(x) the predicted mass of the other objects
in a cell, the likelihood ratio for object i is that of "i, or one of the others" to "one of
the others, or noise" ::

    l_i(x) = l(x) / (1 - o_i(x) + o_i(x) l(x))
    p(x)   = sum over i, with 0, of  l_i(x) m_i(x) / (1 - A_i(x) + Q_i(x))

so that an object does not take the cell of its neighbour, and both keep their mass.
"""

from __future__ import annotations

from lowsnr_detect.grid import neighbourhood_kernels as kernels
from lowsnr_detect.grid.transitions import Transitions
import numpy as np
import scipy

# Cells on each side in the window of mass without an object.
_WINDOW = 4
# Probability from which on an object is kept apart, and most such objects.
_FOUND, _MOST_FOUND = 0.2, 500
# Largest probability of an object; beyond it the odds would lose their last digits.
_MOST_PROB = 1.0 - 1e-12


def posterior(
    predicted: np.ndarray, likelihood: np.ndarray, owned: np.ndarray, cells: np.ndarray,
    least: float,
) -> np.ndarray:
    """
    Return the posterior mass p of every cell.

    Parameters
    ----------
    predicted, likelihood : (rows, cols) ndarray
        m and l of each cell.
    owned : (n, side, side) ndarray
        Predicted mass m_i of every object, around its cell; overwritten by its posterior.
    cells : (n, 2) ndarray of int
        Row and column of these cells.
    least
        Lower bound of ``1 - A``, for objects that came together.

    Returns
    -------
    (rows, cols) ndarray
        p.

    """
    occupied = np.zeros_like(predicted)
    kernels.add_windows(owned, cells, occupied)
    others = np.minimum(occupied, 1.0)
    rest = np.maximum(predicted - occupied, 0.0)
    weighed = rest * likelihood / (1.0 - others + others * likelihood)
    after = weighed / (
        np.maximum(1.0 - kernels.box_sums(rest, _WINDOW), least)
        + kernels.box_sums(weighed, _WINDOW))
    kernels.update_objects(owned, cells, occupied, likelihood, least)
    kernels.add_windows(owned, cells, after)
    return np.asarray(after)


def window_sums(planes: np.ndarray) -> np.ndarray:
    """Return the sums of planes (..., rows, cols) over the 9 x 9 cells around every cell."""
    sums = [kernels.box_sums(plane, _WINDOW) for plane in planes.reshape(-1, *planes.shape[-2:])]
    return np.reshape(sums, planes.shape)


def predicted_objects(
    transitions: Transitions, planes: np.ndarray, scale: np.ndarray, mass: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the cells of the objects that are found in a frame, and their predicted mass.

    Parameters
    ----------
    transitions
        Probabilities of the steps; there is a single mode.
    planes : (C, rows, cols) ndarray
        Mass of each class and cell, before ``scale``.
    scale, mass : (rows, cols) ndarray
        Factor and mass of each cell.

    Returns
    -------
    (n, 2) ndarray of int
        Rows and columns of the middle cells.
    (n, side, side) ndarray
        Mass in the next frame around each, if no object died.

    """
    cells, found = np.empty((_MOST_FOUND, 2), np.intp), np.empty(_MOST_FOUND)
    count = kernels.objects(mass, _FOUND, cells, found)
    cells = cells[:count] if found[0] >= _FOUND else cells[:0]
    side = 3 + 2 * int(abs(transitions.step).max(initial=0))
    owned = np.zeros((len(cells), side, side))
    if len(cells):
        kernels.predicted_objects(
            planes, scale, transitions.step, transitions.first_entry, transitions.source,
            transitions.prob, cells, np.empty(mass.shape, np.intp), owned)
    return cells, owned


def declared_objects(
    mass: np.ndarray, threshold: float, most: int,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the 3 x 3 cells that hold objects, and the log odds that they do.

    Parameters
    ----------
    mass : (B, rows, cols) ndarray
        Mass of each cell, for B runs.
    threshold
        Log odds that all but the first must have [nat].
    most
        Largest number D of objects.

    Returns
    -------
    (B, D, 2) ndarray of int
        Row and column of their middle cells, the most probable first.
    (B, D) ndarray
        Log odds, at most 27.6 [nat]; -inf where there is no object.

    """
    cells, prob = np.zeros((len(mass), most, 2), np.intp), np.zeros((len(mass), most))
    bound = float(scipy.special.expit(threshold))
    for one, places, found in zip(mass, cells, prob):
        found[kernels.objects(one, bound, places, found):] = 0.0
    return cells, _log_odds(prob)


def near_log_odds(mass: np.ndarray) -> np.ndarray:
    """Return the log odds that the 3 x 3 cells around each hold an object, (..., rows, cols)."""
    near = np.empty(mass.shape)
    for run in np.ndindex(*mass.shape[:-2]):
        near[run] = kernels.box_sums(mass[run], 1)
    return _log_odds(near)


def _log_odds(prob: np.ndarray) -> np.ndarray:
    prob = np.minimum(prob, _MOST_PROB)
    with np.errstate(divide='ignore'):
        return np.asarray(np.log(prob) - np.log1p(-prob))


def left_over(runs: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """
    Return which of the 3 x 3 cells of each object no object before it holds.

    Parameters
    ----------
    runs : (n,) ndarray of int
        Run of each object.
    cells : (n, 2) ndarray of int
        Row and column of its middle cell.

    Returns
    -------
    (n, 3, 3) ndarray of bool
        Whether its mass is counted for the object.

    """
    place = np.moveaxis(np.indices((3, 3)), 0, -1) - 1 + cells[:, None, None]
    free = np.ones(place.shape[:3], dtype=bool)
    for number, run in enumerate(runs):
        before = cells[:number][runs[:number] == run]
        away = abs(place[number][:, :, None] - before).max(axis=-1)
        free[number] = np.all(away > 1, axis=-1)
    return free
