# SPDX-License-Identifier: Apache-2.0
"""Cells in units of their noise, which is estimated from frame to frame."""

from __future__ import annotations

from dataclasses import replace

from lowsnr_sensor.conditioning import compiled_steps as steps
from lowsnr_sensor.conditioning.state import ConditionerState
import numpy as np

# The least variance of a cell: where the noise of pixels is at its floor, the cells keep to it.
_LEAST_CELL_VARIANCE = 0.64


def whitened(
    state: ConditionerState, flat: np.ndarray, persistence: float, most: int, regions: int = 1,
) -> tuple[ConditionerState, np.ndarray]:
    """
    Divide cells by their noise, and estimate it anew.

    Parameters
    ----------
    state
        The state before them.
    flat : (rows, cols) ndarray
        Cells; those that are exactly zero are not observed.
    persistence
        Weight from frame to frame in the sum that the noise is estimated from.
    most
        Frames over which it is estimated.
    regions
        Threads that share the rows.

    """
    unit = persistence**2 * state.trace_variance + 1.0
    cells, trace, total, count = steps.cell_noise(
        flat, state.trace, persistence, unit, state.cell_variance, regions)
    if not count.any():
        return state, cells
    frames = state.cell_frames + 1
    share = np.float32(1.0 / min(frames, most))
    now = steps.surroundings(total, count, state.cell_variance)
    variance = np.maximum(
        state.cell_variance + share * (now - state.cell_variance),
        np.float32(_LEAST_CELL_VARIANCE))
    return replace(
        state, trace=trace, trace_variance=unit, cell_variance=variance, cell_frames=frames,
    ), cells
