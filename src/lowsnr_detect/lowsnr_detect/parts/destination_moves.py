# SPDX-License-Identifier: Apache-2.0
"""
Moves on the grid of objects that are bound for a destination.

A cell, with the velocity that the last moves of
:class:`lowsnr_detect.parts.moves.MoveModel` imply, leads to a position at the arrival with a
variance.  The likelihood of the destination at that position multiplies the probability of
the last move (:meth:`lowsnr_common.core.destination.Destination.arrival_likelihood`).
"""

from __future__ import annotations

import math

from lowsnr_common.core.destination import Destination
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_detect.parts.moves import move_model
from lowsnr_detect.parts.moves import shifted
import numpy as np


def cell_likelihoods(
    destination: Destination, motion: MotionModes, sensor: SensorModel, order: int, frame: int,
    shape: tuple[int, int],
) -> np.ndarray:
    """
    Return the arrival likelihood of every cell and history in a frame up to the arrival.

    Returns
    -------
    (dropped, kept, rows, cols) ndarray
        Factor of the probability that an object appears there with that history.

    """
    model = move_model(motion, sensor, order)
    return _arrival_likelihood(
        destination, model.velocity, model.velocity_cov, sensor, frame, shape)


def move_likelihoods(
    destination: Destination, motion: MotionModes, sensor: SensorModel, order: int, frame: int,
    shape: tuple[int, int],
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the arrival likelihood of every move into a frame up to the arrival.

    The probability of move m from cell c, given a history, is
    ``kernel[kept, m, dropped] * likelihood[kept, m, c] / mean[dropped, kept, c]``.

    Parameters
    ----------
    destination
        Where objects are bound for.
    motion, sensor, order
        Arguments of :func:`lowsnr_detect.parts.moves.move_model`, which gives the
        probabilities of the moves without a destination.
    frame
        Frame that the moves lead to, up to the arrival.
    shape
        Rows and columns.

    Returns
    -------
    likelihood : (kept, n, rows, cols) ndarray
        Factor of each move by the cell that it starts in; for a move out of the frame that of
        an object that is not bound for the destination.
    mean : (dropped, kept, rows, cols) ndarray
        Its mean over the moves.

    """
    model = move_model(motion, sensor, order)
    # One move is evidence of the velocity, also where the model remembers none.
    after = model if order == 2 else move_model(motion, sensor, 1)
    kept, count = model.history.shape[1], len(model.moves)
    reached = _arrival_likelihood(
        destination, after.velocity.reshape(kept, count, 2),
        after.velocity_cov.reshape(kept, count, 2, 2), sensor, frame, shape)
    likelihood = np.stack([
        shifted(reached[:, number], -move, 1.0 - destination.probability)
        for number, move in enumerate(model.moves)], axis=1)
    return likelihood, np.einsum('knd,kn...->dk...', model.kernel, likelihood)


def log_destination_terms(
    destination: Destination, motion: MotionModes, sensor: SensorModel, frame: int,
    shape: tuple[int, ...],
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return what a destination adds to the sum of a path in a frame up to the arrival.

    Parameters
    ----------
    destination, motion, sensor, frame
        As for :func:`move_likelihoods`, for moves of order 0.
    shape
        Shape of the frame, (..., rows, cols).

    Returns
    -------
    start : (rows, cols) ndarray of float32
        Log factor of a path that starts in a cell [nat].
    moves : (n, rows, cols) ndarray
        Log factor of each move by the cell that it starts in [nat].

    """
    rows, cols = shape[-2:]
    likelihood, mean = move_likelihoods(destination, motion, sensor, 0, frame, (rows, cols))
    start = np.log(cell_likelihoods(destination, motion, sensor, 0, frame, (rows, cols))[0, 0])
    return start.astype(np.float32), np.log(likelihood[0] / mean[0, 0])


def _arrival_likelihood(
    destination: Destination, velocity: np.ndarray, velocity_cov: np.ndarray,
    sensor: SensorModel, frame: int, shape: tuple[int, int],
) -> np.ndarray:
    """Return factors (..., rows, cols) for velocities (..., 2) with covariance (..., 2, 2)."""
    left_s, variance = destination.look_ahead(frame, sensor.frame_period_s)
    size = sensor.cell_size_m
    position = size * np.moveaxis(np.indices(shape)[::-1], 0, -1)
    spread = (variance + size**2 / 12.0
              + left_s**2 * np.diagonal(velocity_cov, axis1=-2, axis2=-1))
    return destination.arrival_likelihood(
        position + left_s * velocity[..., None, None, :], spread[..., None, None, :],
        size**2 * math.prod(shape))
