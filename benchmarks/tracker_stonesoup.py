# SPDX-License-Identifier: Apache-2.0
"""
Compare the tracker with Stone Soup's PDA and multi-model particle filter.

Both get the same detections and the same model: modes, Markov chain, process noise, detection
probability, clutter density, measurement noise and births.  Stone Soup runs
``MultiTargetExpectedLikelihoodParticleFilter`` with ``MultiModelPredictor``,
``MultiModelParticleUpdater`` and ``PDA``.  It estimates no existence probability: its tracks count
as confirmed from their n-th frame with a detection, for several n, and are deleted after five
frames without one.

Where several tracks hit an object, the error is that of the oldest, because the nearest of many
would be near by chance.  A second comparison runs the filters alone, on one track that neither
deletes.
"""

from collections.abc import Iterable
from collections.abc import Iterator
from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace
import datetime
from pathlib import Path
import time
from typing import Any

from lowsnr_common.core.motion import POS
from lowsnr_sensor.scenario import load_scenario
from lowsnr_track.detection_model import DetectionModel
from lowsnr_track.measurements import screen
from lowsnr_track.pda_mmpf import PdaMmpf
from lowsnr_track.tracks import start_tracks
import numpy as np
from stonesoup.base import Property
from stonesoup.dataassociator.probability import PDA
from stonesoup.deleter.time import UpdateTimeStepsDeleter
from stonesoup.hypothesiser.probability import PDAHypothesiser
from stonesoup.initiator import Initiator
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel
from stonesoup.models.transition.linear import ConstantVelocity
from stonesoup.models.transition.linear import KnownTurnRate
from stonesoup.predictor.particle import MultiModelPredictor
from stonesoup.tracker.particle import MultiTargetExpectedLikelihoodParticleFilter
from stonesoup.tracker.particle import SingleTargetExpectedLikelihoodParticleFilter
from stonesoup.types.array import StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.state import MultiModelParticleState
from stonesoup.types.track import Track
from stonesoup.types.update import Update
from stonesoup.updater.particle import MultiModelParticleUpdater
import tracker_model as model

SCENARIO = Path(__file__).resolve().parents[1] / 'config' / 'scenarios' / 'random.yaml'
GATE_M = 1.5
CLUTTER = 0.5 / 400  # half a false detection a frame
CONFIRMED_AFTER = (2, 3, 4, 5)
START = datetime.datetime(2000, 1, 1)


@dataclass
class Score:
    """Error of the oldest track that hits, NaN for none, in each frame; number of false tracks."""

    away: list[float] = field(default_factory=list)
    nearest: list[float] = field(default_factory=list)
    false: int = 0
    present: int = 0

    def add(self, truth: np.ndarray | None, tracks: list[np.ndarray]) -> None:
        """Score the positions of the tracks of one frame, oldest first."""
        away = [] if truth is None else [float(np.hypot(*(track - truth))) for track in tracks]
        hits = [distance for distance in away if distance <= GATE_M]
        self.away.append(hits[0] if hits else np.nan)
        self.nearest.append(min(hits, default=np.nan))
        self.false += len(tracks) - bool(hits)
        self.present += truth is not None

    def figures(self, other: 'Score') -> dict[str, float]:
        """Return P_D, false tracks a frame, and RMSE over frames that both hit."""
        both = np.isfinite(self.away) & np.isfinite(other.away)
        rmse, nearest = (
            float(np.sqrt(np.mean(np.array(away)[both]**2)))
            for away in (self.away, self.nearest))
        return {
            'pd': float(np.isfinite(self.away).sum() / self.present),
            'false_tracks': self.false / len(self.away), 'rmse_m': rmse,
            'rmse_nearest_m': nearest}


def compare(runs: int, seed: int, particles: int) -> dict[str, Any]:
    """Run both on the same detections, frame by frame in turn; times are CPU milliseconds."""
    tracker = PdaMmpf(
        particles=particles, rows=20, cols=20, detection=DetectionModel(
            clutter_density=CLUTTER, clutter_memory_frames=0, use_scores=False))
    ours, theirs = Score(), {count: Score() for count in CONFIRMED_AFTER}
    times = np.array([
        pair for run in range(runs)
        for pair in race(tracker, np.random.default_rng([seed, 4, run]), ours, theirs)])
    medians, means = np.median(times, axis=0), np.mean(times, axis=0)
    return {
        'runs': runs, 'particles': particles, 'confirmed_after': {
            str(count): {'ours': ours.figures(score), 'stone_soup': score.figures(ours)}
            for count, score in theirs.items()},
        'median_ms': medians.tolist(), 'mean_ms': means.tolist(),
        'median_ratio': float(medians[1] / medians[0]), 'mean_ratio': float(means[1] / means[0])}


