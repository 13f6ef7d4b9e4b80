# SPDX-License-Identifier: Apache-2.0
"""
Trackers of Stone Soup with our settings, on detected positions.

``particle_filter`` is ``MultiTargetExpectedLikelihoodParticleFilter`` with
``MultiModelPredictor``, ``MultiModelParticleUpdater`` and ``PDA``: the same modes, Markov chain,
process noise, detection probability, clutter density, measurement noise and births.
``joint_pda`` is its usual tracker of several objects, ``JPDA`` with a Kalman filter of constant
velocity, with the first two moments of the same births.
"""

from collections.abc import Iterable
from collections.abc import Iterator
import datetime

from lowsnr_track.measurements import screen
from lowsnr_track.pda_mmpf import PdaMmpf
from lowsnr_track.tracks import start_tracks
import numpy as np
from stonesoup.base import Property
from stonesoup.dataassociator.probability import JPDA
from stonesoup.dataassociator.probability import PDA
from stonesoup.deleter.time import UpdateTimeStepsDeleter
from stonesoup.hypothesiser.probability import PDAHypothesiser
from stonesoup.initiator import Initiator
from stonesoup.initiator.simple import SimpleMeasurementInitiator
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.base import TransitionModel
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel
from stonesoup.models.transition.linear import ConstantVelocity
from stonesoup.models.transition.linear import KnownTurnRate
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.predictor.particle import MultiModelPredictor
from stonesoup.tracker.particle import MultiTargetExpectedLikelihoodParticleFilter
from stonesoup.tracker.simple import MultiTargetMixtureTracker
from stonesoup.types.array import StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.state import GaussianState
from stonesoup.types.state import MultiModelParticleState
from stonesoup.types.track import Track
from stonesoup.types.update import Update
from stonesoup.updater.kalman import KalmanUpdater
from stonesoup.updater.particle import MultiModelParticleUpdater
import tracker_model as model

START = datetime.datetime(2000, 1, 1)
# What a tracker of Stone Soup yields for each frame.
Frames = Iterable[tuple[datetime.datetime, set[Track]]]


def particle_filter(
    tracker: PdaMmpf, frames: list[np.ndarray], rng: np.random.Generator,
    kind: type = MultiTargetExpectedLikelihoodParticleFilter, silence: int = 5,
) -> Frames:
    """Return the PDA with a multi-model particle filter; ``silence`` frames delete a track."""
    motion, detection = tracker.motion, tracker.detection
    density = motion.acceleration_density
    models = [
        KnownTurnRate([density, density], np.deg2rad(rate)) if rate else constant_velocity(density)
        for rate in motion.turn_rates_deg_s]
    measurement = LinearGaussian(4, (0, 2), model.NOISE)
    predictor = MultiModelPredictor(
        models, motion.mode_transition(1.0), [[0, 1, 2, 3]] * motion.count)
    updater = MultiModelParticleUpdater(measurement, predictor)
    hypothesiser = PDAHypothesiser(
        predictor, updater, clutter_spatial_density=detection.clutter_density,
        prob_detect=detection.probability, prob_gate=detection.gate_probability)
    steps: Frames = kind(
        Birth(tracker, rng), UpdateTimeStepsDeleter(silence), arrivals(frames, measurement),
        PDA(hypothesiser), updater)
    return steps


def joint_pda(tracker: PdaMmpf, frames: list[np.ndarray], silence: int = 5) -> Frames:
    """Return the JPDA with a Kalman filter for each track."""
    motion, detection = tracker.motion, tracker.detection
    measurement = LinearGaussian(4, (0, 2), model.NOISE)
    predictor = KalmanPredictor(constant_velocity(motion.acceleration_density))
    updater = KalmanUpdater(measurement)
    hypothesiser = PDAHypothesiser(
        predictor, updater, clutter_spatial_density=detection.clutter_density,
        prob_detect=detection.probability, prob_gate=detection.gate_probability)
    # The mean square of a velocity uniform in direction, and in speed between its limits.
    low, high = motion.min_speed_mps, motion.max_speed_mps
    variance = (low**2 + low * high + high**2) / 6.0
    prior = GaussianState(np.zeros(4), np.diag([0.0, variance, 0.0, variance]))
    steps: Frames = MultiTargetMixtureTracker(
        SimpleMeasurementInitiator(prior, measurement), UpdateTimeStepsDeleter(silence),
        arrivals(frames, measurement), JPDA(hypothesiser), updater)
    return steps


def constant_velocity(density: float) -> TransitionModel:
    """Return the model of constant velocity in the plane."""
    return CombinedLinearGaussianTransitionModel([ConstantVelocity(density)] * 2)


def arrivals(
    frames: list[np.ndarray], measurement: LinearGaussian,
) -> Iterator[tuple[datetime.datetime, set[Detection]]]:
    """Yield time and detections of each frame in Stone Soup's types."""
    for k, positions in enumerate(frames):
        stamp = START + datetime.timedelta(seconds=k + 1)
        yield stamp, {
            Detection(z[:, None], timestamp=stamp, measurement_model=measurement)
            for z in positions}


class Birth(Initiator):
    """Start a track from every unassociated detection, with particles as in our tracker."""

    settings: PdaMmpf = Property(doc='tracker whose birth model is used')
    rng: np.random.Generator = Property(doc='source of randomness')

    def initiate(
        self, detections: set[Detection], timestamp: datetime.datetime, **kwargs: object,
    ) -> set[Track]:
        """Return a track for each detection."""
        return {self._track(detection, timestamp) for detection in detections}

    def _track(self, detection: Detection, timestamp: datetime.datetime) -> Track:
        position = np.asarray(detection.state_vector, dtype=float).ravel()
        measured, _ = screen([model.as_record(position)], np.full(2, np.inf), 1.0)
        count = self.settings.particles
        particles = start_tracks(
            measured, np.ones(1), 0, self.settings.motion, count, self.rng).particles
        return Track([MultiModelParticleState(
            StateVectors(particles.states[0].T), weight=np.full(count, 1.0 / count),
            dynamic_model=particles.modes[0], timestamp=timestamp)])


def mean_of(track: Track) -> np.ndarray:
    """Return the mean state of a track, (4,)."""
    return np.asarray(track.mean, dtype=float).ravel()


def updates(track: Track) -> int:
    """Return the number of frames with a detection of the track."""
    return 1 + sum(isinstance(state, Update) for state in track.states)
