"""What is known of the tail of a statistic: in white noise, and in earlier frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


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
