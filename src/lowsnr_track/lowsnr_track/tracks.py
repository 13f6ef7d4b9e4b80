# SPDX-License-Identifier: Apache-2.0
"""Tracks, the state that the tracker carries from frame to frame, and what it returns."""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import replace
import functools
import math

from lowsnr_common.core.bound_motion import DestinationDensity
from lowsnr_common.core.bound_motion import draw_bound
from lowsnr_common.core.frame_map import moved_states
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_common.core.records import Estimate
from lowsnr_track.measurements import Measurements
from lowsnr_track.particles import concatenate
from lowsnr_track.particles import equally_weighted
from lowsnr_track.particles import paired_noise
from lowsnr_track.particles import Particles
import numpy as np

# The largest existence probability; beyond it 1 - P would lose its last digits.
MAX_EXISTENCE = 1.0 - 1e-12


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
    ended : (T, H) ndarray
        Probability that the object ended 1 ... H frames ago, while the detector may still
        declare it.
    repeated : (T,) ndarray
        Probability that there is a detection in the next frame, if those of the track are false.
    ids : (T,) ndarray of int
        Number of the track, given at birth and to no other.
    confirmed : (T,) ndarray of bool
        Whether the track is published on ``tracks``.

    """

    particles: Particles
    existence: np.ndarray
    ended: np.ndarray
    repeated: np.ndarray
    ids: np.ndarray
    confirmed: np.ndarray

    def __len__(self) -> int:
        """Return the number of tracks T."""
        return len(self.ids)

    def __getitem__(self, index: np.ndarray) -> Tracks:
        """Return the tracks that an index or mask picks."""
        return self.picked(index, self.particles[index])

    def picked(self, index: np.ndarray, particles: Particles) -> Tracks:
        """Return the tracks that an index or mask picks, with these particles."""
        return Tracks(
            particles, self.existence[index], self.ended[index],
            self.repeated[index], self.ids[index], self.confirmed[index])

    @property
    def followed(self) -> np.ndarray:
        """Probability that there is, or just was, an object to follow, (T,)."""
        total: np.ndarray = self.existence + self.ended.sum(axis=1)
        return total

    def aged(self, survival: np.ndarray, frames: int) -> Tracks:
        """
        Return these tracks some frames later, before the detections of the new frame.

        Parameters
        ----------
        survival : (T,) ndarray
            Probability that the object of each has not ended since.
        frames
            Frames that have passed, at least 1.

        """
        # An object that ended h frames ago existed until frames - h frames after the last one.
        left = survival[:, None] ** (np.arange(frames, -1, -1) / frames)
        newly = self.existence[:, None] * (left[:, 1:] - left[:, :-1])
        ended = np.concatenate([newly, self.ended], axis=1)[:, :self.ended.shape[1]]
        return replace(
            self, existence=self.existence * survival, ended=ended,
            repeated=self.repeated / 2.0 ** (frames - 1))

    def join(self, other: Tracks) -> Tracks:
        """Return these tracks, followed by others."""
        if len(other) == 0:
            return self
        return Tracks(
            concatenate(self.particles, other.particles),
            np.concatenate([self.existence, other.existence]),
            np.concatenate([self.ended, other.ended]),
            np.concatenate([self.repeated, other.repeated]),
            np.concatenate([self.ids, other.ids]),
            np.concatenate([self.confirmed, other.confirmed]))

    def output(self, kept: np.ndarray, rejected: Mapping[str, int]) -> TrackerOutput:
        """
        Return the tracks of a frame as records, with its rejected detections by reason.

        Those that are not in the mask ``kept`` (T,) are left out.
        """
        return TrackerOutput(
            self.estimates(kept & self.confirmed), self.estimates(kept & ~self.confirmed),
            rejected)

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

    ``stamp_s`` is the time of the last frame [s], None before the first, and ``first_s`` that of
    the first, from which arrivals at destinations are counted; ``frames`` the number of frames;
    ``next_id`` the number of the next track; ``clutter_density`` the estimated density of false
    detections that no object causes [1/cell].  ``posteriors`` is whether the detector states
    posteriors, by its last declarations.
    """

    stamp_s: float | None
    frames: int
    next_id: int
    clutter_density: float
    tracks: Tracks
    posteriors: bool = False
    first_s: float | None = None

    def frame(self, period_s: float) -> float:
        """
        Return the time of the last frame as its number: 1 for the first, 0 before it.

        Between frames of the period it is a fraction.
        """
        if self.stamp_s is None or self.first_s is None:
            return 0.0
        return 1.0 + (self.stamp_s - self.first_s) / period_s

    def elapsed_s(self, stamp_s: float) -> float:
        """
        Return the time from the last frame to one of a stamp [s], 0 before the first.

        ValueError where that is not finite or not later.
        """
        if not math.isfinite(stamp_s):
            raise ValueError(f'stamp {stamp_s} is not finite')
        if self.stamp_s is not None and stamp_s <= self.stamp_s:
            raise ValueError(f'stamp {stamp_s} s is not later than {self.stamp_s} s')
        return 0.0 if self.stamp_s is None else stamp_s - self.stamp_s

    def moved(self, by: tuple[int, int], cell_size_m: float) -> TrackerState:
        """Return the state in cells whose first one moved ``by`` rows and columns."""
        particles = self.tracks.particles
        moved = replace(
            particles, states=moved_states(particles.states, by, cell_size_m),
            bound=particles.bound and particles.bound.moved(by, cell_size_m))
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


@functools.lru_cache(maxsize=8)
def no_tracks(count: int, memory: int = 1) -> Tracks:
    """Return an empty set of tracks of ``count`` particles, for a memory of so many frames."""
    none = equally_weighted(np.empty((0, count, 4)), np.empty((0, count), dtype=np.intp))
    return Tracks(
        none, np.empty(0), np.empty((0, memory - 1)), np.empty(0), np.empty(0, dtype=np.int64),
        np.empty(0, dtype=bool))


def start_tracks(
    measured: Measurements, existence: np.ndarray, first_id: int, motion: MotionModes,
    count: int, rng: np.random.Generator, memory: int = 1, repeated: float = 0.0,
    destinations: Sequence[DestinationDensity] = (),
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
    memory
        Frames that a detection rests on.
    repeated
        Probability that a false detection is repeated in the next frame.
    destinations
        Where objects may be bound for; every particle draws its own.

    """
    tracks = len(existence)
    states = np.empty((tracks, count, 4))
    # All tracks of a frame share the draws, which leaves each of them as random as it was.
    factor = np.linalg.cholesky(measured.cov)
    noise = paired_noise(count, 2, rng) @ np.swapaxes(factor, -1, -2)
    states[..., POS] = measured.position[:, None] + noise
    velocity = motion.draw_velocity((count - count // 2,), rng)
    states[..., VEL] = np.concatenate([velocity, -velocity[:count // 2]])
    modes = np.tile(rng.integers(motion.count, size=count), (tracks, 1))
    ids = np.arange(first_id, first_id + tracks)
    particles = equally_weighted(states, modes)
    if destinations:
        particles = replace(particles, bound=draw_bound(destinations, modes.shape, rng))
    return Tracks(
        particles, existence, np.zeros((tracks, memory - 1)),
        np.full(tracks, repeated), ids, np.zeros(tracks, dtype=bool))
