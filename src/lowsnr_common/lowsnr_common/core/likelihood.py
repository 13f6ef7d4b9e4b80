# SPDX-License-Identifier: Apache-2.0
"""Likelihood ratios of a frame for states anywhere in it, and scaled ones of all cells."""

from __future__ import annotations

import functools
import math

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.particle_kernels import blurred_ratio
from lowsnr_common.core.particle_kernels import cell_ratio
import numpy as np

# Points of a cell, along each side, over which the likelihood of an object in it is the mean, and
# to which the position of a particle is rounded where there is no closed form: with blur.
_CELL_POINTS, _STATE_POINTS = 2, 4
# Rows that pass through all steps together, so that they stay in the cache of the processor.
_BLOCK = 32


def state_log_ratio(
    sensor: SensorModel, frame: np.ndarray, states: np.ndarray,
) -> np.ndarray:
    """
    Log-likelihood ratio of "object in this state" against "noise only".

    Without blur it is the ratio of the cell that holds the state, eq. (3); with blur it is the
    sum of ``h (2 z - h) / (2 sigma^2)``, h of eq. (2), over the cells the point spread reaches.
    For other noise, and an intensity that is not known, the position in a cell is rounded to a
    quarter.

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
    if not sensor.is_normal:
        points = 1 if sensor.blur_m == 0.0 else _STATE_POINTS
        planes = np.ascontiguousarray(point_log_ratio(sensor, frames, points))
        # The centre of the first point of the first cell becomes the origin.
        corner = np.array([1.0, 0.0, 1.0, 0.0]) * size * (points - 1) / (2 * points)
        ratio = cell_ratio(planes, particles + corner, size / points, 0.0, 0.5)
    elif sensor.blur_m == 0.0:
        ratio = cell_ratio(
            frames, particles, size, sensor.intensity, sensor.intensity / (2.0 * variance))
    else:
        peak = sensor.intensity * size**2 / (2.0 * np.pi * sensor.blur_m**2)
        ratio = blurred_ratio(frames, particles, size, sensor.blur_reach, sensor.blur_m, peak)
        ratio /= 2.0 * variance
    return np.asarray(ratio).reshape(states.shape[:-1])


def point_log_ratio(sensor: SensorModel, frame: np.ndarray, points: int) -> np.ndarray:
    """
    Return the log-likelihood ratio of an object in each of several points of every cell.

    Parameters
    ----------
    sensor
        Noise, blur and intensity.
    frame : (..., rows, cols) ndarray
        Cell intensities; leading axes are Monte Carlo runs.
    points
        Points R along each side of a cell, in the middles of its parts.

    Returns
    -------
    (..., R rows, R cols) ndarray
        Log ratios [nat]; without blur those of the cells.

    """
    if sensor.blur_m == 0.0 or points == 1:
        ratio = sensor.log_likelihood_ratio(frame)
        return ratio.repeat(points, axis=-2).repeat(points, axis=-1)
    *batch, rows, cols = frame.shape
    ratio = np.empty((*batch, rows, points, cols, points))
    offsets = (np.arange(points) + 0.5) / points - 0.5
    for row, col in np.ndindex(points, points):
        ratio[..., row, :, col] = sensor.log_likelihood_ratio(
            frame, (float(offsets[row]), float(offsets[col])))
    return ratio.reshape(*batch, rows * points, cols * points)


def cell_log_ratio(sensor: SensorModel, frame: np.ndarray) -> np.ndarray:
    """
    Return the log-likelihood ratio of an object in every cell, of a position that is not known.

    With blur it is the log of the mean likelihood ratio over points of the cell.

    Parameters
    ----------
    sensor
        Noise, blur and intensity.
    frame : (..., rows, cols) ndarray
        Cell intensities; leading axes are Monte Carlo runs.

    Returns
    -------
    (..., rows, cols) ndarray
        Log ratios [nat].

    """
    if sensor.blur_m == 0.0:
        return sensor.log_likelihood_ratio(frame)
    points = point_log_ratio(sensor, frame, _CELL_POINTS)
    parts = [points[..., row::_CELL_POINTS, col::_CELL_POINTS]
             for row, col in np.ndindex(_CELL_POINTS, _CELL_POINTS)]
    return np.asarray(functools.reduce(np.logaddexp, parts) - math.log(len(parts)))


def relative_likelihood(
    sensor: SensorModel, frame: np.ndarray, points: int = 1,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Likelihood ratio of each cell, or of points in it, divided by the largest of the frame.

    Parameters
    ----------
    sensor
        Noise, blur and intensity.
    frame : (..., rows, cols) ndarray
        Cell intensities; leading axes are Monte Carlo runs.
    points
        Points R along each side of a cell; 1 takes the mean over the cell.

    Returns
    -------
    (..., R rows, R cols) ndarray
        Ratios, at most 1.
    (...,) ndarray
        Log of the largest ratio [nat].

    """
    if sensor.is_linear:
        weight, peak = _linear_likelihood(sensor, frame)
        if points > 1:
            weight = weight.repeat(points, axis=-2).repeat(points, axis=-1)
        return weight, peak
    ratio = cell_log_ratio(sensor, frame) if points == 1 else point_log_ratio(
        sensor, frame, points)
    peak = ratio.max(axis=(-2, -1))
    ratio -= peak[..., None, None]
    return np.exp(ratio, out=ratio), peak


def _linear_likelihood(
    sensor: SensorModel, frame: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return what :func:`relative_likelihood` does, by the ratio below eq. (4)."""
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
