# SPDX-License-Identifier: Apache-2.0
"""Upper quantiles of a sample, also of those rarer than the sample can show."""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np

# Larger values that a sample quantile needs: its probability then has an error of 10 %.
_COUNTED = 100
# Largest values that the tail is fitted to, and the largest fraction of the sample they may be.
# The fit covers the quantiles up to _COUNTED with several times as many values, and stays in
# the tail, which a generalised Pareto distribution describes (Pickands 1975).
_FITTED = 400
_MOST_FITTED = 0.25


def upper_quantiles(values: np.ndarray, probs: Sequence[float] | np.ndarray) -> np.ndarray:
    """
    Return the values that are exceeded with given probabilities.

    Where the sample holds a hundred larger values it is the sample quantile.  Where it
    does not, a generalised Pareto distribution is fitted to the 400 largest values by
    probability-weighted moments (Hosking and Wallis 1987), and the quantile is that of the fit.

    Parameters
    ----------
    values : (N,) ndarray
        Sample; -inf for a value that exceeds nothing.
    probs : (P,) array_like
        Probabilities of exceedance, in (0, 1).

    Returns
    -------
    (P,) ndarray
        The quantiles.  Where the fraction of finite values does not exceed the probability, it
        is just below all of them, and 0 if there are none.

    """
    probs, count = np.asarray(probs, dtype=float), len(values)
    finite = np.sort(values[np.isfinite(values)])
    if not len(finite):
        return np.zeros(len(probs))
    found = np.full(len(probs), np.nextafter(finite[0], -np.inf))
    reached = len(finite) > probs * count
    fitted = min(_FITTED, int(_MOST_FITTED * count), len(finite) - 1)
    counted = reached & ((probs * count >= min(_COUNTED, fitted)) | (fitted < 2))
    found[counted] = np.quantile(finite, 1.0 - probs[counted] * count / len(finite))
    if np.any(rare := reached & ~counted):
        bound, excess = finite[-fitted - 1], finite[-fitted:] - finite[-fitted - 1]
        found[rare] = bound + _pareto_quantiles(excess, probs[rare] * count / fitted)
    return found


def upper_quantile(values: np.ndarray, prob: float) -> float:
    """Return the value that is exceeded with a probability, as :func:`upper_quantiles`."""
    return float(upper_quantiles(values, [prob])[0])


def _pareto_quantiles(excess: np.ndarray, probs: np.ndarray) -> np.ndarray:
    """Fit ascending excesses over a bound; return those exceeded with the probabilities."""
    count = len(excess)
    above = (count - np.arange(count) - 0.5) / count
    first, second = float(np.mean(excess)), float(np.mean(above * excess))
    if first <= 2.0 * second:
        return np.asarray(np.quantile(excess, 1.0 - probs))
    shape = first / (first - 2.0 * second) - 2.0
    scale = 2.0 * first * second / (first - 2.0 * second)
    if abs(shape) < 1e-6:
        return np.array([-scale * math.log(prob) for prob in probs.tolist()])
    return np.array([scale / shape * (1.0 - prob**shape) for prob in probs.tolist()])
