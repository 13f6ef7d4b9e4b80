# SPDX-License-Identifier: Apache-2.0
"""OSPA(2), the distance of two sets of tracks over a window of frames."""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence

from lowsnr_eval.track_metrics.track_frame import TrackFrame
import numpy as np
import scipy

# Frames of a window; the first frames of a run have those that there are.
WINDOW_FRAMES = 10


def ospa2(
    objects: np.ndarray, tracks: np.ndarray, cutoff: float, order: float = 1.0,
    time_order: float = 1.0,
) -> float:
    """
    Optimal sub-pattern assignment metric of two sets of tracks.

    The distance of two tracks x and y, which exist in the frames X and Y of the window, is ::

        d(x, y) = [sum over k in X or Y of d_k(x, y)^q / |X or Y|]^(1/q)

    where d_k is the Euclidean distance, at most c, in frames in which both exist and c in frames
    in which one does.  With m tracks in the smaller set and n in the larger one ::

        D = ([min over assignments of sum d(x, y)^p + c^p (n - m)] / n)^(1/p)

    Beard, Vo and Vo, "OSPA(2): Using the OSPA metric to evaluate multi-target tracking
    performance", ICCAIS 2017, and "A solution for large-scale multi-object tracking", IEEE Trans.
    Signal Processing 68 (2020), with the same weight for all frames.  A track that changes its
    object costs up to c although it is near an object in every frame.

    Parameters
    ----------
    objects : (N, T, 2) ndarray
        Positions in the frames of the window [m], NaN where an object does not exist; each
        exists in at least one.
    tracks : (M, T, 2) ndarray
        Likewise of the tracks.
    cutoff
        Largest distance c [m].
    order
        Exponent p of the assignment, at least 1.
    time_order
        Exponent q of the sum over time, at least 1.

    Returns
    -------
    float
        Metric [m], at most c; 0 where both sets are empty.

    """
    count = max(len(objects), len(tracks))
    if min(len(objects), len(tracks)) == 0:
        return cutoff if count else 0.0
    offset = objects[:, None] - tracks[None, :]
    away = np.fmin(np.hypot(offset[..., 0], offset[..., 1]), cutoff)  # c where one does not exist
    either = ~(np.isnan(objects[:, None, :, 0]) & np.isnan(tracks[None, :, :, 0]))
    powers = np.sum(away**time_order * either, axis=-1) / either.sum(axis=-1)
    cost = powers ** (order / time_order)
    total = cost[scipy.optimize.linear_sum_assignment(cost)].sum()
    missing = cutoff**order * abs(len(objects) - len(tracks))
    return float(((total + missing) / count) ** (1.0 / order))


class WindowedOspa2:
    """
    The mean of OSPA(2) over the windows that end in each frame of a run.

    Parameters
    ----------
    cutoff
        Largest distance c [m].
    window
        Frames of a window.

    """

    def __init__(self, cutoff: float, window: int = WINDOW_FRAMES) -> None:
        self._cutoff, self._window = cutoff, window
        self._paths: tuple[dict[str, np.ndarray], ...] = ({}, {})  # of objects, and of tracks
        self._total, self._frames = 0.0, 0

    def add(self, frame: TrackFrame) -> float:
        """Add a frame; return the distance over the window that ends in it [m]."""
        at = self._frames % self._window
        self._place(self._paths[0], at, frame.object_ids, frame.objects)
        self._place(self._paths[1], at, frame.track_ids, frame.tracks)
        objects, tracks = map(self._stacked, self._paths)
        distance = ospa2(objects, tracks, self._cutoff)
        self._total += distance
        self._frames += 1
        return distance

    def _stacked(self, paths: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return all paths of a set, (n, window, 2)."""
        return np.reshape([*paths.values()], (-1, self._window, 2))

    def _place(
        self, paths: dict[str, np.ndarray], at: int, ids: Sequence[str], positions: np.ndarray,
    ) -> None:
        """Replace the oldest frame of the paths of a set; forget who is in no other."""
        known = np.isfinite(positions).all(axis=1)
        here = {name: place for name, place, is_known in zip(ids, positions, known) if is_known}
        for name in paths.keys() - here.keys():
            paths[name][at] = np.nan
            if np.isnan(paths[name]).all():
                del paths[name]
        for name, place in here.items():
            paths.setdefault(name, np.full((self._window, 2), np.nan))[at] = place

    @property
    def value(self) -> float | None:
        """Mean over the frames so far [m]; None of no frame."""
        return self._total / self._frames if self._frames else None
