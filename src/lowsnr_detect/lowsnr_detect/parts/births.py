# SPDX-License-Identifier: Apache-2.0
"""Births of the particle filters: where an object appears, and with which velocity and mode."""

from __future__ import annotations

from dataclasses import dataclass

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_common.settings.declare import setting
import numpy as np

# Fraction of the births that is proposed uniformly.  It bounds the weight of a birth in a dim
# cell: the ratio of the uniform birth density to the proposal is at most 1 / 0.1.
_UNIFORM = 0.1


@dataclass(frozen=True, kw_only=True)
class ConstantVelocity(MotionModes):
    """Motion with constant velocity as its only mode by default."""

    turn_rates_deg_s: tuple[float, ...] = setting(
        (0.0,), 'turn rate of each mode, 0 for constant velocity [deg/s]', ge=-36_000.0,
        le=36_000.0)


def log_birth_proposal(ratio: np.ndarray) -> np.ndarray:
    """
    Return the log probability with which a birth is proposed in each cell.

    Nine of ten births are proposed in proportion to the likelihood ratio of the cells, so that
    most are where the frame is bright, and one of ten uniformly.

    Parameters
    ----------
    ratio : (..., rows, cols) ndarray
        Log-likelihood ratio per cell [nat].

    Returns
    -------
    (..., cells) ndarray
        Log probabilities; they sum to one.

    """
    flat = ratio.reshape(*ratio.shape[:-2], -1)
    bright = np.exp(flat - flat.max(axis=-1, keepdims=True))
    bright /= bright.sum(axis=-1, keepdims=True)
    return np.asarray(np.log((1.0 - _UNIFORM) * bright + _UNIFORM / flat.shape[-1]))


def draw_births(
    cells: np.ndarray, cols: int, sensor: SensorModel, motion: MotionModes,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Draw objects that appear in given cells.

    Parameters
    ----------
    cells : (...) ndarray of int
        Cell numbers, row by row.
    cols
        Columns of the frame.
    sensor
        Cell size.
    motion
        Distribution of the velocity, and the modes.
    rng
        Source of randomness.

    Returns
    -------
    states : (..., 4) ndarray
        States, uniform within the cell [m, m/s].
    modes : (...) ndarray of int
        Modes, uniform.

    """
    states = np.empty((*cells.shape, 4))
    place = rng.uniform(-0.5, 0.5, (*cells.shape, 2))
    for axis, cell in zip(POS, np.divmod(cells, cols)[::-1]):
        states[..., axis] = sensor.cell_size_m * (cell + place[..., axis // 2])
    states[..., VEL] = motion.draw_velocity(cells.shape, rng)
    return states, rng.integers(motion.count, size=cells.shape)
