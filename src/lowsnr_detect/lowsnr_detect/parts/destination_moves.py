"""
Moves on the grid of objects that are bound for a destination.

An object in a cell whose velocity is known from its last moves as far as
:class:`lowsnr_detect.parts.moves.MoveModel` tells leads to a place at the arrival, with a
variance; how well that place fits favours or disfavours the move that was made last
(:meth:`lowsnr_common.core.destination.Destination.favour`).
"""

from __future__ import annotations

import math

from lowsnr_common.core.destination import Destination
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_detect.parts.moves import move_model
from lowsnr_detect.parts.moves import shifted
import numpy as np


def favoured_cells(
    destination: Destination, motion: MotionModes, sensor: SensorModel, order: int, frame: int,
    shape: tuple[int, int],
) -> np.ndarray:
    """
    Return how much every cell and history is favoured in a frame up to the arrival.

    Returns
    -------
    (dropped, kept, rows, cols) ndarray
        Factor of the probability that an object appears so.

    """
    model = move_model(motion, sensor, order)
    return _favour(destination, model.velocity, model.velocity_cov, sensor, frame, shape)


def favoured_moves(
    destination: Destination, motion: MotionModes, sensor: SensorModel, order: int, frame: int,
    shape: tuple[int, int],
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return how much every move into a frame up to the arrival is favoured.

    The probability of move m from cell c, given a history, is
    ``kernel[kept, m, dropped] * favour[kept, m, c] / total[dropped, kept, c]``.

    Parameters
    ----------
    destination
        Where objects are bound for.
    motion, sensor, order
        What the moves follow from without it.
    frame
        Frame that the moves lead to, up to the arrival.
    shape
        Rows and columns.

    Returns
    -------
    favour : (kept, n, rows, cols) ndarray
        Factor of each move by the cell that it starts in; one out of the frame is not favoured.
    total : (dropped, kept, rows, cols) ndarray
        Mean of it over the moves.

    """
    model = move_model(motion, sensor, order)
    # A single move says something of the velocity, also where none is remembered.
    after = model if order == 2 else move_model(motion, sensor, 1)
    kept, count = model.history.shape[1], len(model.moves)
    reached = _favour(
        destination, after.velocity.reshape(kept, count, 2),
        after.velocity_cov.reshape(kept, count, 2, 2), sensor, frame, shape)
    favour = np.stack([
        shifted(reached[:, number], -move, 1.0 - destination.probability)
        for number, move in enumerate(model.moves)], axis=1)
    return favour, np.einsum('knd,kn...->dk...', model.kernel, favour)


def _favour(
    destination: Destination, velocity: np.ndarray, velocity_cov: np.ndarray,
    sensor: SensorModel, frame: int, shape: tuple[int, int],
) -> np.ndarray:
    """Return the factors (..., rows, cols) for velocities (..., 2) with covariance (..., 2, 2)."""
    left_s, variance = destination.look_ahead(frame, sensor.frame_period_s)
    size = sensor.cell_size_m
    position = size * np.moveaxis(np.indices(shape)[::-1], 0, -1)
    spread = (variance + size**2 / 12.0
              + left_s**2 * np.diagonal(velocity_cov, axis1=-2, axis2=-1))
    return destination.favour(
        position + left_s * velocity[..., None, None, :], spread[..., None, None, :],
        size**2 * math.prod(shape))
