# SPDX-License-Identifier: Apache-2.0
"""The definitions of the compiled loops over particles, in plain NumPy."""

from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import process_noise_sqrt
from lowsnr_common.core.particles import normalise
import numpy as np


def switch(motion, modes, dt, rng):
    """Draw the modes (..., N) after a step."""
    cumulative = np.cumsum(motion.mode_transition(dt), axis=1)[:, :-1]
    return np.sum(rng.random(modes.shape)[..., None] >= cumulative[modes], axis=-1)


def move(motion, states, modes, dt, rng):
    """Draw the states (..., N, 4) after a step."""
    matrices = motion.transition_matrices(dt)
    factor = process_noise_sqrt(dt, motion.acceleration_density)
    moved = np.einsum('...ij,...j->...i', matrices[modes], states)
    return moved + rng.standard_normal(states.shape) @ factor.T


def state_log_ratio(sensor, frame, states):
    """Return the log-likelihood ratio (..., N) of states (..., N, 4)."""
    rows, cols = frame.shape[-2:]
    cells = sensor.cells(states)
    row, col = cells[..., 0], cells[..., 1]
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    row, col = np.where(inside, row, 0), np.where(inside, col, 0)
    if sensor.blur_m == 0.0:
        ratio = _at(sensor.log_likelihood_ratio(frame), row, col)
    else:
        ratio = _blurred(sensor, frame, states, row, col)
    return np.where(inside, ratio, -np.inf)


def systematic_resample(log_weights, count, rng):
    """Draw indices (..., count) in proportion to the weights (..., N)."""
    weights = np.exp(normalise(log_weights)[0])
    edges = np.cumsum(weights, axis=-1)
    edges /= edges[..., -1:]
    batch = edges.shape[:-1]
    points = (np.arange(count) + rng.random((*batch, 1))) / count
    flat = [np.searchsorted(e, p, side='right') for e, p in
            zip(edges.reshape(-1, edges.shape[-1]), points.reshape(-1, count))]
    last = edges.shape[-1] - 1 - np.argmax(weights[..., ::-1] > 0.0, axis=-1)
    return np.minimum(np.reshape(flat, (*batch, count)), last[..., None])


def _at(plane, row, col):
    flat = plane.reshape(*plane.shape[:-2], -1)
    return np.take_along_axis(flat, row * plane.shape[-1] + col, axis=-1)


def _blurred(sensor, frame, states, row, col):
    reach, size = sensor.blur_reach, sensor.cell_size_m
    edge = [(0, 0)] * (frame.ndim - 2) + [(reach, reach)] * 2
    padded, seen = np.pad(frame, edge), np.pad(np.ones(frame.shape[-2:]), reach)
    spread = [
        np.exp(-((cell[..., None] + np.arange(-reach, reach + 1)) * size
                 - states[..., axis, None])**2 / (2.0 * sensor.blur_m**2))
        for cell, axis in ((row, POS[1]), (col, POS[0]))]
    ratio = np.zeros(row.shape)
    peak = sensor.intensity * size**2 / (2.0 * np.pi * sensor.blur_m**2)
    for down in range(2 * reach + 1):
        for across in range(2 * reach + 1):
            signal = peak * spread[0][..., down] * spread[1][..., across]
            cell = _at(padded, row + down, col + across)
            ratio += signal * (2.0 * cell - signal * seen[row + down, col + across])
    return ratio / (2.0 * sensor.noise_std**2)
