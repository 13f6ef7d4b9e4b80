# SPDX-License-Identifier: Apache-2.0
"""From the path of a track to its smoothed path, and the errors of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_common.core.smoother import smooth
from lowsnr_eval.scoring import metrics
from lowsnr_eval.smoothing.recorded_paths import Point
import numpy as np

# From states [p_x, v_x, p_y, v_y] to the order of the tables, x, y, v_x, v_y.
ORDER = [*POS, *VEL]
# Bounds of the standard deviations of the first state, in cells and cells a second; without the
# upper one the covariances after a detection would be lost to rounding.
_LEAST_DEVIATION, _LARGEST_DEVIATION = 1e-3, 1e4


@dataclass(frozen=True)
class Smoothed:
    """
    A smoothed path.

    Parameters
    ----------
    states : (K, 4) ndarray
        x, y, v_x, v_y in pixels of the image and, with respect to the scene, pixels a second.
    covs : (K, 4, 4) ndarray
        Their covariances.

    """

    states: np.ndarray
    covs: np.ndarray


def smooth_path(points: Sequence[Point], motion: MotionModes, cell_size_m: float) -> Smoothed:
    """
    Smooth the path of a track.

    It starts from the first published state, which holds all that was detected until then, with
    position and velocity taken as uncorrelated because odometry does not state how they are.
    From then on the measurements are the track's detections.  The path is smoothed in the scene,
    in units of cells, so that the camera may move.

    Parameters
    ----------
    points
        Its points, in order of time.
    motion
        Motion modes of the tracker [m, where a cell has ``cell_size_m``].
    cell_size_m
        Side of a cell [m].

    """
    side = np.array([point.view.binning for point in points])[:, None] / cell_size_m
    moved = np.array([(point.view.x, point.view.y) for point in points])
    detected = np.array([point.detected for point in points])
    positions = (detected[:, :2] - moved) / side
    positions[0] = np.nan
    times_s = np.array([point.stamp_ns - points[0].stamp_ns for point in points]) / 1e9
    found = smooth(
        motion, times_s, positions, _noise(detected[:, 2:] / side, cell_size_m),
        *_start(np.array(points[0].filtered), moved[0], side[0], motion, cell_size_m))
    states = found.states[:, ORDER] * side
    states[:, :2] += moved
    covs = found.covs[:, ORDER][:, :, ORDER] * side[..., None] ** 2
    return Smoothed(states, covs)


def _noise(deviations: np.ndarray, cell_size_m: float) -> np.ndarray:
    """Return the covariances of detections; as in the tracker at least that of rounding."""
    rounding = cell_size_m**2 / 12.0
    variances = np.fmax(deviations**2, rounding)
    noise: np.ndarray = variances[:, :, None] * np.eye(2)
    return noise


def _start(
    first: np.ndarray, moved: np.ndarray, side: np.ndarray, motion: MotionModes,
    cell_size_m: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and covariance of the first state; an unknown velocity is any that may be."""
    mean, deviation = first[:4] / side, first[4:] / side
    mean[:2] -= moved / side
    unknown = np.array([cell_size_m / np.sqrt(12.0)] * 2 + [motion.max_speed_mps / 2.0] * 2)
    deviation = np.where(np.isfinite(deviation), deviation, unknown)
    mean, deviation = np.nan_to_num(mean), np.clip(
        deviation, _LEAST_DEVIATION * cell_size_m, _LARGEST_DEVIATION * cell_size_m)
    back = np.argsort(ORDER)
    return mean[back], np.diag(deviation[back] ** 2)


class PathErrors:
    """
    The errors of filtered and smoothed paths, over the same points: those with an object.

    ``nees_position`` is the mean of ``e^T P^-1 e`` over the smoothed positions, ideally 2.
    """

    def __init__(self) -> None:
        self.tracks = 0
        self._nees = 0.0
        self._parts = {
            (path, kind): metrics.RootMeanSquare()
            for path in ('filtered', 'smoothed') for kind in ('position', 'velocity')}

    def add(self, points: Sequence[Point], smoothed: Smoothed) -> None:
        """Add a track."""
        truth = np.array([point.truth for point in points])
        paths = {'filtered': np.array([point.filtered[:4] for point in points]),
                 'smoothed': smoothed.states}
        self.tracks += 1
        # A track whose filter has no velocity, and truth without one, count for positions alone.
        for kind, part in (('position', slice(0, 2)), ('velocity', slice(2, 4))):
            off = {path: np.hypot(*(states - truth)[:, part].T) for path, states in paths.items()}
            known = np.all(np.isfinite([*off.values()]), axis=0)
            for path, each in off.items():
                self._parts[path, kind].add(
                    metrics.root_mean_square(each[known]), int(known.sum()))
        error = (smoothed.states - truth)[:, :2]
        known = np.isfinite(error).all(axis=1)
        self._nees += float(np.sum(error[known, None] @ np.linalg.solve(
            smoothed.covs[known, :2, :2], error[known, :, None])))

    def figures(self) -> dict[str, Any]:
        """Return errors [pixels, pixels/s] and counts so far; None of no point."""
        points = self._parts['smoothed', 'position'].count
        return {
            'tracks': self.tracks, 'points': points,
            'nees_position': self._nees / points if points else None,
            **{f'{path}_rmse_{kind}': each.value for (path, kind), each in self._parts.items()}}
