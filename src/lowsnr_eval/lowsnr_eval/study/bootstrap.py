# SPDX-License-Identifier: Apache-2.0
"""
Confidence intervals of figures over many runs, and of differences of chains on the same runs.

The frames of a run depend on each other, and two chains get the same frames.  The bootstrap
therefore draws whole runs, the same ones for both chains (paired bootstrap).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np
from scipy.special import ndtri

_DRAWS = 2000
_Z = float(ndtri(0.975))


@dataclass(frozen=True)
class Effect:
    """
    A figure of many runs with its 95 % interval.

    ``value`` and ``interval`` are None where there is no data.
    """

    value: float | None
    interval: tuple[float, float] | None


def bootstrap(
    sums: np.ndarray, figure: Callable[[np.ndarray], np.ndarray], seed: int,
) -> Effect:
    """
    Return a figure with its 95 % percentile interval, by drawing whole runs.

    Parameters
    ----------
    sums : (runs, n) ndarray
        Contribution of each run to n sums.
    figure
        Maps the sums over runs, (..., n), to the figure, (...); NaN where there is no data.
    seed
        Seed of the draws.

    """
    runs = len(sums)
    value = float(figure(sums.sum(axis=0))) if runs else math.nan
    if not math.isfinite(value):
        return Effect(None, None)
    rng = np.random.default_rng(seed)
    counts = rng.multinomial(runs, np.full(runs, 1.0 / runs), size=_DRAWS)
    drawn = figure(counts @ sums)
    drawn = drawn[np.isfinite(drawn)]
    if runs < 2 or drawn.size < _DRAWS / 2:
        return Effect(value, None)
    low, high = np.quantile(drawn, (0.025, 0.975))
    return Effect(value, (float(low), float(high)))


def share_interval(successes: np.ndarray, trials: np.ndarray) -> tuple[float, float] | None:
    """
    Return the 95 % interval of a share whose trials come in runs.

    It is Wilson's interval for the effective number of trials: the number of independent
    trials whose share has the variance that is seen between runs (Korn and Graubard 1998).

    Parameters
    ----------
    successes : (runs,) ndarray
        Successes of each run.
    trials : (runs,) ndarray
        Trials of each run.

    Returns
    -------
    tuple of float or None
        Lower and upper bound; None without trials.

    """
    total = float(np.sum(trials))
    if total == 0.0:
        return None
    share = float(np.sum(successes)) / total
    runs = len(trials)
    variance = np.sum((successes - share * trials) ** 2) / total**2 * runs / max(1, runs - 1)
    size = total
    if variance > 0.0:
        size = min(total, share * (1.0 - share) / float(variance))
    spread = _Z**2 / size
    half = math.sqrt(spread * share * (1.0 - share) + spread**2 / 4.0)
    low, high = share + spread / 2.0 - half, share + spread / 2.0 + half
    return max(0.0, low / (1.0 + spread)), min(1.0, high / (1.0 + spread))


def mean_square_band(squares: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return root mean squares over runs with their 95 % bands.

    Parameters
    ----------
    squares : (runs, frames) ndarray
        Squared errors, NaN where there is none.

    Returns
    -------
    tuple of (frames,) ndarray
        Root mean square, NaN without errors; lower and upper bound, NaN with fewer than two.

    """
    known = np.isfinite(squares)
    count = known.sum(axis=0)
    filled = np.where(known, squares, 0.0)
    with np.errstate(invalid='ignore', divide='ignore'):
        mean = filled.sum(axis=0) / count
        scatter = np.where(known, squares - mean, 0.0)
        half = _Z * np.sqrt(np.sum(scatter**2, axis=0) / (count - 1.0) / count)
    low, high = np.sqrt(np.maximum(mean - half, 0.0)), np.sqrt(mean + half)
    return np.sqrt(mean), low, high
