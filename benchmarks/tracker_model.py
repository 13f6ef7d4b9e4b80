# SPDX-License-Identifier: Apache-2.0
"""Simulate detections from the tracker's model; run the tracker and an exact filter on them."""

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import replace

from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import process_noise_cov
from lowsnr_common.core.motion import VEL
from lowsnr_common.core.records import Estimate
from lowsnr_track.detection_model import DetectionModel
from lowsnr_track.particles import equally_weighted
from lowsnr_track.pda_mmpf import PdaMmpf
from lowsnr_track.track_management import TrackLife
from lowsnr_track.tracks import TrackerState
from lowsnr_track.tracks import Tracks
import numpy as np
from track import oracles

VARIANCE = 0.3  # of a detected position, per axis [m^2]
NOISE = VARIANCE * np.eye(2)
FIELD_M = 10.0  # false detections lie within this distance of the object, along each axis
PRIOR_MEAN = np.array([50.0, 0.4, 50.0, 0.2])
PRIOR_COV = np.diag([VARIANCE, 0.09, VARIANCE, 0.09])
# The first track is of the object; it always exists, and it is the only one.
ONE_TRACK = TrackLife(
    birth_density=0.01, lifetime_s=1e9, confirm_probability=1e-9, release_probability=1e-10,
    delete_probability=1e-12, merge_distance=0.0, max_tracks=1)
MODEL = PdaMmpf(
    detection=DetectionModel(clutter_memory_frames=0, use_scores=False), life=ONE_TRACK)


@dataclass(frozen=True)
class Followed:
    """Estimation errors (K, 4), covariances (K, 4, 4) and mode probabilities (K, modes)."""

    error: np.ndarray
    cov: np.ndarray
    modes: np.ndarray

    @property
    def nees(self) -> np.ndarray:
        """Normalised squared estimation error of each frame, (K,)."""
        solved = np.linalg.solve(self.cov, self.error[..., None])[..., 0]
        squared: np.ndarray = np.sum(self.error * solved, axis=-1)
        return squared


def simulate(
    tracker: PdaMmpf, frames: int, born: bool, rng: np.random.Generator,
) -> tuple[np.ndarray, list[np.ndarray]]:
    """
    Return the states (K, 4) of an object and the detections (m, 2) of every frame.

    With ``born`` the object appears as in the tracker's model, and its detection is the only one
    of the first frame; without, its state before the first frame has the Gaussian prior.
    """
    motion, mode = tracker.motion, rng.integers(tracker.motion.count, size=1)
    state = rng.multivariate_normal(PRIOR_MEAN, PRIOR_COV)
    if born:
        state[VEL] = motion.draw_velocity((), rng)
    clutter = tracker.detection.clutter_density * (2 * FIELD_M)**2
    states, detections = [], []
    for k in range(frames):
        first = born and k == 0
        if not first:
            mode = motion.switch(mode, 1.0, rng)
            state = motion.move(state[None], mode, 1.0, rng)[0]
        seen = first or rng.random() < tracker.detection.probability
        false = 0 if first else rng.poisson(clutter)
        true = state[POS] + np.sqrt(VARIANCE) * rng.standard_normal((int(seen), 2))
        around = state[POS] + rng.uniform(-FIELD_M, FIELD_M, (false, 2))
        states.append(state)
        detections.append(np.concatenate([true, around]))
    return np.array(states), detections


def follow(
    tracker: PdaMmpf, states: np.ndarray, detections: Sequence[np.ndarray], born: bool,
    rng: np.random.Generator,
) -> Followed:
    """Run the tracker on the detections; return its errors."""
    memory = tracker.init() if born else replace(
        tracker.init(), stamp_s=0.0, next_id=2, tracks=prior_track(tracker, rng))
    found = []
    for k, positions in enumerate(detections):
        records = [as_record(position) for position in positions]
        memory, output = tracker.step(memory, records, k + 1.0, rng)
        (track,) = output.confirmed
        modes = memory.tracks.particles.mode_probabilities(tracker.motion.count)[0]
        found.append((states[k] - track.state, track.cov, modes))
    return Followed(*(np.array(part) for part in zip(*found)))


def follow_exactly(
    tracker: PdaMmpf, states: np.ndarray, detections: Sequence[np.ndarray], hypotheses: int,
) -> Followed:
    """
    Run the exact filter, a mixture of Kalman filters, on the detections; return its errors.

    It keeps the most likely ``hypotheses``; 5000 move the mean by less than 1 % of its error.
    """
    motion, model = tracker.motion, tracker.detection
    matrices, chain = motion.transition_matrices(1.0), motion.mode_transition(1.0)
    process_noise = process_noise_cov(1.0, motion.acceleration_density)
    mixture, found = oracles.gaussian(PRIOR_MEAN, PRIOR_COV, motion.count), []
    for state, positions in zip(states, detections):
        mixture = oracles.predict(mixture, matrices, process_noise, chain)
        mixture, _ = oracles.update(
            mixture, positions, NOISE, model.probability, model.clutter_density, hypotheses)
        mean, cov = mixture.moments()
        found.append((state - mean, cov, mixture.modes(motion.count)))
    return Followed(*(np.array(part) for part in zip(*found)))


def prior_track(tracker: PdaMmpf, rng: np.random.Generator) -> Tracks:
    """Return one track whose particles represent the Gaussian prior."""
    shape = (1, tracker.particles)
    states = rng.multivariate_normal(PRIOR_MEAN, PRIOR_COV, shape)
    modes = rng.integers(tracker.motion.count, size=shape)
    return Tracks(
        equally_weighted(states, modes), np.array([1.0 - 1e-12]), np.zeros((1, 0)),
        np.zeros(1), np.array([1]), np.array([True]))


def as_record(position: np.ndarray) -> Estimate:
    """Return the record of a detected position."""
    state, cov = np.full(4, np.nan), np.full((4, 4), np.nan)
    state[POS] = position
    cov[np.ix_(POS, POS)] = NOISE
    return Estimate(state, cov, 0.5)


def flat_likelihood_error(count: int, steps: int, rng: np.random.Generator) -> float:
    """
    Return the largest error of the mode probabilities of a track without detections.

    All particles start in the first mode.  The error is the largest over modes and frames, in
    standard errors of a proportion of ``count`` particles.
    """
    tracker = replace(MODEL, motion=MotionModes(mode_sojourn_s=3.0), particles=count)
    track = prior_track(tracker, rng)
    particles = replace(track.particles, modes=np.zeros((1, count), dtype=np.intp))
    memory = TrackerState(0.0, 0, 2, 1e-3, replace(track, particles=particles))
    worst = 0.0
    for k in range(1, steps + 1):
        memory, _ = tracker.step(memory, [], float(k), rng)
        own = np.linalg.matrix_power(tracker.motion.mode_transition(1.0), k)[0]
        error = memory.tracks.particles.mode_probabilities(tracker.motion.count)[0] - own
        worst = max(worst, float(np.max(abs(error) / np.sqrt(own * (1.0 - own) / count))))
    return worst
