# SPDX-License-Identifier: Apache-2.0
"""Sums of the log ratios of the cells that an object reaches, compiled."""

from __future__ import annotations

from lowsnr_common.core.compiled import compiled
import numpy as np


@compiled
def spread_ratio(
    frames: np.ndarray, values: np.ndarray, first: float, step: float, signal_step: float,
    reached: np.ndarray, signals: np.ndarray, log_weights: np.ndarray,
) -> np.ndarray:
    """
    Return the log of the mean ratio over the amplitudes of an object at every cell.

    Parameters
    ----------
    frames : (B, rows, cols) ndarray of float
        Cell intensities.
    values : (S, Z) ndarray
        Log ratio of a cell, by its signal and its value less the signal [nat]; linear between.
    first, step, signal_step
        First of these values, their step, and that of the signals.
    reached : (C, 2) ndarray of int
        Row and column of the cells that an object reaches, from its own.
    signals : (C, n) ndarray
        Signal of each amplitude in each of them, in steps of the signals.
    log_weights : (n,) ndarray
        Logarithms of the weights of the amplitudes.

    """
    batch, rows, cols = frames.shape
    ratio = np.empty(frames.shape)
    sums = np.empty(len(log_weights))
    for n in range(batch):
        for row in range(rows):
            for col in range(cols):
                sums[:] = log_weights
                for c in range(len(reached)):
                    i, j = row + reached[c, 0], col + reached[c, 1]
                    if 0 <= i < rows and 0 <= j < cols:
                        _add_cell(values, (frames[n, i, j] - first) / step,
                                  signal_step / step, signals[c], sums)
                peak = sums.max()
                ratio[n, row, col] = peak + np.log(np.sum(np.exp(sums - peak)))
    return ratio


@compiled
def _add_cell(
    values: np.ndarray, place: float, shift: float, signals: np.ndarray, sums: np.ndarray,
) -> None:
    """Add the log ratio of a cell for the signal of each amplitude."""
    last = values.shape[1] - 2
    for n in range(len(signals)):
        below = int(signals[n])
        moved = min(max(place - shift * signals[n], 0.0), last + 1.0)
        left = min(int(moved), last)
        part = moved - left
        lower = values[below, left] + part * (values[below, left + 1] - values[below, left])
        upper = (values[below + 1, left]
                 + part * (values[below + 1, left + 1] - values[below + 1, left]))
        sums[n] += lower + (signals[n] - below) * (upper - lower)
