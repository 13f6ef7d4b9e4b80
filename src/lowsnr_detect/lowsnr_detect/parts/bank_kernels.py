# SPDX-License-Identifier: Apache-2.0
"""
Compiled loops of the velocity bank over the cells of planes.

The definition in NumPy is :func:`lowsnr_detect.detectors.velocity_bank.shift_and_add`; tests hold
the loops equal to it.

A bank of 49 velocities is bound by memory.  Its sums are therefore whole numbers of a small
step, in 16 bits, and those of a row lie beside each other, (rows, V, cols): the loop reads and
writes memory from its start to its end.
"""

from __future__ import annotations

from lowsnr_common.core.compiled import compiled
import numpy as np

# Largest number that a sum is stored as; it is shifted by so much to be rounded, not cut.
LARGEST = 32_767
_LARGEST, _HALF_UP, _ZERO = np.float32(LARGEST), np.float32(LARGEST + 0.5), np.float32(0.0)
_NONE, _ONE, _HALF = np.float32(-np.inf), np.float32(1.0), np.float32(0.5)


@compiled
def extend_bank(
    before: np.ndarray, frame: np.ndarray, moves: np.ndarray, scale: np.ndarray, step: float,
    fading: float, standing: float, first: int, last: int, sums: np.ndarray, best: np.ndarray,
) -> None:
    """
    Extend the sums of all velocities, and write half the square of the best in every cell.

    Parameters
    ----------
    before : (B, rows, V, cols) ndarray of int16
        Sums before the frame, in steps; the first velocity stands.
    frame : (B, rows, cols) ndarray of float32
        Cell intensities in units of the noise, limited.
    moves : (V, 2) ndarray of int
        Rows and columns that each velocity moves by in this frame.
    scale : (V,) ndarray of float32
        Factor that makes the noise of ``sum - standing * standing sum`` one.
    step, fading, standing : float32
        The step, and as for :class:`VelocityBank`.
    first, last
        Rows to write.
    sums : (B, rows, V, cols) ndarray of int16
        Gets the sums after the frame.
    best : (B, rows, cols) ndarray of float32
        Gets u^2 / 2 of the largest scaled difference u over the moving velocities, 0 for u < 0.

    """
    rows, cols = frame.shape[1:]
    margin = np.abs(moves[:, 1]).max()
    none, still = np.zeros(cols, np.int16), np.empty(cols, np.float32)
    # What enters from beyond the frame is zero.
    wide = np.zeros(cols + 2 * margin, np.float32)
    inside = wide[margin:margin + cols]
    old, new = step * fading, _ONE / step
    for run in range(len(frame)):
        for row in range(first, last):
            here, most = frame[run, row], best[run, row]
            still[:] = _ZERO
            most[:] = _NONE
            _fade(before[run, row, 0], old, inside)
            _extend(here, inside, new, still, _ONE, sums[run, row, 0], most)
            for col in range(cols):
                still[col] = standing * most[col]
            most[:] = _NONE
            for n in range(1, len(scale)):
                source, start = row - moves[n, 0], margin - moves[n, 1]
                _fade(before[run, source, n] if 0 <= source < rows else none, old, inside)
                _extend(here, wide[start:start + cols], new, still, scale[n], sums[run, row, n],
                        most)
            for col in range(cols):
                value = most[col] if most[col] > _ZERO else _ZERO
                most[col] = value * value * _HALF


@compiled
def _fade(before: np.ndarray, old: float, faded: np.ndarray) -> None:
    """Write what is left of the sums of a row."""
    for col in range(len(faded)):
        faded[col] = old * np.float32(before[col])


@compiled
def _extend(
    here: np.ndarray, faded: np.ndarray, new: float, still: np.ndarray, scale: float,
    sums: np.ndarray, most: np.ndarray,
) -> None:
    """Add a row to what is left of its sums, and raise the best to the scaled difference."""
    for col in range(len(here)):
        total = here[col] + faded[col]
        steps = total * new
        steps = steps if steps < _LARGEST else _LARGEST
        steps = steps if steps > -_LARGEST else -_LARGEST
        sums[col] = np.int16(np.int32(steps + _HALF_UP) - np.int32(LARGEST))
        value = (total - still[col]) * scale
        most[col] = value if value > most[col] else most[col]
