# SPDX-License-Identifier: Apache-2.0
"""One frame of a run as the metrics of tracks see it: named positions of objects and tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from lowsnr_eval.scoring import metrics
import numpy as np


@dataclass(frozen=True)
class TrackFrame:
    """
    The objects that are present in a frame, and the tracks that were published for it.

    Parameters
    ----------
    stamp_s
        Time [s].
    object_ids, track_ids
        Their names; no two objects have the same one, and no two tracks.
    objects : (N, 2) ndarray
        Positions of the objects [m].
    tracks : (M, 2) ndarray
        Positions of the tracks [m].
    existence : (M,) ndarray
        Published probability that the object of each track exists; NaN where there is none.

    """

    stamp_s: float
    object_ids: Sequence[str]
    objects: np.ndarray
    track_ids: Sequence[str]
    tracks: np.ndarray
    existence: np.ndarray

    @cached_property
    def distance(self) -> np.ndarray:
        """Return the distances of tracks from objects, (N, M) [m]."""
        return metrics.distances(self.objects, self.tracks)


def assign_to_nearest(frame: TrackFrame, gate_m: float) -> dict[int, int]:
    """
    Assign each track to the nearest object within the gate; several may have the same object.

    Returns
    -------
    dict
        Index of the object by that of the track, for the tracks that have one.

    """
    if not frame.distance.size:
        return {}
    nearest = frame.distance.argmin(axis=0)
    return {track: int(number) for track, number in enumerate(nearest)
            if frame.distance[number, track] <= gate_m}
