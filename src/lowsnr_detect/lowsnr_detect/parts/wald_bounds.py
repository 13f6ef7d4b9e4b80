"""
The sequential test of Section IV-A: Wald's bounds, and the same bounds for T_M.

The log-likelihood ratio of M frames along a path is, for a constant intensity I,
``ln L_M = (I / sigma^2) T_M - M I^2 / (2 sigma^2)``, so the bounds of eq. (6) on T_M
depend on M while those of eq. (5) on L_M do not.  The detectors therefore add log ratios.
"""

from __future__ import annotations

import functools
import math

from lowsnr_common.core.measurement import SensorModel
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


def ratio_terms(
    sensor: SensorModel, frame: np.ndarray,
) -> tuple[np.ndarray, np.float32, np.float32]:
    """
    Return what the log-likelihood ratio of every cell is made of.

    Parameters
    ----------
    sensor
        Intensity, noise and blur.
    frame : (..., rows, cols) ndarray
        Cell intensities.

    Returns
    -------
    plane : (B, rows, cols) ndarray
        The frame, or the ratio where it is not one of the cell alone; B is the number of runs.
    factor, offset : float32
        ``float32(plane) * factor - offset`` is the ratio [nat].

    """
    plane = sensor.log_likelihood_ratio(frame) if sensor.blur_m > 0.0 else frame
    planes = np.ascontiguousarray(plane).reshape(-1, *frame.shape[-2:])
    return planes, *_scale(sensor)


@functools.lru_cache(maxsize=64)
def _scale(sensor: SensorModel) -> tuple[np.float32, np.float32]:
    """Return factor and offset of the log-likelihood ratio."""
    if sensor.blur_m > 0.0:
        return np.float32(1.0), np.float32(0.0)
    factor = sensor.intensity / sensor.noise_std**2
    return np.float32(factor), np.float32(factor * sensor.intensity / 2.0)


@functools.lru_cache(maxsize=256)
def floor32(bound: float) -> np.float32:
    """Return the largest float32 that is not above a bound: ``>`` says of both the same."""
    most = float(np.finfo(np.float32).max)
    bound = min(max(bound, -most), most)
    near = np.float32(bound)
    return np.nextafter(near, np.float32(-np.inf)) if float(near) > bound else near
