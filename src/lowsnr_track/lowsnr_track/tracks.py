"""Tracks, the state that the tracker carries from frame to frame, and what it returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import replace

from lowsnr_common.core.frame_map import moved_states
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_common.core.records import Estimate
from lowsnr_track.measurements import Measurements
from lowsnr_track.mmpf import concatenate
from lowsnr_track.mmpf import equally_weighted
from lowsnr_track.mmpf import Particles
import numpy as np


@dataclass(frozen=True)
class Tracks:
    """
    All tracks of a frame, confirmed or not.

    Parameters
    ----------
    particles : Particles
        Posterior of the state of every track, (T, N).
    existence : (T,) ndarray
        Existence probability P(chi_k | Z^k) of the object.
    ids : (T,) ndarray of int
        Number of the track, given at birth and to no other.
    confirmed : (T,) ndarray of bool
        Whether the track is published on ``tracks``.

    """

    particles: Particles
    existence: np.ndarray
    ids: np.ndarray
    confirmed: np.ndarray

    def __len__(self) -> int:
        """Return the number of tracks T."""
        return len(self.ids)

    def __getitem__(self, index: np.ndarray) -> Tracks:
        """Return the tracks that an index or mask picks."""
        return Tracks(
            self.particles[index], self.existence[index], self.ids[index], self.confirmed[index])

    def join(self, other: Tracks) -> Tracks:
        """Return these tracks, followed by others."""
        if len(other) == 0:
            return self
        return Tracks(
            concatenate(self.particles, other.particles),
            np.concatenate([self.existence, other.existence]),
            np.concatenate([self.ids, other.ids]),
            np.concatenate([self.confirmed, other.confirmed]))

    def estimates(self, chosen: np.ndarray) -> list[Estimate]:
        """Return mean, covariance and existence probability of the chosen tracks."""
        if not chosen.any():
            return []
        mean, cov = self.particles.moments
        return [Estimate(mean[n], cov[n], float(self.existence[n]), str(self.ids[n]))
                for n in np.flatnonzero(chosen)]


@dataclass(frozen=True)
class TrackerState:
    """
    What the tracker carries from frame to frame.

    ``stamp_s`` is the time of the last frame [s], None before the first; ``frames`` the number of
    frames; ``next_id`` the number of the next track; ``clutter_density`` the estimated density of
    false detections that no object causes [1/cell].
    """

    stamp_s: float | None
    frames: int
    next_id: int
    clutter_density: float
    tracks: Tracks

    def moved(self, by: tuple[int, int], cell_size_m: float) -> TrackerState:
        """Return the state in cells whose first one moved ``by`` rows and columns."""
        particles = self.tracks.particles
        moved = replace(particles, states=moved_states(particles.states, by, cell_size_m))
        return replace(self, tracks=replace(self.tracks, particles=moved))


@dataclass(frozen=True)
class TrackerOutput:
    """
    The tracks of one frame.

    ``confirmed`` and ``tentative`` hold whole states, with the existence probability as score;
    ``rejected`` counts the detections that could not be used, by reason.
    """

    confirmed: list[Estimate]
    tentative: list[Estimate]
    rejected: Mapping[str, int]


def no_tracks(count: int) -> Tracks:
    """Return an empty set of tracks that have ``count`` particles each."""
    none = equally_weighted(np.empty((0, count, 4)), np.empty((0, count), dtype=np.intp))
    return Tracks(none, np.empty(0), np.empty(0, dtype=np.int64), np.empty(0, dtype=bool))


def start_tracks(
    measured: Measurements, existence: np.ndarray, first_id: int, motion: MotionModes,
    count: int, rng: np.random.Generator,
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
        Limits of the speed, within which the velocity is drawn, and modes, equally likely.
    count
        Particles a track.
    rng
        Source of randomness.

    """
    tracks = len(existence)
    states = np.empty((tracks, count, 4))
    factor = np.linalg.cholesky(measured.cov)
    noise = rng.standard_normal((tracks, count, 2)) @ np.swapaxes(factor, -1, -2)
    states[..., POS] = measured.position[:, None] + noise
    states[..., VEL] = motion.draw_velocity((tracks, count), rng)
    modes = rng.integers(motion.count, size=(tracks, count))
    ids = np.arange(first_id, first_id + tracks)
    return Tracks(
        equally_weighted(states, modes), existence, ids, np.zeros(tracks, dtype=bool))
