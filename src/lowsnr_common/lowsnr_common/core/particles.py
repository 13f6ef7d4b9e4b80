# SPDX-License-Identifier: Apache-2.0
"""Particle arithmetic on log weights: normalise, resample, moments."""

from __future__ import annotations

import math

from lowsnr_common.core.particle_kernels import systematic_indices
import numpy as np


def log_sum_exp(values: np.ndarray, axis: int = -1) -> np.ndarray:
    """
    Return ``log(sum(exp(values)))`` along an axis; -inf where all values are -inf.

    Parameters
    ----------
    values : (..., N) ndarray
        Logarithms; -inf means impossible.
    axis
        Axis of the sum.

    """
    peak = np.max(values, axis=axis, keepdims=True)
    peak = np.where(np.isfinite(peak), peak, 0.0)
    with np.errstate(divide='ignore'):
        total = np.log(np.sum(np.exp(values - peak), axis=axis))
    shifted: np.ndarray = total + np.squeeze(peak, axis=axis)
    return shifted


def normalise(log_weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Scale weights to sum to one.

    Parameters
    ----------
    log_weights : (..., N) ndarray
        Unnormalised log weights.

    Returns
    -------
    (..., N) ndarray
        Normalised log weights; uniform where every weight is zero.
    (...,) ndarray
        Log of the sum of the weights.

    """
    total = log_sum_exp(log_weights)
    dead = ~np.isfinite(total)
    safe = np.where(dead, 0.0, total)[..., None]
    uniform = -np.log(log_weights.shape[-1])
    return np.where(dead[..., None], uniform, log_weights - safe), total


def systematic_resample(
    log_weights: np.ndarray, count: int, rng: np.random.Generator,
) -> np.ndarray:
    """
    Draw indices in proportion to the weights, with one uniform number for all.

    Every particle is drawn ``floor(n w)`` or ``ceil(n w)`` times (Kitagawa 1996).

    Parameters
    ----------
    log_weights : (..., N) ndarray
        Log weights, normalised or not; those that are all -inf count as equal.
    count
        Number of indices n to draw.
    rng
        Source of randomness.

    Returns
    -------
    (..., count) ndarray of int
        Indices in ascending order.

    """
    batch, size = log_weights.shape[:-1], log_weights.shape[-1]
    peak = np.max(log_weights, axis=-1, keepdims=True)
    weights = np.exp(log_weights - np.where(np.isfinite(peak), peak, 0.0))
    draw = rng.random((*batch, 1))
    chosen: np.ndarray = systematic_indices(
        np.ascontiguousarray(weights).reshape(-1, size), draw.ravel(), count)
    return chosen.reshape(*batch, count)


def pick(values: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """
    Return the values of the chosen particles.

    Parameters
    ----------
    values : (..., N) or (..., N, D) ndarray
        Modes, weights or states.
    chosen : (..., n) ndarray of int
        Indices along the axis of the particles.

    Returns
    -------
    (..., n) or (..., n, D) ndarray
        Values in the order of ``chosen``.

    """
    batch, size = chosen.shape[:-1], values.shape[chosen.ndim - 1]
    rest = values.shape[chosen.ndim:]
    if batch:
        first = size * np.arange(math.prod(batch)).reshape(*batch, 1)
        chosen = chosen + first
    return values.reshape(-1, *rest).take(chosen, axis=0)


def weighted_moments(
    states: np.ndarray, log_weights: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return mean and covariance of weighted particles.

    Parameters
    ----------
    states : (..., N, 4) ndarray
        Particle states.
    log_weights : (..., N) ndarray
        Normalised log weights.

    Returns
    -------
    (..., 4) ndarray
        Mean.
    (..., 4, 4) ndarray
        Covariance.

    """
    weights = np.exp(log_weights)
    mean = (weights[..., None, :] @ states)[..., 0, :]
    offset = states - mean[..., None, :]
    return mean, np.swapaxes(offset, -1, -2) @ (weights[..., None] * offset)
