# SPDX-License-Identifier: Apache-2.0
"""Several objects in a frame: their states from the masses of neighbourhoods, strongest first."""

from __future__ import annotations

from lowsnr_common.core.records import Prediction
from lowsnr_detect.grid.neighbourhoods import left_over
from lowsnr_detect.parts.detector import Declarations
from lowsnr_detect.parts.local_estimate import windows
import numpy as np


def masses(
    planes: np.ndarray, scale: np.ndarray, runs: np.ndarray, cells: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the predicted and the posterior mass of each object's histories in 3 x 3 cells.

    Parameters
    ----------
    planes : (C, ..., rows, cols) ndarray
        Predicted mass m_k of each history of moves and cell.
    scale : (..., rows, cols) ndarray
        Factor by which the frame multiplies the mass of a cell.
    runs : (n,) ndarray of int
        Run of each object.
    cells : (n, 2) ndarray of int
        Row and column of its middle cell.

    Returns
    -------
    (n, C, 3, 3) ndarray, (n, C, 3, 3) ndarray
        m_k and p_k.

    """
    rows, cols = scale.shape[-2:]
    predicted = windows(planes.reshape(len(planes), -1, rows, cols), runs, cells)
    predicted = predicted * left_over(runs, cells)[:, None]
    return predicted, predicted * windows(scale.reshape(1, -1, rows, cols), runs, cells)


def strongest_first(
    threshold: float, batch: list[int], found: Declarations, before: Prediction,
) -> Declarations:
    """Return the objects (B, D) that exceed the threshold, for runs in the shape of a batch."""
    order = np.arange(len(found.peak))[:, None], np.argsort(-found.peak, axis=1, kind='stable')
    statistic, mean, cov = found.peak[order], found.state[order], found.cov[order]
    used, slots, before = statistic > threshold, (*batch, statistic.shape[1]), before[order]
    mean[~used], cov[~used] = np.nan, np.nan
    return Declarations(
        statistic[:, 0].reshape(batch), np.where(used, found.score[order], 0.0).reshape(slots),
        mean.reshape(*slots, 4), cov.reshape(*slots, 4, 4), Prediction(
            before.score.reshape(slots), before.position.reshape(*slots, 2),
            before.cov.reshape(*slots, 2, 2)))
