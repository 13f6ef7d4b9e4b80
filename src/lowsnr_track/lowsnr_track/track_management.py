"""The life of tracks: birth, confirmation with hysteresis, merging and deletion."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace

from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_common.core.records import Estimate
from lowsnr_common.settings.config import check_settings
from lowsnr_common.settings.config import setting
from lowsnr_track.measurements import Measurements
from lowsnr_track.mmpf import Cloud
from lowsnr_track.mmpf import concatenate
from lowsnr_track.mmpf import uniform_cloud
import numpy as np


@dataclass(frozen=True)
class Tracks:
    """
    All tracks of a frame, confirmed or not.

    Parameters
    ----------
    cloud : Cloud
        Posterior of every track, (T, N).
    existence : (T,) ndarray
        Probability that the object exists.
    ids : (T,) ndarray of int
        Number of the track, given at birth and never again.
    confirmed : (T,) ndarray of bool
        Whether the track is published as one.

    """

    cloud: Cloud
    existence: np.ndarray
    ids: np.ndarray
    confirmed: np.ndarray

    def __len__(self) -> int:
        """Return the number of tracks T."""
        return len(self.ids)

    def __getitem__(self, index: np.ndarray) -> Tracks:
        """Return the tracks that an index or mask picks."""
        return Tracks(
            self.cloud[index], self.existence[index], self.ids[index], self.confirmed[index])

    def join(self, other: Tracks) -> Tracks:
        """Return these tracks, followed by others."""
        return Tracks(
            concatenate(self.cloud, other.cloud),
            np.concatenate([self.existence, other.existence]),
            np.concatenate([self.ids, other.ids]),
            np.concatenate([self.confirmed, other.confirmed]))

    def estimates(self, chosen: np.ndarray) -> list[Estimate]:
        """Return mean, covariance and existence probability of the chosen tracks."""
        if not chosen.any():
            return []
        mean, cov = self.cloud.moments
        return [Estimate(mean[n], cov[n], float(self.existence[n]), str(self.ids[n]))
                for n in np.flatnonzero(chosen)]


def no_tracks(particles: int) -> Tracks:
    """Return an empty set of tracks with clouds of a given size."""
    cloud = uniform_cloud(np.empty((0, particles, 4)), np.empty((0, particles), dtype=np.intp))
    return Tracks(cloud, np.empty(0), np.empty(0, dtype=np.int64), np.empty(0, dtype=bool))


def newborn(
    measured: Measurements, existence: np.ndarray, first_id: int, motion: MotionModes,
    particles: int, rng: np.random.Generator,
) -> Tracks:
    """
    Start a track from each detection.

    Parameters
    ----------
    measured
        Detections (m,); each gives the position of a track.
    existence : (m,) ndarray
        Probability that each is a new object.
    first_id
        Number of the first track.
    motion
        Speed limits, of which the velocity is drawn, and modes, all equally likely.
    particles
        Particles a track.
    rng
        Source of randomness.

    """
    count = len(existence)
    states = np.empty((count, particles, 4))
    factor = np.linalg.cholesky(measured.cov)
    noise = rng.standard_normal((count, particles, 2)) @ np.swapaxes(factor, -1, -2)
    states[..., POS] = measured.position[:, None] + noise
    states[..., VEL] = motion.draw_velocity((count, particles), rng)
    modes = rng.integers(motion.count, size=(count, particles))
    ids = np.arange(first_id, first_id + count)
    return Tracks(uniform_cloud(states, modes), existence, ids, np.zeros(count, dtype=bool))


@dataclass(frozen=True, kw_only=True)
class TrackLife:
    """When tracks are confirmed, merged and deleted."""

    birth_density: float = setting(
        2.5e-5, 'new objects a cell and frame', gt=0.0, le=1.0, live=True)
    lifetime_s: float = setting(30.0, 'mean time that an object exists [s]', gt=0.0)
    confirm_probability: float = setting(
        0.95, 'existence probability at which a track is confirmed', gt=0.0, lt=1.0, live=True)
    release_probability: float = setting(
        0.5, 'existence probability below which a confirmed track is no longer', gt=0.0, lt=1.0,
        live=True)
    delete_probability: float = setting(
        0.005, 'existence probability below which a track is deleted', gt=0.0, lt=1.0, live=True)
    merge_distance: float = setting(
        1.0, 'Mahalanobis distance up to which two tracks that share one existence are merged',
        ge=0.0)
    max_tracks: int = setting(
        50, 'most tracks kept, tentative ones included', ge=1, le=10_000)
    max_gap_s: float = setting(
        30.0, 'time without a frame after which all tracks are dropped [s]', gt=0.0)

    def __post_init__(self) -> None:
        check_settings(self)
        rising = (self.delete_probability, self.release_probability, self.confirm_probability)
        if list(rising) != sorted(rising):
            raise ValueError(
                f'TrackLife.delete_, release_ and confirm_probability = {rising}, must not fall')

    def manage(self, tracks: Tracks) -> Tracks:
        """Merge tracks that follow one object, drop those that are nothing, confirm."""
        if len(tracks) == 0:
            return tracks
        tracks = self.prune(self.merge(tracks))
        bound = np.where(
            tracks.confirmed, self.release_probability, self.confirm_probability)
        return replace(tracks, confirmed=tracks.existence >= bound)

    def prune(self, tracks: Tracks) -> Tracks:
        """Drop tracks that hardly exist, and the least certain where there are too many."""
        alive = tracks.existence >= self.delete_probability
        if len(tracks) > self.max_tracks:
            alive[_rank(tracks)[self.max_tracks:]] = False
        return tracks if alive.all() else tracks[alive]

    def merge(self, tracks: Tracks) -> Tracks:
        """
        Make one of tracks that follow one object.

        Joint association lets only one of two tracks have a detection, so that two tracks on
        one object hold one object's existence between them, while two on two objects in one
        place hold that of two.

        Returns
        -------
        Tracks
            Of each pair in one place that holds at most one and a half objects, the one that
            is confirmed, more certain or older, with the probability that either exists.

        """
        if len(tracks) < 2 or self.merge_distance == 0.0:
            return tracks
        near = self._near(tracks)
        if not near.any():
            return tracks
        existence, alive = tracks.existence.copy(), np.ones(len(tracks), dtype=bool)
        for n in _rank(tracks):
            near[n, n] = False
            for other in np.flatnonzero(near[n] & alive & alive[n]):
                if existence[n] + existence[other] <= 1.5:
                    alive[other] = False
                    existence[n] += (1.0 - existence[n]) * existence[other]
            near[:, n] = False
        return replace(tracks, existence=existence)[alive]

    def _near(self, tracks: Tracks) -> np.ndarray:
        """Return which tracks are in one place, by their average covariance, (T, T) of bool."""
        mean, cov = tracks.cloud.moments
        one, two = np.triu_indices(len(tracks), 1)
        offset = mean[one] - mean[two]
        spread = (cov[one] + cov[two]) / 2.0 + 1e-12 * np.eye(4)
        squared = np.sum(offset * np.linalg.solve(spread, offset[..., None])[..., 0], axis=-1)
        near = np.zeros((len(tracks), len(tracks)), dtype=bool)
        near[one, two] = near[two, one] = squared <= self.merge_distance**2
        return near


def _rank(tracks: Tracks) -> np.ndarray:
    """Return the tracks in order: confirmed first, then more certain, then older."""
    return np.lexsort((tracks.ids, -tracks.existence, ~tracks.confirmed))
