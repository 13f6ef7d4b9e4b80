# SPDX-License-Identifier: Apache-2.0
"""
Noise learned from frames without objects, by its quantiles.

Detectors compare with thresholds that a cell exceeds once in 1e5 or 1e6 cells.  Quantiles of the
rarest cells are therefore not those of the sample but of a generalised Pareto distribution
(Pickands 1975), fitted to the excesses by probability-weighted moments (Hosking and Wallis 1987).
"""

from __future__ import annotations

from dataclasses import dataclass
import functools
import math

import numpy as np
import scipy

# Log odds of the outermost quantiles: the probability 1e-6 on each side.
_MOST_LOG_ODDS = math.log(999_999.0)
# Part of the cells on each side that the tail is fitted to.
_RAREST = 0.002
# Step of the table that is sampled, and its length beyond the quantiles [standard deviations].
_STEP, _BEYOND = 0.01, 15.0
# So that each tail is fitted to 200 cells.
_LEAST_CELLS, _LEAST_DISTINCT = 100_000, 5


@dataclass(frozen=True)
class Empirical:
    """
    Noise of known quantiles, in units of ``std``.

    The log density is linear between the middles of neighbouring quantiles and beyond the last,
    where it falls so that the probability beyond these middles is left there.
    """

    std: float
    quantiles: tuple[float, ...]

    @functools.cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return values, log density and distribution function, (n,), in units of ``std``."""
        points, probs = np.array(self.quantiles), quantile_probs(len(self.quantiles))
        middle = (points[1:] + points[:-1]) / 2.0
        log_density = np.log(np.diff(probs) / np.diff(points))
        values = np.arange(points[0] - _BEYOND, points[-1] + _BEYOND, _STEP)
        line = np.interp(values, middle, log_density)
        # Half of the outermost intervals lies beyond their middles.
        rate = np.exp(log_density[[0, -1]]) / probs[:2].mean()
        line -= rate[0] * np.maximum(middle[0] - values, 0.0)
        line -= rate[1] * np.maximum(values - middle[-1], 0.0)
        mass = np.exp(line)
        below = np.cumsum(mass) - mass / 2.0
        return values, line - math.log(mass.sum() * _STEP), below / mass.sum()

    def log_density(self, z: np.ndarray, signal: float) -> np.ndarray:
        """Return ln p(z | signal); what is beyond the table counts as its end."""
        values, log_density, _ = self._table
        scaled = (np.asarray(z) - signal) / self.std
        return np.asarray(np.interp(scaled, values, log_density) - math.log(self.std))

    def draw(self, signal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return cells with the given signals."""
        values, _, below = self._table
        return np.asarray(signal + self.std * np.interp(rng.random(signal.shape), below, values))


def quantile_probs(count: int) -> np.ndarray:
    """Return the probabilities of the quantiles of ``empirical``: equal steps in log odds."""
    return np.asarray(scipy.special.expit(np.linspace(-_MOST_LOG_ODDS, _MOST_LOG_ODDS, count)))


def learned_quantiles(values: np.ndarray, count: int = 81) -> tuple[float, ...]:
    """
    Return the quantiles of noise, for ``empirical``, in units of its standard deviation.

    The probability of a value that one cell in 40,000 exceeds has a standard error of 10 % if
    learned from ten million normal cells, 20 % from one million, and 40 % from the fewest allowed.

    Parameters
    ----------
    values : (...) ndarray
        Cells of frames without objects and without a background.
    count
        Number of quantiles.

    Raises
    ------
    ValueError
        If cells are not finite, there are too few of them or of distinct values, or their mean
        exceeds their deviation.

    """
    unfit = values.size - int(np.isfinite(values).sum())
    if unfit:
        raise ValueError(
            f'{unfit} of {values.size} cells are not finite: leave them out to learn noise')
    distinct, counts = np.unique(values, return_counts=True)
    if values.size < _LEAST_CELLS or len(distinct) < _LEAST_DISTINCT:
        raise ValueError(
            f'{values.size} cells with {len(distinct)} distinct values are too few to learn noise '
            f'from: give frames with {_LEAST_CELLS} cells, and {_LEAST_DISTINCT} values, or more')
    mean, std = float(values.mean()), float(values.std())
    if abs(mean) > std:
        raise ValueError(
            f'the mean {mean:g} of the cells exceeds their standard deviation {std:g}: subtract '
            'the background, or give conditioned frames')
    found = _quantiles(distinct, counts, quantile_probs(count)) / std
    return tuple(float(f'{each:.9g}') for each in found)


def _quantiles(distinct: np.ndarray, counts: np.ndarray, probs: np.ndarray) -> np.ndarray:
    """Return the quantiles of a sample, by its distinct values and their counts (n,)."""
    # The cells of a value spread evenly half of the way to its neighbours.
    inner = (distinct[1:] + distinct[:-1]) / 2.0
    edges = np.concatenate([
        [1.5 * distinct[0] - 0.5 * distinct[1]], inner, [1.5 * distinct[-1] - 0.5 * distinct[-2]]])
    size = int(counts.sum())
    below = np.concatenate([[0], np.cumsum(counts)]) / size
    rank = _RAREST * (np.arange(int(_RAREST * size)) + 0.5) / int(_RAREST * size)

    def value(prob: np.ndarray) -> np.ndarray:
        return np.asarray(np.interp(prob, below, edges))

    found, low, high = value(probs), probs < _RAREST, probs > 1.0 - _RAREST
    first, last = value(np.array([_RAREST, 1.0 - _RAREST]))
    found[low] = first - _excesses(first - value(rank), probs[low] / _RAREST)
    found[high] = last + _excesses(value(1.0 - rank) - last, (1.0 - probs[high]) / _RAREST)
    return found


def _excesses(sample: np.ndarray, probs: np.ndarray) -> np.ndarray:
    """Return what excesses exceed with some probabilities, fitted to a descending sample (n,)."""
    first = sample.mean()
    second = np.mean((np.arange(len(sample)) + 0.5) / len(sample) * sample)
    scale = 2.0 * first * second / (first - 2.0 * second)
    return np.asarray(scale * scipy.special.boxcox(
        1.0 / probs, 2.0 - first / (first - 2.0 * second)))
