"""From cells that crossed a threshold to a few declarations: one for each object."""

from __future__ import annotations

from lowsnr_detect.detector import Declarations
from lowsnr_sensor.motion import POS
import numpy as np


def declare_cells(
    excess: np.ndarray, peak: np.ndarray, *, reach: int, most: int, cell_size_m: float,
    position_std_m: float,
) -> Declarations:
    """
    Thin crossing cells, strongest first, and make declarations of what is left.

    A path or a point spread makes neighbouring cells cross together.  The strongest cell
    is kept and takes with it all others within ``reach`` cells, then the next strongest.

    Parameters
    ----------
    excess : (..., rows, cols) ndarray
        How far each cell's log-likelihood ratio lies above the log threshold [nat];
        -inf where the cell did not cross.
    peak : (...,) ndarray
        Largest value of the test statistic [nat], passed on.
    reach
        Cells on each side that a declaration suppresses.
    most
        Largest number D of declarations in a frame.
    cell_size_m
        Side of a cell [m].
    position_std_m
        Standard deviation of a declared position per axis [m].

    Returns
    -------
    Declarations
        Scores are ``L / (L + th)``: the posterior probability at the prior odds for which
        the threshold is the Bayes test, so 1/2 at the threshold.

    """
    batch, (rows, cols) = excess.shape[:-2], excess.shape[-2:]
    planes = excess.reshape(-1, rows, cols)
    run, row, col = np.nonzero(planes > -np.inf)
    value = planes[run, row, col]
    order = np.lexsort((-value, run))
    run, row, col, value = run[order], row[order], col[order], value[order]
    score = np.zeros((len(planes), most))
    state = np.full((len(planes), most, 4), np.nan)
    for slot in range(most):
        if run.size == 0:
            break
        first = np.flatnonzero(np.diff(run, prepend=-1))
        kept = run[first]
        score[kept, slot] = 1.0 / (1.0 + np.exp(-np.minimum(value[first], 700.0)))
        state[kept[:, None], slot, POS] = cell_size_m * np.stack([col[first], row[first]], -1)
        owner = first[np.searchsorted(kept, run)]
        far = np.maximum(abs(row - row[owner]), abs(col - col[owner])) > reach
        run, row, col, value = run[far], row[far], col[far], value[far]
    cov = np.full((*state.shape, 4), np.nan)
    cov[score > 0.0] = _position_cov(position_std_m)
    return Declarations(
        peak, score.reshape(*batch, most), state.reshape(*batch, most, 4),
        cov.reshape(*batch, most, 4, 4))


def _position_cov(std: float) -> np.ndarray:
    cov = np.full((4, 4), np.nan)
    cov[np.ix_(POS, POS)] = std**2 * np.eye(2)
    return cov
