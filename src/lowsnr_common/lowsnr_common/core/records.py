"""Records that cross package borders: what is true, what is declared, what is tracked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Truth:
    """
    An object present in a frame.

    ``state`` is (4,) ``[p_x, v_x, p_y, v_y]`` in metres and m/s.
    """

    id: str  # noqa: A003
    state: np.ndarray
    snr_offset_db: float = 0.0


@dataclass(frozen=True)
class Estimate:
    """
    A declared detection or a track in one frame.

    ``state`` is (4,) ``[p_x, v_x, p_y, v_y]`` in metres and m/s, ``cov`` its (4, 4)
    covariance; the velocity and its covariance are NaN where it is not estimated.
    ``score`` is a probability.  ``id`` names what carries a whole state, and is empty
    for a bare position.
    """

    state: np.ndarray
    cov: np.ndarray
    score: float
    id: str = ''  # noqa: A003
