"""
The sequential test of Section IV-A: Wald's bounds, and the same bounds for T_M.

The log-likelihood ratio of M frames along a path is, for a constant intensity I,
``ln L_M = (I / sigma^2) T_M - M I^2 / (2 sigma^2)``, so the bounds of eq. (6) on T_M
depend on M while those of eq. (5) on L_M do not.  The detectors therefore add log ratios.
"""

from __future__ import annotations

import math

from lowsnr_sensor.measurement import SensorModel
import numpy as np


def wald_bounds(alpha: float, beta: float) -> tuple[float, float]:
    """
    Return ln th_1 and ln th_2 of eq. (5) for wanted error probabilities.

    Parameters
    ----------
    alpha
        Probability that noise is declared an object, in (0, 1).
    beta
        Probability that an object is dismissed, in (0, 1); alpha + beta < 1.

    Returns
    -------
    tuple of float
        Lower and upper bound on the log-likelihood ratio (Wald 1945) [nat].

    """
    return math.log(beta / (1.0 - alpha)), math.log((1.0 - beta) / alpha)


def statistic_bound(log_threshold: float, iterations: int, sensor: SensorModel) -> float:
    """
    Return the bound th'(M) on T_M that stands for a bound on ln L_M.

    Parameters
    ----------
    log_threshold
        Bound on the log-likelihood ratio [nat].
    iterations
        Number of frames M in the sum.
    sensor
        Intensity I and noise sigma, without blur.

    Returns
    -------
    float
        ``(sigma^2 / I) ln(th) + M I / 2``, in units of the frame.

    """
    intensity = sensor.intensity
    return sensor.noise_std**2 / intensity * log_threshold + iterations * intensity / 2.0


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
