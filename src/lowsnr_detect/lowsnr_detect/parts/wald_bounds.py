# SPDX-License-Identifier: Apache-2.0
"""
Both sides of a likelihood ratio test in float32: Wald's bounds, and the log ratio of every cell.

By the sensor model the log-likelihood ratio of a cell, eq. (4), is
``ln L(z) = (I / sigma^2) z - I^2 / (2 sigma^2)``: linear in the measurement.  With blur, in other
noise and for an intensity that is not known it is another function of the frame.
"""

from __future__ import annotations

import functools
import math

from lowsnr_common.core.likelihood import cell_log_ratio
from lowsnr_common.core.measurement import SensorModel
import numpy as np


def wald_bounds(alpha: float, beta: float) -> tuple[float, float]:
    """
    Return ln th_1 and ln th_2 of eq. (5) for given error probabilities (Wald 1945).

    Parameters
    ----------
    alpha
        Probability that noise is declared an object, in (0, 1).
    beta
        Probability that an object is dismissed, in (0, 1); alpha + beta < 1.

    Returns
    -------
    tuple of float
        ``ln(beta / (1 - alpha))`` and ``ln((1 - beta) / alpha)`` [nat].

    """
    return math.log(beta / (1.0 - alpha)), math.log((1.0 - beta) / alpha)


def ratio_terms(
    sensor: SensorModel, frame: np.ndarray,
) -> tuple[np.ndarray, np.float32, np.float32]:
    """
    Return the terms of the log-likelihood ratio of every cell.

    Parameters
    ----------
    sensor
        Intensity, noise and blur.
    frame : (..., rows, cols) ndarray
        Cell intensities.

    Returns
    -------
    plane : (B, rows, cols) ndarray
        The frame; where the log ratio is not linear, the log ratio itself.  B is the number of
        runs.
    factor, offset : float32
        ``float32(plane) * factor - offset`` is the log ratio [nat].

    """
    plane = frame if sensor.is_linear else cell_log_ratio(sensor, frame)
    planes = np.ascontiguousarray(plane).reshape(-1, *frame.shape[-2:])
    return planes, *_scale(sensor)


@functools.lru_cache(maxsize=64)
def _scale(sensor: SensorModel) -> tuple[np.float32, np.float32]:
    """Return factor and offset of the log-likelihood ratio."""
    if not sensor.is_linear:
        return np.float32(1.0), np.float32(0.0)
    factor = sensor.intensity / sensor.noise_std**2
    return np.float32(factor), np.float32(factor * sensor.intensity / 2.0)


@functools.lru_cache(maxsize=256)
def floor32(bound: float) -> np.float32:
    """Return the largest float32 that is not above a bound: a float32 exceeds both or none."""
    most = float(np.finfo(np.float32).max)
    bound = min(max(bound, -most), most)
    near = np.float32(bound)
    return np.nextafter(near, np.float32(-np.inf)) if float(near) > bound else near
