# SPDX-License-Identifier: Apache-2.0
"""
Figures of merit of Section VI, as pure functions of distances and counts.

Objects and estimates of one frame meet in a matrix of distances, objects by estimates;
all other figures follow from it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np
import scipy

# Takes distances and a gate; returns the rows and columns of pairs.
Matching = Callable[[np.ndarray, float], tuple[np.ndarray, np.ndarray]]


def distances(objects: np.ndarray, estimates: np.ndarray) -> np.ndarray:
    """
    Return the Euclidean distance of every estimate from every object.

    Parameters
    ----------
    objects : (N, 2) ndarray
        Positions [m].
    estimates : (M, 2) ndarray
        Positions [m]; an unknown one is NaN.

    Returns
    -------
    (N, M) ndarray
        Distances [m]; infinite where a position is unknown.

    """
    offset = objects[:, None, :] - estimates[None, :, :]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    return np.where(np.isnan(distance), np.inf, distance)


def match_within_gate(distance: np.ndarray, gate: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Pair objects with the estimates that hit them, one with one.

    The pairing has as many pairs as the gate allows, and among those pairings the least sum of
    distances.  With one object it is the nearest estimate within the gate.

    Parameters
    ----------
    distance : (N, M) ndarray
        Distances of objects from estimates [m].
    gate
        Largest distance of a hit [m], inclusive.

    Returns
    -------
    (pairs,) ndarray of int
        Objects hit, ascending.
    (pairs,) ndarray of int
        The estimate that hits each.

    """
    within = distance <= gate
    if not within.any():
        return np.empty(0, dtype=int), np.empty(0, dtype=int)
    # One pair outside the gate costs more than all the pairs that can lie within it.
    outside = gate * (min(distance.shape) + 1) + 1.0
    rows, columns = scipy.optimize.linear_sum_assignment(np.where(within, distance, outside))
    hit = within[rows, columns]
    return rows[hit], columns[hit]


def match_nearest(distance: np.ndarray, gate: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Pair objects and estimates each of which is the nearest one of the other, within the gate.

    Parameters and results are those of :func:`match_within_gate`.
    """
    if not distance.size:
        return np.empty(0, dtype=int), np.empty(0, dtype=int)
    nearest = distance.argmin(axis=1)
    rows = np.arange(len(distance))
    near = (distance.argmin(axis=0)[nearest] == rows) & (distance[rows, nearest] <= gate)
    return rows[near], nearest[near]


def count_false_alarms(distance: np.ndarray, gate: float) -> int:
    """Count the estimates [column] that lie within the gate of no object [row]."""
    return int(np.sum(~np.any(distance <= gate, axis=0)))


def gospa(distance: np.ndarray, cutoff: float, order: float = 2.0) -> float:
    """
    Generalised optimal sub-pattern assignment metric, alpha = 2.

    ``d = [min over assignments of sum d(x, y)^p + c^p / 2 (missed + false)]^(1/p)``, from
    Rahmathullah, Garcia-Fernandez and Svensson, "Generalized optimal sub-pattern
    assignment metric", FUSION 2017, Proposition 1.  The minimum is exact.

    Parameters
    ----------
    distance : (N, M) ndarray
        Distances of objects from estimates [m].
    cutoff
        Distance c beyond which an object is missed and an estimate false [m].
    order
        Exponent p, at least 1.

    Returns
    -------
    float
        Metric [m]; 0 where there is neither object nor estimate.

    """
    return float(sum(gospa_parts(distance, cutoff, order)) ** (1.0 / order))


def gospa_parts(
    distance: np.ndarray, cutoff: float, order: float = 2.0,
) -> tuple[float, float, float]:
    """
    Return the parts of ``gospa^p``: of localisation, missed objects and false estimates.

    ``sum d(x, y)^p`` over the assigned pairs nearer than c, and ``c^p / 2`` for each object and
    for each estimate that is in no such pair; the parameters are those of :func:`gospa`, the
    unit is [m^p].
    """
    objects, estimates = distance.shape
    unit = cutoff**order / 2.0
    if not distance.size:
        return 0.0, unit * objects, unit * estimates
    # With alpha = 2 a pair at the cutoff costs as much as one missed and one false.
    cost = np.minimum(distance, cutoff) ** order
    chosen = scipy.optimize.linear_sum_assignment(cost)
    near = distance[chosen] < cutoff
    pairs = int(near.sum())
    return (
        float(cost[chosen][near].sum()), unit * (objects - pairs), unit * (estimates - pairs))


def wilson_interval(
    successes: int, trials: int, confidence: float = 0.95,
) -> tuple[float, float] | None:
    """
    Wilson's score interval for a probability.

    The p for which ``|p_hat - p| <= z sqrt(p (1 - p) / n)``: centre
    ``(p_hat + z^2 / 2n) / (1 + z^2 / n)``, half width
    ``z / (1 + z^2 / n) sqrt(p_hat (1 - p_hat) / n + z^2 / 4n^2)`` (Wilson 1927).  It holds
    for independent trials; successive frames of one run are not quite that.

    Parameters
    ----------
    successes
        Trials that succeeded, 0 to ``trials``.
    trials
        Number of trials n.
    confidence
        Probability that the interval covers, in (0, 1).

    Returns
    -------
    tuple of float or None
        Lower and upper bound; None where nothing was tried.

    """
    if trials == 0:
        return None
    share = successes / trials
    spread = scipy.special.ndtri(0.5 + confidence / 2.0) ** 2 / trials
    half = math.sqrt(spread * share * (1.0 - share) + spread**2 / 4.0)
    low, high = share + spread / 2.0 - half, share + spread / 2.0 + half
    return max(0.0, low / (1.0 + spread)), min(1.0, high / (1.0 + spread))


def ratio(count: int, trials: int) -> float | None:
    """Return a share; None where nothing was tried."""
    return count / trials if trials else None


def root_mean_square(errors: np.ndarray) -> float | None:
    """Return ``sqrt(mean(e^2))`` in the unit of the errors; None of no errors."""
    return math.sqrt(np.mean(np.square(errors))) if np.size(errors) else None


@dataclass
class RootMeanSquare:
    """``sqrt(sum of e^2 / n)`` over errors that come in groups."""

    total: float = 0.0
    count: int = 0

    def add(self, rms: float | None, count: int) -> None:
        """Add a group of errors by its root mean square, None for that of no errors."""
        if rms is not None:
            self.total += count * rms**2
            self.count += count

    @property
    def value(self) -> float | None:
        """Root mean square so far, in the unit of the errors; None of no errors."""
        return math.sqrt(self.total / self.count) if self.count else None
