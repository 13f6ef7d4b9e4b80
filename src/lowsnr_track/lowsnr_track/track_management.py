"""Track management: births, confirmation with hysteresis, merging and deletion."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace

from lowsnr_common.core.motion import MotionModes
from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import setting
from lowsnr_track.measurements import Measurements
from lowsnr_track.tracks import no_tracks
from lowsnr_track.tracks import start_tracks
from lowsnr_track.tracks import Tracks
import numpy as np


@dataclass(frozen=True, kw_only=True)
class TrackLife:
    """When tracks are born, confirmed, merged and deleted."""

    birth_density: float = setting(
        2.5e-5, 'birth density: new objects a cell and frame', gt=0.0, le=1.0, live=True)
    lifetime_s: float = setting(30.0, 'mean time that an object exists [s]', gt=0.0)
    confirm_probability: float = setting(
        0.95, 'existence probability at which a track is confirmed', gt=0.0, lt=1.0, live=True)
    release_probability: float = setting(
        0.5, 'existence probability below which a track is no longer confirmed', gt=0.0, lt=1.0,
        live=True)
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

    def births(
        self, measured: Measurements, existence: np.ndarray, first_id: int, motion: MotionModes,
        count: int, rng: np.random.Generator,
    ) -> Tracks:
        """Start tracks from the detections that are most likely new, as :func:`start_tracks`."""
        chosen = np.argsort(-existence, kind='stable')[:self.max_tracks]
        chosen = np.sort(chosen[existence[chosen] >= self.delete_probability])
        if chosen.size == 0:
            return no_tracks(count)
        return start_tracks(measured[chosen], existence[chosen], first_id, motion, count, rng)

    def manage(self, tracks: Tracks) -> Tracks:
        """Merge tracks of one object, delete unlikely ones, confirm likely ones."""
        if len(tracks) == 0:
            return tracks
        tracks = self.prune(self.merge(tracks))
        bound = np.where(
            tracks.confirmed, self.release_probability, self.confirm_probability)
        return replace(tracks, confirmed=tracks.existence >= bound)

    def prune(self, tracks: Tracks) -> Tracks:
        """Delete tracks that are unlikely to exist, and the least likely of too many."""
        kept = tracks.existence >= self.delete_probability
        if len(tracks) > self.max_tracks:
            kept[_rank(tracks)[self.max_tracks:]] = False
        return tracks if kept.all() else tracks[kept]

    def merge(self, tracks: Tracks) -> Tracks:
        """
        Merge tracks that follow one object.

        Joint association gives a detection to one of two tracks at most.  Two tracks on one
        object therefore share its existence probability: their sum is about one, where that of
        two tracks on two objects is about two.  A sum of at most 1.5, half way, is one object.

        Returns
        -------
        Tracks
            Of each pair within ``merge_distance`` that is one object, the track that is
            confirmed, more likely or older, with the probability that either exists.

        """
        if len(tracks) < 2 or self.merge_distance == 0.0:
            return tracks
        near = self._near(tracks)
        if not near.any():
            return tracks
        existence, kept = tracks.existence.copy(), np.ones(len(tracks), dtype=bool)
        for n in _rank(tracks):
            near[n, n] = False
            for other in np.flatnonzero(near[n] & kept & kept[n]):
                if existence[n] + existence[other] <= 1.5:
                    kept[other] = False
                    existence[n] += (1.0 - existence[n]) * existence[other]
            near[:, n] = False
        return replace(tracks, existence=existence)[kept]

    def _near(self, tracks: Tracks) -> np.ndarray:
        """Return which tracks are within the distance, by their mean covariance, (T, T)."""
        mean, cov = tracks.particles.moments
        one, two = np.triu_indices(len(tracks), 1)
        offset = mean[one] - mean[two]
        spread = (cov[one] + cov[two]) / 2.0 + 1e-12 * np.eye(4)
        squared = np.sum(offset * np.linalg.solve(spread, offset[..., None])[..., 0], axis=-1)
        near = np.zeros((len(tracks), len(tracks)), dtype=bool)
        near[one, two] = near[two, one] = squared <= self.merge_distance**2
        return near


def _rank(tracks: Tracks) -> np.ndarray:
    """Return the order of the tracks: confirmed first, then more likely, then older."""
    return np.lexsort((tracks.ids, -tracks.existence, ~tracks.confirmed))
