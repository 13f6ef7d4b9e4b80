"""How likely a frame is for objects anywhere, not only at the centre of a cell."""

from __future__ import annotations

from lowsnr_sensor.measurement import SensorModel
from lowsnr_sensor.motion import POS
import numpy as np


def state_log_ratio(
    sensor: SensorModel, frame: np.ndarray, states: np.ndarray,
) -> np.ndarray:
    """
    Log-likelihood ratio of "object in this state" against "noise only".

    Without blur that of the cell which holds the state, eq. (3); with blur the sum of
    ``h (2 z - h) / (2 sigma^2)``, h of eq. (2), over the cells the point spread reaches.

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
    rows, cols = frame.shape[-2:]
    cells = sensor.cells(states)
    row, col = cells[..., 0], cells[..., 1]
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    row, col = np.where(inside, row, 0), np.where(inside, col, 0)
    if sensor.blur_m == 0.0:
        plane = sensor.log_likelihood_ratio(frame)
        ratio = _at(plane, row, col)
    else:
        ratio = _blurred(sensor, frame, states, row, col)
    return np.where(inside, ratio, -np.inf)


def _at(plane: np.ndarray, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """Pick the values (..., N) of a plane at cells (..., N)."""
    flat = plane.reshape(*plane.shape[:-2], -1)
    return np.take_along_axis(flat, row * plane.shape[-1] + col, axis=-1)


def _blurred(
    sensor: SensorModel, frame: np.ndarray, states: np.ndarray, row: np.ndarray,
    col: np.ndarray,
) -> np.ndarray:
    reach, size = sensor.blur_reach, sensor.cell_size_m
    # A margin of noise-free zeros: h there is cut off with it, as the frame cuts it off.
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
