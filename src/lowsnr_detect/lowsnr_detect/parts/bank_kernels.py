"""
Compiled loops of the velocity bank over the cells of planes.

The definition in NumPy is :func:`lowsnr_detect.detectors.velocity_bank.shift_and_add`; tests hold
the loops equal to it.
"""

from __future__ import annotations

from lowsnr_common.core.compiled import compiled
import numpy as np


@compiled
def extend_bank(
    before: np.ndarray, frame: np.ndarray, moves: np.ndarray, scale: np.ndarray, fading: float,
    standing: float, first: int, last: int, sums: np.ndarray, best: np.ndarray,
) -> None:
    """
    Extend the sums of all velocities, and write the best of them in every cell.

    Parameters
    ----------
    before : (V, B, rows, cols) ndarray of float32
        Sums before the frame; the first velocity stands.
    frame : (B, rows, cols) ndarray of float32
        Cell intensities in units of the noise, limited.
    moves : (V, 2) ndarray of int
        Rows and columns that each velocity moves by in this frame.
    scale : (V,) ndarray of float32
        Factor that makes the noise of ``sum - standing * standing sum`` one.
    fading, standing : float32
        As for :class:`VelocityBank`.
    first, last
        Rows to write.
    sums : (V, B, rows, cols) ndarray of float32
        Gets the sums after the frame.
    best : (B, rows, cols) ndarray of float32
        Gets the largest scaled difference over the moving velocities.

    """
    rows, cols = frame.shape[1:]
    for run in range(len(frame)):
        for row in range(first, last):
            here, most = frame[run, row], best[run, row]
            most[:] = np.float32(-np.inf)
            for n in range(len(before)):
                new, source, step = sums[n, run, row], row - moves[n, 0], moves[n, 1]
                new[:] = here
                if 0 <= source < rows and abs(step) < cols:
                    left, size = max(-step, 0), cols - abs(step)
                    _fade_in(new[max(step, 0):max(step, 0) + size],
                             before[n, run, source, left:left + size], fading)
                if n > 0:
                    _raise(most, new, sums[0, run, row], standing, scale[n])


@compiled
def _fade_in(new: np.ndarray, old: np.ndarray, fading: float) -> None:
    """Add what is left of the sums of the frame before."""
    for col in range(len(new)):
        new[col] += fading * old[col]


@compiled
def _raise(
    most: np.ndarray, moving: np.ndarray, still: np.ndarray, standing: float, scale: float,
) -> None:
    """Raise the best of a row to one velocity's difference to what stands in place."""
    for col in range(len(most)):
        value = (moving[col] - standing * still[col]) * scale
        most[col] = value if value > most[col] else most[col]
