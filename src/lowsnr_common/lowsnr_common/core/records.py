# SPDX-License-Identifier: Apache-2.0
"""Records that cross package borders: truth, estimates, and the error of a malformed message."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Truth:
    """
    An object present in a frame.

    ``state`` is (4,) ``[p_x, v_x, p_y, v_y]`` in metres and m/s; ``snr_offset_db`` its SNR less
    that of the sensor model [dB].
    """

    id: str  # noqa: A003
    state: np.ndarray
    snr_offset_db: float = 0.0


@dataclass(frozen=True)
class Prediction:
    """
    What a detector with a posterior expected, before the frame, of what it declares in it.

    The posterior over the prediction is what the frame alone says.

    Parameters
    ----------
    score : (...,) ndarray or float
        Probability that there is an object.
    position : (..., 2) ndarray
        Its position x, y [m].
    cov : (..., 2, 2) ndarray
        Covariance of the position.

    """

    score: Any
    position: np.ndarray
    cov: np.ndarray

    def __getitem__(self, index: Any) -> Prediction:
        """Return the predictions that an index picks along the leading axes."""
        return Prediction(self.score[index], self.position[index], self.cov[index])


@dataclass(frozen=True)
class Estimate:
    """
    A declared detection or a track in one frame.

    ``state`` is (4,) ``[p_x, v_x, p_y, v_y]`` in metres and m/s, ``cov`` its (4, 4)
    covariance; the velocity and its covariance are NaN where they are not estimated.
    ``score`` is a probability.  ``id`` names an estimate of a whole state, and is empty for a
    position alone.  ``predicted`` is None where the detector has no posterior.
    """

    state: np.ndarray
    cov: np.ndarray
    score: float
    id: str = ''  # noqa: A003
    predicted: Prediction | None = None


@dataclass(frozen=True)
class AlarmRate:
    """
    The share of frames with a false alarm of a detector; None where there is no such figure.

    ``asked`` is the share that its threshold is for.  ``measured`` is what an adaptive detector
    measures while it runs: the share of its recent frames with a declaration that is near none
    of the frame before, so that the later declarations of an object do not count.
    """

    asked: float | None = None
    measured: float | None = None


class Malformed(ValueError):
    """
    A message that cannot be used.

    Parameters
    ----------
    reason
        Why, in words that are the same for all such messages, for counting.
    sentence
        Why, with the values of this message.

    """

    def __init__(self, reason: str, sentence: str) -> None:
        super().__init__(sentence)
        self.reason = reason

    def __reduce__(self) -> tuple[type[Malformed], tuple[str, str]]:
        """Return what makes the error again in another process."""
        return type(self), (self.reason, str(self))
