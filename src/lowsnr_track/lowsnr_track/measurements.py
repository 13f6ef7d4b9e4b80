# SPDX-License-Identifier: Apache-2.0
"""From the detections of a frame to measurements: reject and count what cannot be used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lowsnr_common.core.motion import POS
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Prediction
import numpy as np

NOT_FINITE = 'position or score is not finite'
NO_SCORE = 'score is not in [0, 1]'
OUTSIDE = 'outside the frame'
DUPLICATE = 'same position as another'
# The largest position and standard deviation [m]; its fourth power is still a number.
FARTHEST_M = 1e9
# The least variance of a prediction along any axis, as a fraction of the largest.
_LEAST_VARIANCE = 1e-6


@dataclass(frozen=True)
class Measurements:
    """
    The usable detections of a frame.

    Parameters
    ----------
    position : (m, 2) ndarray
        x and y [m].
    cov : (m, 2, 2) ndarray
        Covariance of the position [m^2], positive definite.
    score : (m,) ndarray
        Probability that the detection is an object, as the detector states it.
    predicted : Prediction or None
        What the detector expected before the frame, if it says so of all detections.

    """

    position: np.ndarray
    cov: np.ndarray
    score: np.ndarray
    predicted: Prediction | None = None

    def __len__(self) -> int:
        """Return the number of detections m."""
        return len(self.score)

    def __getitem__(self, index: np.ndarray) -> Measurements:
        """Return the detections that an index or mask picks."""
        return Measurements(
            self.position[index], self.cov[index], self.score[index],
            None if self.predicted is None else self.predicted[index])


def screen(
    detections: Sequence[Estimate], extent: np.ndarray, cell_size_m: float,
) -> tuple[Measurements, dict[str, int]]:
    """
    Turn detections into measurements, and count those that cannot be used.

    Parameters
    ----------
    detections
        Declarations of one frame; their velocities are not used.  The predictions are used if
        those of all can be: finite, with a probability and a positive definite covariance.
    extent : (2,) ndarray
        Columns and rows of the frame in metres; FARTHEST_M where unknown.
    cell_size_m
        Side of a cell; a detection without a covariance is the centre of a cell [m].

    Returns
    -------
    Measurements
        Usable detections in the order of the input; of several in one position, the one with
        the best score.
    dict of str to int
        Number of rejected detections by reason.

    """
    count = len(detections)
    if count == 0:
        return Measurements(np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0)), {}
    position = np.array([item.state for item in detections]).reshape(count, 4)[:, POS]
    cov = np.array([item.cov for item in detections]).reshape(count, 4, 4)
    score = np.array([item.score for item in detections], dtype=float)
    finite = np.isfinite(position).all(axis=1) & np.isfinite(score)
    corner = position + cell_size_m / 2
    faults = {
        NOT_FINITE: ~finite,
        NO_SCORE: (score < 0.0) | (score > 1.0),
        OUTSIDE: ((corner < 0.0) | (corner >= extent)).any(axis=1),
    }
    usable, rejected = np.ones(count, dtype=bool), {}
    for reason, fault in faults.items():
        rejected[reason] = int(np.sum(fault & usable))
        usable &= ~fault
    kept = _best_of_each_position(position, score, np.flatnonzero(usable))
    rejected[DUPLICATE] = int(usable.sum()) - len(kept)
    cov = _position_cov(cov[kept], cell_size_m)
    counted = {reason: number for reason, number in rejected.items() if number}
    predicted = _predictions([detections[n] for n in kept], cell_size_m)
    return Measurements(position[kept], cov, score[kept], predicted), counted


def _best_of_each_position(
    position: np.ndarray, score: np.ndarray, usable: np.ndarray,
) -> np.ndarray:
    if len(usable) < 2:
        return usable
    best_first = usable[np.argsort(-score[usable], kind='stable')]
    _, first = np.unique(position[best_first], axis=0, return_index=True)
    return np.sort(best_first[first])


def _predictions(detections: Sequence[Estimate], cell_size_m: float) -> Prediction | None:
    """
    Return what the detector predicted of all detections; None where it is not of use.

    As of a detection, no error is smaller than that of rounding to a cell.
    """
    found = [item.predicted for item in detections if item.predicted is not None]
    if not found or len(found) < len(detections):
        return None
    score = np.array([item.score for item in found], dtype=float)
    position, cov = (
        np.array([getattr(item, name) for item in found], dtype=float).reshape(-1, *shape)
        for name, shape in (('position', (2,)), ('cov', (2, 2))))
    least = _LEAST_VARIANCE * np.maximum(cov[:, 0, 0], cov[:, 1, 1])
    sound = (score >= 0.0) & (score <= 1.0) & (abs(position) <= FARTHEST_M).all(axis=1)
    sound &= (cov[:, 0, 1] == cov[:, 1, 0]) & (cov[:, 0, 0] > least) & (cov[:, 1, 1] > least)
    sound &= (least <= _LEAST_VARIANCE * FARTHEST_M**2) & (
        np.linalg.det(np.nan_to_num(cov, posinf=0.0, neginf=0.0)) > least**2)
    if not sound.all():
        return None
    for axis in (0, 1):
        cov[:, axis, axis] = np.maximum(cov[:, axis, axis], cell_size_m**2 / 12.0)
    return Prediction(score, position, cov)


def _position_cov(cov: np.ndarray, cell_size_m: float) -> np.ndarray:
    """
    Return the covariance of the position, (m, 2, 2).

    It is the detector's own, but on no axis smaller than that of rounding to a cell.  Without a
    usable one it is that of a position uniform in its cell, ``cell_size_m^2 / 12`` an axis.
    """
    rounding = cell_size_m**2 / 12.0
    cov = cov[:, POS][:, :, POS]
    xx, xy, yy = cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1]
    with np.errstate(invalid='ignore', over='ignore'):
        stated = np.isfinite(cov).all(axis=(1, 2)) & (xx > 0) & (yy > 0) & (xx * yy > xy**2)
        stated &= (xx <= FARTHEST_M**2) & (yy <= FARTHEST_M**2)
    xx, yy = (np.maximum(np.where(stated, axis, 0.0), rounding) for axis in (xx, yy))
    xy = np.where(stated, xy, 0.0)
    return np.stack([xx, xy, xy, yy], axis=-1).reshape(-1, 2, 2)
