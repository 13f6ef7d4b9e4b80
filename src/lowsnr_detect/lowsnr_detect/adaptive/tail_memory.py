"""What is known of the tail of a statistic from earlier frames."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace

from lowsnr_detect.parts.moves import shifted
import numpy as np
import scipy.ndimage


@dataclass(frozen=True)
class TailMemory:
    """
    What was seen in earlier frames, of P planes.

    Parameters
    ----------
    maxima : (P, R, C, bins) ndarray
        Faded numbers of maxima in each region, by their value.
    alarms : (P,) ndarray
        Faded numbers of frames with a crossing that is not near an earlier one.
    weight, answered
        Faded numbers of frames with maxima, and of those that were answered.
    frames
        Number of frames with maxima.
    crossed : (P, rows, cols) ndarray of bool
        Whether a cell is near a crossing of the frame before.
    held : tuple of (3, n) ndarray
        Row, column and value of the crossings that may be of objects, one a plane.

    """

    maxima: np.ndarray
    alarms: np.ndarray
    weight: float
    answered: float
    frames: int
    crossed: np.ndarray
    held: tuple[np.ndarray, ...] = ()

    def moved(self, by: tuple[int, int], cell_size_m: float) -> TailMemory:
        """Return the memory for cells whose first one moved ``by`` rows and columns."""
        shape, grid = self.crossed.shape[1:], self.maxima.shape[1:3]
        step = (0.0, *(-n * count / size for n, count, size in zip(by, grid, shape)), 0.0)
        maxima = scipy.ndimage.shift(self.maxima, step, order=1, mode='nearest')
        held = []
        for each in self.held:
            row, col = places = each[:2] - np.array(by)[:, None]
            inside = (row >= 0) & (row < shape[0]) & (col >= 0) & (col < shape[1])
            held.append(np.concatenate([places, each[2:]])[:, inside])
        return replace(
            self, maxima=maxima, held=tuple(held),
            crossed=shifted(self.crossed, np.negative(by), False))


@dataclass(frozen=True)
class Thresholds:
    """
    Thresholds of P planes in one frame, by region, each (P, R, C) of float32 [nat].

    ``threshold``, the ``scale`` in which the log odds rise by 1, and ``level`` and scale of the
    ``tail``.
    """

    threshold: np.ndarray
    scale: np.ndarray
    level: np.ndarray
    tail: np.ndarray
