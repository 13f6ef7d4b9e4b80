"""What is known of the tail of a statistic: in white noise, and in earlier frames."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace

from lowsnr_detect.parts.moves import shifted
import numpy as np
import scipy.ndimage


@dataclass(frozen=True)
class WhiteTail:
    """
    The local maxima of a statistic in white noise.

    ``level`` and ``scale`` of their tail [nat], maxima ``per_cell``, the ``share`` of them whose
    excess is beyond ``START``, and how those are distributed, ``excesses``, one a bin of
    ``EDGES``.
    """

    level: float
    scale: float
    per_cell: float
    share: float
    excesses: tuple[float, ...]


@dataclass(frozen=True)
class TailMemory:
    """
    What was seen in earlier frames, of P planes.

    Parameters
    ----------
    maxima : (P, R, C, bins) ndarray
        Faded numbers of maxima in each region, by their value.
    excesses : (P, R, C, bins) ndarray
        Faded numbers of excesses in each region, by their value.
    alarms : (P,) ndarray
        Faded numbers of frames with a crossing that is not near an earlier one.
    weight, answered
        Faded numbers of frames with maxima, and of those that were answered.
    frames
        Number of frames with maxima.
    crossed : (P, rows, cols) ndarray of bool
        Whether a cell is near a crossing of the frame before.
    held : tuple of (4, n) ndarray
        Row, column, value and excess of the crossings that may be of objects, one a plane.

    """

    maxima: np.ndarray
    excesses: np.ndarray
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
        maxima, excesses = (
            scipy.ndimage.shift(counts, step, order=1, mode='nearest')
            for counts in (self.maxima, self.excesses))
        held = []
        for each in self.held:
            row, col = places = each[:2] - np.array(by)[:, None]
            inside = (row >= 0) & (row < shape[0]) & (col >= 0) & (col < shape[1])
            held.append(np.concatenate([places, each[2:]])[:, inside])
        return replace(
            self, maxima=maxima, excesses=excesses, held=tuple(held),
            crossed=shifted(self.crossed, np.negative(by), False))


@dataclass(frozen=True)
class Thresholds:
    """
    Thresholds of P planes in one frame.

    ``threshold`` and ``scale`` [nat] are (P, rows, cols); ``excess``, the limit of the normalised
    excess, and ``slope``, that of the log odds there, are (P, R, C), by region.
    """

    threshold: np.ndarray
    scale: np.ndarray
    excess: np.ndarray
    slope: np.ndarray
