# SPDX-License-Identifier: Apache-2.0
"""What is known of the maxima of a statistic from earlier frames."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace

from lowsnr_detect.parts.moves import shifted
import numpy as np
import scipy


@dataclass(frozen=True)
class TailMemory:
    """
    What was seen in earlier frames, of P planes.

    Parameters
    ----------
    maxima : (P, R, C, bins) ndarray
        Faded numbers of maxima in each region, by their value.
    rarities : (P, bins) ndarray
        Faded numbers of excesses, by their rarity when they were seen.
    number : (P,) ndarray
        Faded number of maxima from which those excesses are.
    alarms : (P,) ndarray
        Faded numbers of frames with a crossing that is not near an earlier one.
    answered : (P,) ndarray
        Faded numbers of frames that were answered.
    weight
        Faded number of frames with maxima.
    frames
        Number of frames with maxima.
    crossed : (P, rows, cols) ndarray of bool
        Whether a cell is near a crossing of the frame before.
    held : (5, n) ndarray
        Plane, row, column, value and excess of the crossings that may be of objects.

    """

    maxima: np.ndarray
    rarities: np.ndarray
    number: np.ndarray
    alarms: np.ndarray
    answered: np.ndarray
    weight: float
    frames: int
    crossed: np.ndarray
    held: np.ndarray

    def moved(self, by: tuple[int, int], cell_size_m: float) -> TailMemory:
        """Return the memory for cells whose first one moved ``by`` rows and columns."""
        shape, grid = self.crossed.shape[1:], self.maxima.shape[1:3]
        step = (0.0, *(-n * count / size for n, count, size in zip(by, grid, shape)), 0.0)
        maxima = scipy.ndimage.shift(self.maxima, step, order=1, mode='nearest')
        held = self.held - np.array([0, *by, 0, 0])[:, None]
        inside = np.all((held[1:3] >= 0) & (held[1:3] < np.array(shape)[:, None]), axis=0)
        return replace(
            self, maxima=maxima, held=held[:, inside],
            crossed=shifted(self.crossed, np.negative(by), False))
