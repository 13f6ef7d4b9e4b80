# SPDX-License-Identifier: Apache-2.0
"""
PDA-MMPF, the tracker of Section IV-B: detections in, tracks out.

Every track is a multiple-model particle filter (MMPF) whose particles are weighted by
probabilistic data association (PDA): the hypotheses "no detection in the gate is the object's"
and "detection j is" are mixed, and the particles are resampled once, after mixing.  Tracks whose
gates share detections are associated jointly.  The existence probability ``P(chi_k | Z^k)`` of
each track follows from the same sums, as in integrated PDA (Musicki, Evans and Stankovic 1994),
and decides over birth, confirmation and deletion.  :meth:`PdaMmpf.step` is the algorithm;
:mod:`lowsnr_track.data_association.association` has the formula of the association probabilities.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace
import functools

from lowsnr_common.core.bound_motion import Destinations
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.records import Estimate
from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import fixed
from lowsnr_common.settings.declare import setting
from lowsnr_track import mmpf
from lowsnr_track.data_association import association
from lowsnr_track.data_association import unresolved
from lowsnr_track.data_association.candidates import candidates
from lowsnr_track.detection_model import DetectionModel
from lowsnr_track.detector_memory import detector_memory
from lowsnr_track.detector_memory import weigh_endings
from lowsnr_track.evidence import frame_evidence
from lowsnr_track.existence import update
from lowsnr_track.existence import update_from_posterior
from lowsnr_track.measurements import FARTHEST_M
from lowsnr_track.measurements import Measurements
from lowsnr_track.measurements import screen
from lowsnr_track.track_management import TrackLife
from lowsnr_track.tracks import MAX_EXISTENCE
from lowsnr_track.tracks import no_tracks
from lowsnr_track.tracks import start_tracks
from lowsnr_track.tracks import TrackerOutput
from lowsnr_track.tracks import TrackerState
from lowsnr_track.tracks import Tracks
import numpy as np


@dataclass(frozen=True, kw_only=True)
class PdaMmpf:
    """Probabilistic data association with a multiple-model particle filter for each track."""

    sensor: SensorModel = fixed(SensorModel)
    motion: MotionModes = field(default_factory=MotionModes)
    destinations: Destinations = field(default_factory=Destinations)
    detection: DetectionModel = field(default_factory=DetectionModel)
    life: TrackLife = field(default_factory=TrackLife)
    rows: int = setting(0, 'rows of a frame, 0 for unknown', ge=0, le=16384)
    cols: int = setting(0, 'columns of a frame, 0 for unknown', ge=0, le=16384)
    frames_per_detection: int = setting(
        1, 'frames that a detection rests on; successive detections share frames, and count '
        'accordingly less', ge=1, le=1000)
    particles: int = setting(2000, 'particles a track', ge=10, le=1_000_000)
    resample_below: float = setting(
        0.5, 'effective number of particles, as a fraction of all, at or below which a track is '
        'resampled', gt=0.0, le=1.0)
    resample_power: float = setting(
        0.5, 'power of the weights by which particles are drawn; they keep the rest of it',
        gt=0.0, le=1.0)
    roughening: float = setting(
        1.8, 'noise added to resampled particles, in standard deviations of the particles over '
        'the fourth root of their number', ge=0.0, le=10.0)

    def __post_init__(self) -> None:
        check_settings(self)
        self.destinations.check_motion(self.motion)

    def init(self) -> TrackerState:
        """Return the state before the first frame."""
        return TrackerState(None, 0, 1, self.detection.clutter_density, self._no_tracks)

    def restart(self, state: TrackerState) -> TrackerState:
        """
        Return the state for a stream whose clock was set back, or that shows another scene.

        All tracks are deleted, since the time step is unknown, and frames are counted anew.
        Numbers of tracks are not used again, and the estimate of the clutter density stays.
        """
        return replace(state, stamp_s=None, first_s=None, tracks=self._no_tracks)

    def resume(self, state: TrackerState, before: PdaMmpf) -> TrackerState:
        """
        Return the state of a tracker with other settings, for these to continue.

        Tracks stay.  The estimate continues from a new value of the clutter density.
        """
        density = self.detection.clutter_density
        if density == before.detection.clutter_density:
            return state
        return replace(state, clutter_density=density)

    def step(
        self, state: TrackerState, detections: Sequence[Estimate], stamp_s: float,
        rng: np.random.Generator,
    ) -> tuple[TrackerState, TrackerOutput]:
        """
        Advance to a frame and its detections.

        Parameters
        ----------
        state
            State after the frame before.
        detections
            Declarations of this frame; positions, scores and predictions are used.
        stamp_s
            Time of the frame [s].
        rng
            Source of randomness.

        Returns
        -------
        TrackerState
            State after this frame.
        TrackerOutput
            Tracks at the time of this frame.

        Raises
        ------
        ValueError
            If the frame is not later than the one before.

        """
        measured, rejected = screen(detections, self._extent_m, self.sensor.cell_size_m)
        # Prediction: modes switch first, then states move.
        tracks = self._predict(state, stamp_s, rng)
        # Gate, and the density lambda_j of false detections at each detection: clutter, over the
        # likelihood ratio of the score, and secondary detections.
        model, reach = self.detection, self.frames_per_detection * self.sensor.cell_size_m
        gated = association.gate(tracks.particles, measured, model.gate_bound, model.max_gated)
        clutter = state.clutter_density / model.score_ratio(measured.score)
        density = clutter + model.secondary(measured, reach)
        # Association probabilities beta_tj, and the update of weights and existence.
        posteriors = measured.predicted is not None if len(measured) else state.posteriors
        tracks, share = self._associate(tracks, measured, density, gated, posteriors)
        # Births from detections of no track; merging, deletion and confirmation.
        births, false = self._births(
            measured, association.sum_over_tracks(share, gated, len(measured)), density,
            state.next_id, rng)
        tracks, kept = self.life.manage(tracks.join(births))
        output = tracks.output(kept, rejected)
        # One resampling, after mixing.
        particles = mmpf.resample(
            tracks.particles, self.resample_below, self.resample_power, self.roughening, rng,
            kept)
        return TrackerState(
            stamp_s, state.frames + 1, state.next_id + len(births), model.estimated_clutter(
                state.clutter_density, float(np.sum(false * clutter / density)),
                self.rows * self.cols, state.frames),
            tracks.picked(kept, particles), posteriors,
            stamp_s if state.first_s is None else state.first_s), output

    def _predict(self, state: TrackerState, stamp_s: float, rng: np.random.Generator) -> Tracks:
        """Predict every track; an object outside the frame does not exist."""
        tracks, dt = state.tracks, state.elapsed_s(stamp_s)
        if len(tracks) == 0 or dt > self.life.max_gap_s:
            return self._no_tracks
        # A mode may switch in every frame period, whether or not its frame arrived.
        period_s, bound = self.sensor.frame_period_s, tracks.particles.bound
        steps = max(1, round(dt / period_s))
        left_s = bound.left_s(state.frame(period_s), period_s) if bound else None
        particles = mmpf.predict(tracks.particles, self.motion, dt, steps, rng, left_s)
        survival = np.full(len(tracks), np.exp(-dt / self.life.lifetime_s))
        if self.rows and self.cols:
            half = self.sensor.cell_size_m / 2
            particles, fraction = mmpf.inside(
                particles, np.full(2, -half), self._extent_m - half)
            survival *= fraction
        tracks = replace(tracks.aged(survival, steps), particles=particles)
        if state.posteriors:  # such a detector declares nothing that has ended
            tracks = replace(tracks, ended=np.zeros_like(tracks.ended))
        return self.life.prune(tracks)

    def _associate(
        self, tracks: Tracks, measured: Measurements, density: np.ndarray, gated: np.ndarray,
        posteriors: bool,
    ) -> tuple[Tracks, np.ndarray]:
        """Return the updated tracks, and beta_tj (T, G) over the tracks that share j."""
        if len(tracks) == 0:
            return tracks, np.zeros(gated.shape)
        model, detected = self.detection, self.detection.in_gate_probability
        scale = (detected * self.sensor.cell_size_m**2 / density)[gated]
        if posteriors:
            ratio, mean = association.likelihood_ratios(tracks.particles, measured, scale, gated)
            _, beta = association.associate(
                tracks.existence, np.full(len(tracks), detected), ratio, mean, gated)
            return update_from_posterior(tracks, frame_evidence(measured).mixed(
                tracks, detected, ratio, beta, gated)), beta
        snr = 10.0 ** (self.sensor.snr_db / 10.0)
        endings = weigh_endings(
            model, detector_memory(model.probability, self.frames_per_detection, snr),
            tracks, measured.score, gated)
        found = unresolved.associate(candidates(
            tracks.particles, measured, tracks.followed, endings.detected, scale * endings.ratio,
            gated), model.resolution * self.sensor.cell_size_m)
        return update(tracks, found.log_ratio, found.beta, endings, self._repeated), found.share

    def _births(
        self, measured: Measurements, tracked: np.ndarray, density: np.ndarray, first_id: int,
        rng: np.random.Generator,
    ) -> tuple[Tracks, np.ndarray]:
        """
        Start tracks from detections that may be of a new object.

        A detection is of no track with probability ``1 - tracked``, and then false, or of a new
        object at odds of P_D times the birth density over lambda_j; of a detector with a
        posterior, at the odds that it states.  Returns the tracks, and the probability (m,) that
        each detection is false.
        """
        if len(measured) == 0:
            return self._no_tracks, np.empty(0)
        odds = self.detection.probability * self.life.birth_density / density
        if measured.predicted is not None:
            prob = np.minimum(measured.score, MAX_EXISTENCE)
            odds = prob / (1.0 - prob)
        false = np.maximum(1.0 - tracked, 0.0) / (1.0 + odds)
        born = self.life.born(false * odds)
        if born.size == 0:
            return self._no_tracks, false
        return start_tracks(
            measured[born], (false * odds)[born], first_id, self.motion, self.particles, rng,
            self.frames_per_detection, self._repeated, self.destinations.densities), false

    @property
    def _no_tracks(self) -> Tracks:
        return no_tracks(self.particles, self.frames_per_detection)

    @property
    def _repeated(self) -> float:
        """Probability that a false detection is repeated; 0 of one that rests on one frame."""
        return self.detection.repeated if self.frames_per_detection > 1 else 0.0

    @functools.cached_property
    def _extent_m(self) -> np.ndarray:
        """Columns and rows in metres, (2,); FARTHEST_M where unknown."""
        size = np.array([self.cols, self.rows]) * self.sensor.cell_size_m
        return np.where(size > 0.0, size, FARTHEST_M)
