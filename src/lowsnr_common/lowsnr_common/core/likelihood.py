"""Likelihood ratios of a frame for states anywhere in it, and scaled ones of all cells."""

from __future__ import annotations

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.particle_kernels import blurred_ratio
from lowsnr_common.core.particle_kernels import cell_ratio
import numpy as np

# Rows that pass through all steps together, so that they stay in the cache of the processor.
_BLOCK = 32


def state_log_ratio(
    sensor: SensorModel, frame: np.ndarray, states: np.ndarray,
) -> np.ndarray:
    """
    Log-likelihood ratio of "object in this state" against "noise only".

    Without blur it is the ratio of the cell that holds the state, eq. (3); with blur it is the
    sum of ``h (2 z - h) / (2 sigma^2)``, h of eq. (2), over the cells the point spread reaches.

    Parameters
    ----------
    sensor
        Noise, blur and intensity.
    frame : (..., rows, cols) ndarray
        Cell intensities; leading axes are Monte Carlo runs.
    states : (..., N, 4) ndarray
        States [m, m/s].

    Returns
    -------
    (..., N) ndarray
        Log ratios [nat]; -inf for a state outside the frame.

    """
    frames = np.ascontiguousarray(frame, dtype=float).reshape(-1, *frame.shape[-2:])
    particles = np.ascontiguousarray(states).reshape(len(frames), -1, 4)
    size, variance = sensor.cell_size_m, sensor.noise_std**2
    if sensor.blur_m == 0.0:
        ratio = cell_ratio(
            frames, particles, size, sensor.intensity, sensor.intensity / (2.0 * variance))
    else:
        peak = sensor.intensity * size**2 / (2.0 * np.pi * sensor.blur_m**2)
        ratio = blurred_ratio(frames, particles, size, sensor.blur_reach, sensor.blur_m, peak)
        ratio /= 2.0 * variance
    return np.asarray(ratio).reshape(states.shape[:-1])


def relative_likelihood(
    sensor: SensorModel, frame: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Likelihood ratio of each cell, divided by the largest of the frame.

    Parameters
    ----------
    sensor
        Noise, blur and intensity.
    frame : (..., rows, cols) ndarray
        Cell intensities; leading axes are Monte Carlo runs.

    Returns
    -------
    (..., rows, cols) ndarray
        Ratios, at most 1.
    (...,) ndarray
        Log of the largest ratio [nat].

    """
    if sensor.blur_m > 0.0:
        ratio = sensor.log_likelihood_ratio(frame)
        peak = ratio.max(axis=(-2, -1))
        ratio -= peak[..., None, None]
        return np.exp(ratio, out=ratio), peak
    brightest = frame.max(axis=(-2, -1))
    slope, above = sensor.intensity / sensor.noise_std**2, brightest[..., None, None]
    weight = np.empty(frame.shape)
    for first in range(0, frame.shape[-2], _BLOCK):
        rows = slice(first, first + _BLOCK)
        part = weight[..., rows, :]
        np.subtract(frame[..., rows, :], above, out=part, dtype=float)
        part *= slope
        np.exp(part, out=part)
    return weight, np.asarray(sensor.log_likelihood_ratio(brightest))
