"""
PDA-MMPF, the tracker of Section IV-B: detections in, tracks out.

Every track is a multiple-model particle filter (MMPF) whose particles are weighted by
probabilistic data association (PDA): the hypotheses "no detection in the gate is the object's"
and "detection j is" are mixed, and the particles are resampled once, after mixing.  Tracks whose
gates share detections are associated jointly.  The existence probability ``P(chi_k | Z^k)`` of
each track follows from the same sums, as in integrated PDA (Musicki, Evans and Stankovic 1994),
and decides over birth, confirmation and deletion.  :meth:`PdaMmpf.step` is the algorithm;
:mod:`lowsnr_track.association` has the formula of the association probabilities.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.records import Estimate
from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import fixed
from lowsnr_common.settings.declare import setting
from lowsnr_track import association
from lowsnr_track import mmpf
from lowsnr_track.detection_model import DetectionModel
from lowsnr_track.measurements import FARTHEST_M
from lowsnr_track.measurements import Measurements
from lowsnr_track.measurements import screen
from lowsnr_track.track_management import TrackLife
from lowsnr_track.tracks import no_tracks
from lowsnr_track.tracks import TrackerOutput
from lowsnr_track.tracks import TrackerState
from lowsnr_track.tracks import Tracks
import numpy as np

# The largest existence probability; beyond it 1 - P would lose its last digits.
_MAX_EXISTENCE = 1.0 - 1e-12


@dataclass(frozen=True, kw_only=True)
class PdaMmpf:
    """Probabilistic data association with a multiple-model particle filter for each track."""

    sensor: SensorModel = fixed(SensorModel)
    motion: MotionModes = field(default_factory=MotionModes)
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

    def init(self) -> TrackerState:
        """Return the state before the first frame."""
        return TrackerState(None, 0, 1, self.detection.clutter_density, no_tracks(self.particles))

    def restart(self, state: TrackerState) -> TrackerState:
        """
        Return the state for a stream whose clock was set back, or that shows another scene.

        No track can be predicted, since the time step is unknown: all are deleted.  Their
        numbers are not used again, and the estimate of the clutter density stays.
        """
        return replace(state, stamp_s=None, tracks=no_tracks(self.particles))

    def resume(self, state: TrackerState, before: PdaMmpf) -> TrackerState:
        """
        Return the state of a tracker with other settings, for these to continue.

        Tracks stay.  A new value of the clutter density replaces the estimate, which continues
        from it.
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
            Declarations of this frame; only positions and scores are used.
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
        # Association probabilities beta_tj, and the sum over them for each particle.
        log_ratio, beta = association.associate(
            tracks.particles, tracks.existence, model.in_gate_probability,
            self._log_ratios(tracks, measured, density, gated), gated)
        # Update of weights and existence.
        tracks = self._update(tracks, log_ratio)
        # Births from detections of no track; merging, deletion and confirmation.
        births, false = self._births(
            measured, association.sum_over_tracks(beta, gated, len(measured)), density,
            state.next_id, rng)
        tracks = self.life.manage(tracks.join(births))
        output = TrackerOutput(
            tracks.estimates(tracks.confirmed), tracks.estimates(~tracks.confirmed), rejected)
        # One resampling, after mixing.
        particles = mmpf.resample(
            tracks.particles, self.resample_below, self.resample_power, self.roughening, rng)
        return TrackerState(
            stamp_s, state.frames + 1, state.next_id + len(births), model.estimated_clutter(
                state.clutter_density, float(np.sum(false * clutter / density)),
                self.rows * self.cols, state.frames),
            replace(tracks, particles=particles)), output

    def _predict(self, state: TrackerState, stamp_s: float, rng: np.random.Generator) -> Tracks:
        """Predict every track; an object outside the frame does not exist."""
        tracks, dt = state.tracks, _elapsed(state.stamp_s, stamp_s)
        if len(tracks) == 0 or dt > self.life.max_gap_s:
            return no_tracks(self.particles)
        # A mode may switch in every frame period, whether or not its frame arrived.
        steps = max(1, round(dt / self.sensor.frame_period_s))
        particles = mmpf.predict(tracks.particles, self.motion, dt, steps, rng)
        survival = np.full(len(tracks), np.exp(-dt / self.life.lifetime_s))
        if self.rows and self.cols:
            log_inside = self._log_inside(particles.states)
            if log_inside.min(initial=0.0) < 0.0:
                particles, log_fraction = mmpf.update(particles, log_inside)
                survival *= np.exp(log_fraction)
        return self.life.prune(
            replace(tracks, particles=particles, existence=tracks.existence * survival))

    def _log_inside(self, states: np.ndarray) -> np.ndarray:
        """Return 0 for particles in the frame and -inf for others, (T, N)."""
        half = self.sensor.cell_size_m / 2
        (x, y), (cols, rows) = (states[..., axis] for axis in POS), self._extent_m - half
        inside = (x >= -half) & (x < cols) & (y >= -half) & (y < rows)
        return np.where(inside, 0.0, -np.inf)

    def _log_ratios(
        self, tracks: Tracks, measured: Measurements, density: np.ndarray, gated: np.ndarray,
    ) -> np.ndarray:
        """Return log L_tj(x_n) = log(P_D P_G N(z_j; H x_n, R_j) / lambda_j), (T, G, N)."""
        cell_m2 = self.sensor.cell_size_m**2  # lambda_j is a density in cells, N in metres
        factor = np.log(self.detection.in_gate_probability * cell_m2 / density)
        log_ratio = association.log_likelihoods(tracks.particles, measured, gated)
        log_ratio += factor[gated][..., None]
        return log_ratio

    def _update(self, tracks: Tracks, log_ratio: np.ndarray) -> Tracks:
        """
        Multiply the weights by the likelihood ratios (T, N), and update P(chi_k | Z^k).

        With the predicted pi and the mean likelihood ratio g it is ``pi g / (1 - pi + pi g)``.

        Note: detections that share frames repeat that there is an object, so that log g, where it
        is positive, is divided by the square root of ``frames_per_detection``.  The errors of
        their positions are independent, and a missed detection repeats nothing.
        """
        particles, log_gain = mmpf.update(tracks.particles, log_ratio)
        gain = np.exp(log_gain / np.where(log_gain > 0.0, self.frames_per_detection**0.5, 1.0))
        existence = tracks.existence * gain / (1.0 + tracks.existence * (gain - 1.0))
        return replace(
            tracks, particles=particles, existence=np.minimum(existence, _MAX_EXISTENCE))

    def _births(
        self, measured: Measurements, tracked: np.ndarray, density: np.ndarray, first_id: int,
        rng: np.random.Generator,
    ) -> tuple[Tracks, np.ndarray]:
        """
        Start tracks from detections that may be of a new object.

        A detection is of no track with probability ``1 - tracked``, and then false, or of a new
        object at odds of P_D times the birth density over lambda_j.  Returns the tracks, and
        the probability (m,) that each detection is false.
        """
        odds = self.detection.probability * self.life.birth_density / density
        false = np.maximum(1.0 - tracked, 0.0) / (1.0 + odds)
        births = self.life.births(
            measured, false * odds, first_id, self.motion, self.particles, rng)
        return births, false

    @property
    def _extent_m(self) -> np.ndarray:
        """Columns and rows in metres, (2,); FARTHEST_M where unknown."""
        size = np.array([self.cols, self.rows]) * self.sensor.cell_size_m
        return np.where(size > 0.0, size, FARTHEST_M)


def _elapsed(last_s: float | None, stamp_s: float) -> float:
    if not np.isfinite(stamp_s):
        raise ValueError(f'stamp {stamp_s} is not finite')
    if last_s is not None and stamp_s <= last_s:
        raise ValueError(f'stamp {stamp_s} s is not later than {last_s} s')
    return 0.0 if last_s is None else stamp_s - last_s
