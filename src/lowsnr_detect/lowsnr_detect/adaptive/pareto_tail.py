"""
The tail of a distribution, extrapolated: generalised Pareto distributions, averaged.

Beyond ``START`` an excess e exceeds a value with probability ``(1 + xi (e - START) / s)^(-1/xi)``
(Pickands 1975; exponential for xi = 0).  Scale s and shape xi are not estimated but averaged over
their posterior, given how many excesses were seen in each of the bins, with a flat prior on a
grid: the result contains the uncertainty of few data.
"""

from __future__ import annotations

import numpy as np

# Excesses below it are not part of the tail.
START = 1.0
# Edges of the bins: from steps of a half to steps of fifty, the last one to infinity.
EDGES = np.concatenate([START + 6.0 * np.expm1(np.arange(64) * 0.08), [np.inf]])
# Scales and shapes of the grid.  A heavier tail than xi = 0.1 would, on few data, extrapolate
# beyond anything that was seen.
_SCALES = np.exp(np.linspace(np.log(0.5), np.log(5.0), 10))
_SHAPES = np.linspace(-0.3, 0.1, 8)
_SCALE, _SHAPE = (axis.ravel() for axis in np.meshgrid(_SCALES, _SHAPES, indexing='ij'))
# Values between which the answer is interpolated.
_EXCESS = START + 6.0 * np.expm1(np.linspace(0.0, 6.0, 240))
_LEAST_PROB = 1e-300


def survival(excess: np.ndarray) -> np.ndarray:
    """Return the probability to exceed each value (n,) by each distribution, (n, grid)."""
    inside = np.maximum(1.0 + _SHAPE * (excess[:, None] - START) / _SCALE, 0.0)
    with np.errstate(divide='ignore'):
        return np.asarray(np.exp(-np.log(inside) / _SHAPE))


_SURVIVAL = survival(_EXCESS)
_OF_EDGES = np.concatenate([survival(EDGES[:-1]), np.zeros((1, len(_SHAPE)))])
_LOG_BIN = np.log(np.maximum(-np.diff(_OF_EDGES, axis=0), 1e-12))


def exceeded(counts: np.ndarray, prob: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the excess that one beyond ``START`` exceeds with a probability.

    Parameters
    ----------
    counts : (..., bins) ndarray
        How many independent excesses were seen between the ``EDGES``; may be fractions.
    prob : (...,) ndarray
        Probabilities in (0, 1).

    Returns
    -------
    excess : (...,) ndarray
        The values.
    slope : (...,) ndarray
        Decrease of the log of the probability there, per unit of the excess [nat].

    """
    log_posterior = counts @ _LOG_BIN
    weight = np.exp(log_posterior - log_posterior.max(axis=-1, keepdims=True))
    weight /= weight.sum(axis=-1, keepdims=True)
    log_prob = np.log(np.maximum(weight @ _SURVIVAL.T, _LEAST_PROB))
    wanted = np.log(prob)
    after = np.clip(np.sum(log_prob >= wanted[..., None], axis=-1), 1, len(_EXCESS) - 1)
    high, low = (
        np.take_along_axis(log_prob, at[..., None], -1)[..., 0] for at in (after - 1, after))
    width, fall = _EXCESS[after] - _EXCESS[after - 1], np.maximum(high - low, 1e-6)
    part = np.clip((high - wanted) / fall, 0.0, 1.0)
    return _EXCESS[after - 1] + part * width, fall / width