def race(
    tracker: PdaMmpf, rng: np.random.Generator, ours: Score, theirs: dict[int, Score],
) -> Iterator[tuple[float, float]]:
    """Run one scene and score it; yield the CPU milliseconds of both in each frame."""
    np.random.seed(rng.integers(2**31))  # noqa: NPY002  (Stone Soup draws from it)
    truth, frames = scene(tracker, rng)
    other, memory = iter(stone_soup(tracker, frames, rng)), tracker.init()
    birth: dict[str, int] = {}
    for k, (position, detections) in enumerate(zip(truth, frames)):
        start = time.process_time()
        records = [model.as_record(z) for z in detections]
        memory, output = tracker.step(memory, records, k + 1.0, rng)
        middle = time.process_time()
        _, tracks = next(other)
        yield 1e3 * (middle - start), 1e3 * (time.process_time() - middle)
        ours.add(position, [item.state[POS] for item in output.confirmed])
        for track in tracks:
            birth.setdefault(track.id, len(birth))
        for count, score in theirs.items():
            chosen = [track for track in tracks if updates(track) >= count]
            chosen.sort(key=lambda track: birth[track.id])
            score.add(position, [mean_of(track)[POS] for track in chosen])


def compare_alone(runs: int, seed: int, particles: int) -> dict[str, Any]:
    """Run both filters on one track, born from the object's first detection."""
    tracker = replace(model.MODEL, particles=particles)
    ours, theirs = [], []
    for run in range(runs):
        rng = np.random.default_rng([seed, 8, run])
        np.random.seed(rng.integers(2**31))  # noqa: NPY002
        states, frames = model.simulate(tracker, 20, True, rng)
        ours.append(model.follow(tracker, states, frames, True, rng).error)
        other = stone_soup(
            tracker, frames, rng, SingleTargetExpectedLikelihoodParticleFilter, 10**6)
        means = [mean_of(next(iter(tracks))) for _, tracks in other]
        theirs.append(states - np.array(means))
    found: dict[str, Any] = {'runs': runs, 'particles': particles}
    for name, axes in (('position', [0, 2]), ('velocity', [1, 3])):
        squared = np.array([[np.sum(error[:, axes]**2) for error in part]
                            for part in (ours, theirs)])
        rng = np.random.default_rng([seed, 9])
        draws = squared[:, rng.integers(runs, size=(1000, runs))].sum(axis=-1)
        low, high = np.quantile(np.sqrt(draws[0] / draws[1]), [0.025, 0.975])
        rmse = np.sqrt(squared.mean(axis=1) / len(states))
        found[name] = {
            'ours': float(rmse[0]), 'stone_soup': float(rmse[1]),
            'ratio': (float(rmse[0] / rmse[1]), float(low), float(high))}
    return found


def scene(
    tracker: PdaMmpf, rng: np.random.Generator,
) -> tuple[list[np.ndarray | None], list[np.ndarray]]:
    """Return position (or None) and detections (m, 2) of each frame of a random object."""
    truth: list[np.ndarray | None] = []
    frames = []
    for present in load_scenario(SCENARIO).truth(1.0, 1.0, rng):
        position = present[0].state[POS] if present else None
        found = rng.uniform(-0.5, 19.5, (rng.poisson(400 * CLUTTER), 2))
        if position is not None and rng.random() < tracker.detection.probability:
            seen = position + np.sqrt(model.VARIANCE) * rng.standard_normal(2)
            found = np.concatenate([found, seen[None]])
        truth.append(position)
        frames.append(np.clip(found, -0.5, 19.499))
    return truth, frames


def stone_soup(
    tracker: PdaMmpf, frames: list[np.ndarray], rng: np.random.Generator,
    kind: type = MultiTargetExpectedLikelihoodParticleFilter, silence: int = 5,
) -> Iterable[tuple[datetime.datetime, set[Track]]]:
    """Return Stone Soup's tracker with our settings; ``silence`` frames delete a track."""
    motion, detection = tracker.motion, tracker.detection
    density = motion.acceleration_density
    models = [
        KnownTurnRate([density, density], np.deg2rad(rate)) if rate else
        CombinedLinearGaussianTransitionModel([ConstantVelocity(density)] * 2)
        for rate in motion.turn_rates_deg_s]
    measurement = LinearGaussian(4, (0, 2), model.NOISE)
    predictor = MultiModelPredictor(
        models, motion.mode_transition(1.0), [[0, 1, 2, 3]] * motion.count)
    updater = MultiModelParticleUpdater(measurement, predictor)
    hypothesiser = PDAHypothesiser(
        predictor, updater, clutter_spatial_density=detection.clutter_density,
        prob_detect=detection.probability, prob_gate=detection.gate_probability)
    steps: Iterable[tuple[datetime.datetime, set[Track]]] = kind(
        Birth(tracker, rng), UpdateTimeStepsDeleter(silence), arrivals(frames, measurement),
        PDA(hypothesiser), updater)
    return steps


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
