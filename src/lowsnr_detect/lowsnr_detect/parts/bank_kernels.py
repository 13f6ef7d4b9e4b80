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
    none = np.zeros(cols, np.float32)
    for run in range(len(frame)):
        for row in range(first, last):
            here, most, still = frame[run, row], best[run, row], sums[0, run, row]
            for n in range(len(before)):
                new, source, step = sums[n, run, row], row - moves[n, 0], moves[n, 1]
                size = cols - abs(step) if 0 <= source < rows else 0
                start, left = max(step, 0) if size > 0 else 0, max(-step, 0)
                end = start + max(size, 0)
                _extend(new[:start], here[:start], none, fading, most[:start], still[:start],
                        standing, scale[n])
                if size > 0:
                    _extend(new[start:end], here[start:end],
                            before[n, run, source, left:left + size], fading, most[start:end],
                            still[start:end], standing, scale[n])
                _extend(new[end:], here[end:], none, fading, most[end:], still[end:], standing,
                        scale[n])
                if n == 0:
                    most[:] = np.float32(-np.inf)


@compiled
def _extend(
    new: np.ndarray, here: np.ndarray, old: np.ndarray, fading: float, most: np.ndarray,
    still: np.ndarray, standing: float, scale: float,
) -> None:
    """Add a row to what is left of its sums, and raise the best to the scaled difference."""
    for col in range(len(new)):
        total = here[col] + fading * old[col]
        new[col] = total
        value = (total - standing * still[col]) * scale
        most[col] = value if value > most[col] else most[col]
