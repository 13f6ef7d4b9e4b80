"""Upper quantiles of a sample, also of those rarer than the sample can show."""

from __future__ import annotations

import math

import numpy as np

_COUNTED = 100
_FITTED = 400
_MOST_SHARE = 0.25


def upper_quantile(values: np.ndarray, prob: float) -> float:
    """
    Return the value that is exceeded with a probability.

    Where the sample holds a hundred larger values it is the sample quantile.  Where it
    does not, a generalised Pareto distribution is fitted to the 400 largest values by
    probability-weighted moments (Hosking and Wallis 1987) and read there.

    Parameters
    ----------
    values : (N,) ndarray
        Sample; -inf for what exceeds nothing.
    prob
        Probability of exceedance, in (0, 1).

    Returns
    -------
    float
        The quantile.  Where the finite values are fewer than the probability asks for, it is
        just below all of them, and 0 if there are none.

    """
    count = len(values)
    finite = values[np.isfinite(values)]
    if len(finite) <= prob * count:
        return float(np.nextafter(finite.min(), -np.inf)) if len(finite) else 0.0
    fitted = min(_FITTED, int(_MOST_SHARE * count), len(finite) - 1)
    if prob * count >= min(_COUNTED, fitted) or fitted < 2:
        return float(np.quantile(finite, 1.0 - prob * count / len(finite)))
    tail = np.partition(values, count - fitted - 1)[count - fitted - 1:]
    tail.sort()
    return float(tail[0]) + _pareto_quantile(tail[1:] - tail[0], prob * count / fitted)


def _pareto_quantile(excess: np.ndarray, prob: float) -> float:
    """Fit ascending excesses over a bound; return what is exceeded with the probability."""
    count = len(excess)
    above = (count - np.arange(count) - 0.5) / count
    first, second = float(np.mean(excess)), float(np.mean(above * excess))
    if first <= 2.0 * second:
        return float(np.quantile(excess, 1.0 - prob))
    shape = first / (first - 2.0 * second) - 2.0
    scale = 2.0 * first * second / (first - 2.0 * second)
    if abs(shape) < 1e-6:
        return -scale * math.log(prob)
    return scale / shape * (1.0 - prob**shape)
