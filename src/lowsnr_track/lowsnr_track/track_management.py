# SPDX-License-Identifier: Apache-2.0
"""Track management: births, confirmation with hysteresis, merging and deletion."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace

from lowsnr_common.core.motion import POS
from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import setting
from lowsnr_track.tracks import Tracks
import numpy as np


@dataclass(frozen=True, kw_only=True)
class TrackLife:
    """When tracks are born, confirmed, merged and deleted."""

    birth_density: float = setting(
        2.5e-5, 'birth density: new objects a cell and frame', gt=0.0, le=1.0, live=True)
    lifetime_s: float = setting(30.0, 'mean time that an object exists [s]', gt=0.0)
    confirm_probability: float = setting(
        0.5, 'existence probability at which a track is confirmed', gt=0.0, lt=1.0, live=True)
    release_probability: float = setting(
        0.3, 'existence probability below which a track is no longer confirmed', gt=0.0, lt=1.0,
        live=True)
    false_tracks: float = setting(
        0.0, 'false tracks a frame, to which bringup.py and lowsnr.track calibrate '
        'confirm_probability before the first frame; 0 keeps confirm_probability', ge=0.0, lt=1.0)
    delete_probability: float = setting(
        0.005, 'existence probability below which a track is deleted', gt=0.0, lt=1.0, live=True)
    merge_distance: float = setting(
        1.0, 'Mahalanobis distance up to which two tracks of one object are merged; 0 for never',
        ge=0.0)
    max_tracks: int = setting(
        50, 'most tracks kept, tentative ones included', ge=1, le=10_000)
    max_gap_s: float = setting(
        30.0, 'time without a frame after which all tracks are deleted [s]', gt=0.0)

    def __post_init__(self) -> None:
        check_settings(self)
        rising = (self.delete_probability, self.release_probability, self.confirm_probability)
        if list(rising) != sorted(rising):
            raise ValueError(
                f'TrackLife.delete_, release_ and confirm_probability = {rising}, must not fall')

    def born(self, existence: np.ndarray) -> np.ndarray:
        """Return the detections that start a track, by their probability of a new object."""
        chosen = np.argsort(-existence, kind='stable')[:self.max_tracks]
        return np.sort(chosen[existence[chosen] >= self.delete_probability])

    def manage(self, tracks: Tracks) -> tuple[Tracks, np.ndarray]:
        """Merge tracks of one object, confirm likely ones; return them and which to keep (T,)."""
        tracks, kept = self.merge(tracks)
        if kept.size == 0:
            return tracks, kept
        bound = np.where(
            tracks.confirmed, self.release_probability, self.confirm_probability)
        return replace(tracks, confirmed=tracks.existence >= bound), self.lasting(tracks, kept)

    def prune(self, tracks: Tracks) -> Tracks:
        """Delete tracks that are unlikely to exist, and the least likely of too many."""
        lasting = self.lasting(tracks, np.ones(len(tracks), dtype=bool))
        return tracks if lasting.all() else tracks[lasting]

    def lasting(self, tracks: Tracks, kept: np.ndarray) -> np.ndarray:
        """Return which of the kept tracks are likely enough, and not too many, (T,)."""
        lasting = kept & (tracks.followed >= self.delete_probability)
        order = _rank(tracks)
        lasting[order[lasting[order]][self.max_tracks:]] = False
        return lasting

    def merge(self, tracks: Tracks) -> tuple[Tracks, np.ndarray]:
        """
        Merge tracks that follow one object.

        Joint association gives a detection to one of two tracks at most.  Two tracks on one
        object therefore share its existence probability: their sum is about one, where that of
        two tracks on two objects is about two.  A sum of at most 1.5, half way, is one object.

        Returns
        -------
        Tracks
            The same tracks; of each pair within ``merge_distance`` that is one object, the track
            that is confirmed, more likely or older has the probability that either exists.
        (T,) ndarray of bool
            Which tracks are left; the others are merged into these.

        """
        kept = np.ones(len(tracks), dtype=bool)
        if len(tracks) < 2 or self.merge_distance == 0.0:
            return tracks, kept
        near: np.ndarray = self._near(tracks)
        if not near.any():
            return tracks, kept
        existence = tracks.existence.copy()
        before = 1.0 - existence
        order = _rank(tracks)
        for n in order[np.any(near[order], axis=1)]:
            for other in np.flatnonzero(near[n] & kept & kept[n]):
                if existence[n] + existence[other] <= 1.5:
                    kept[other] = False
                    existence[n] += (1.0 - existence[n]) * existence[other]
            near[:, n] = False
        # What the other track adds to existence is taken from all else in proportion.
        ended = tracks.ended * ((1.0 - existence) / before)[:, None]
        return replace(tracks, existence=existence, ended=ended), kept

    def _near(self, tracks: Tracks) -> np.ndarray:
        """Return which tracks are within the distance, by their mean covariance, (T, T)."""
        mean, cov = tracks.particles.moments
        # A distance is at least that along any one axis.
        variance = np.diagonal(cov, axis1=-2, axis2=-1)
        reach = self.merge_distance * np.sqrt(variance[:, POS[0]].max() + 1e-12)
        one, two = np.nonzero(np.triu(abs(mean[:, None, POS[0]] - mean[:, POS[0]]) <= reach, 1))
        for axis in POS:
            offset = mean[one, axis] - mean[two, axis]
            spread = (variance[one, axis] + variance[two, axis]) / 2.0 + 1e-12
            close = offset**2 <= self.merge_distance**2 * spread
            one, two = one[close], two[close]
        offset = mean[one] - mean[two]
        spread = (cov[one] + cov[two]) / 2.0 + 1e-12 * np.eye(4)
        squared = np.sum(offset * np.linalg.solve(spread, offset[..., None])[..., 0], axis=-1)
        near = np.zeros((len(tracks),) * 2, dtype=bool)
        near[one, two] = squared <= self.merge_distance**2
        return near | near.T


def _rank(tracks: Tracks) -> np.ndarray:
    """Return the order of the tracks: confirmed first, then more likely, then older."""
    return np.lexsort((tracks.ids, -tracks.existence, ~tracks.confirmed))
