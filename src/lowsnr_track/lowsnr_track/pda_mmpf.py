"""
PDA-MMPF, Section IV-B: detections in, tracks out.

Every track is a multiple-model particle filter.  In each frame all detections in its gate,
and none of them, are weighed together by probabilistic data association, jointly with the
tracks it shares them with; the probability that the object exists follows from the same
sums, as in integrated PDA (Musicki, Evans and Stankovic 1994), and decides over birth,
confirmation and deletion.
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
from lowsnr_common.settings.config import check_settings
from lowsnr_common.settings.config import fixed
from lowsnr_common.settings.config import setting
from lowsnr_track import association
from lowsnr_track import mmpf
from lowsnr_track.detection_model import DetectionModel
from lowsnr_track.measurements import FARTHEST_M
from lowsnr_track.measurements import Measurements
from lowsnr_track.measurements import screen
from lowsnr_track.track_management import newborn
from lowsnr_track.track_management import no_tracks
from lowsnr_track.track_management import TrackLife
from lowsnr_track.track_management import Tracks
from lowsnr_track.tracker_state import TrackerOutput
from lowsnr_track.tracker_state import TrackerState
import numpy as np

_CERTAIN = 1.0 - 1e-12


@dataclass(frozen=True, kw_only=True)
class PdaMmpf:
    """Probabilistic data association with a multiple-model particle filter for each track."""

    sensor: SensorModel = fixed(SensorModel)
    motion: MotionModes = field(default_factory=MotionModes)
    detection: DetectionModel = field(default_factory=DetectionModel)
    life: TrackLife = field(default_factory=TrackLife)
    rows: int = setting(0, 'rows of a frame, 0 where not known', ge=0, le=16384)
    cols: int = setting(0, 'columns of a frame, 0 where not known', ge=0, le=16384)
    frames_per_detection: int = setting(
        1, 'frames that a detection rests on; successive ones share measurements, and count '
        'accordingly less', ge=1, le=1000)
    particles: int = setting(2000, 'particles a track', ge=10, le=1_000_000)
    resample_below: float = setting(
        0.5, 'share of the particles at or below which the effective number brings on '
        'resampling', gt=0.0, le=1.0)
    resample_power: float = setting(
        0.5, 'power of the weights by which particles are drawn; they keep the rest of it',
        gt=0.0, le=1.0)
    roughening: float = setting(
        1.8, 'scatter of resampled particles, in standard deviations of their cloud over the '
        'fourth root of their number', ge=0.0, le=10.0)

    def __post_init__(self) -> None:
        check_settings(self)

    def init(self) -> TrackerState:
        """Return the memory before the first frame."""
        return TrackerState(None, 0, 1, self.detection.clutter_density, no_tracks(self.particles))

    def restart(self, state: TrackerState) -> TrackerState:
        """
        Return the memory for a stream whose clock was set back.

        By how much is not known, so no track can be moved to the new time: all are dropped.
        Their numbers are not given again, and what was learnt of the clutter stays.
        """
        return replace(state, stamp_s=None, tracks=no_tracks(self.particles))

    def resume(self, state: TrackerState, before: PdaMmpf) -> TrackerState:
        """
        Return the memory of a tracker with other settings, to go on with these.

        Tracks stay; a clutter density that is set anew takes the place of the estimate, which
        goes on from there.
        """
        density = self.detection.clutter_density
        if density == before.detection.clutter_density:
            return state
        return replace(state, clutter=density)

    def step(
        self, state: TrackerState, detections: Sequence[Estimate], stamp_s: float,
        rng: np.random.Generator,
    ) -> tuple[TrackerState, TrackerOutput]:
        """
        Advance to a frame and its detections.

        Parameters
        ----------
        state
            Memory after the frame before.
        detections
            What was declared in this frame; only positions and scores are looked at.
        stamp_s
            Time of the frame [s].
        rng
            Source of randomness.

        Returns
        -------
        TrackerState
            Memory after this frame.
        TrackerOutput
            Tracks at this frame's time.

        Raises
        ------
        ValueError
            If the frame is not later than the one before; the memory stays as it was.

        """
        measured, refused = screen(detections, self._extent_m, self.sensor.cell_size_m)
        tracks = self._predict(state, stamp_s, rng)
        reach = self.frames_per_detection * self.sensor.cell_size_m
        noise = state.clutter / self.detection.score_ratio(measured.score)
        clutter = noise + self.detection.echoes(measured, reach)
        tracks, taken = self._update(tracks, measured, clutter)
        born, stray = self._bear(measured, taken, clutter, state.next_id, rng)
        tracks = self.life.manage(tracks.join(born) if len(born) else tracks)
        output = TrackerOutput(
            tracks.estimates(tracks.confirmed), tracks.estimates(~tracks.confirmed), refused)
        cloud = mmpf.resample(
            tracks.cloud, self.resample_below, self.resample_power, self.roughening, rng)
        density = self.detection.next_clutter(
            state.clutter, float(np.sum(stray * noise / clutter)), self.rows * self.cols,
            state.frames)
        return TrackerState(
            stamp_s, state.frames + 1, state.next_id + len(born), density,
            replace(tracks, cloud=cloud)), output

    def _predict(self, state: TrackerState, stamp_s: float, rng: np.random.Generator) -> Tracks:
        """Move every track to this frame's time; what has left the frame exists no more."""
        tracks, dt = state.tracks, _elapsed(state.stamp_s, stamp_s)
        if len(tracks) == 0 or dt > self.life.max_gap_s:
            return no_tracks(self.particles)
        # A mode may switch in every frame, whether or not the frame arrived.
        steps = max(1, round(dt / self.sensor.frame_period_s))
        cloud = mmpf.predict(tracks.cloud, self.motion, dt, steps, rng)
        survival = np.full(len(tracks), np.exp(-dt / self.life.lifetime_s))
        if self.rows and self.cols:
            log_inside = self._log_inside(cloud.states)
            if log_inside.min(initial=0.0) < 0.0:
                cloud, log_share = mmpf.update(cloud, log_inside)
                survival *= np.exp(log_share)
        return self.life.prune(
            replace(tracks, cloud=cloud, existence=tracks.existence * survival))

    def _log_inside(self, states: np.ndarray) -> np.ndarray:
        """Return 0 for particles in the frame and -inf for others, (T, N)."""
        half = self.sensor.cell_size_m / 2
        (x, y), (cols, rows) = (states[..., axis] for axis in POS), self._extent_m - half
        inside = (x >= -half) & (x < cols) & (y >= -half) & (y < rows)
        return np.where(inside, 0.0, -np.inf)

    def _update(
        self, tracks: Tracks, measured: Measurements, clutter: np.ndarray,
    ) -> tuple[Tracks, np.ndarray]:
        """
        Weigh the tracks by the detections.

        ``clutter`` (m,) is the density of false detections [1/cell] at each detection, over
        that of its score for an object.  Returns the tracks and, for each detection, the
        probability that it is of one of them.
        """
        if len(tracks) == 0:
            return tracks, np.zeros(len(measured))
        model, existence = self.detection, tracks.existence
        index = association.gate(tracks.cloud, measured, model.gate_bound, model.max_gated)
        factor = np.log(model.in_gate_probability * self.sensor.cell_size_m**2 / clutter)
        ratio = association.log_densities(tracks.cloud, measured, index)
        ratio += factor[index][..., None]
        log_likelihood, beta = association.weigh(
            tracks.cloud, existence, model.in_gate_probability, ratio, index)
        cloud, log_gain = mmpf.update(tracks.cloud, log_likelihood)
        # Note: where detections share measurements, what one repeats of the last is that there
        # is an object; their positions err independently, and silence repeats nothing.
        gain = np.exp(log_gain / np.where(log_gain > 0.0, self.frames_per_detection**0.5, 1.0))
        existence = np.minimum(existence * gain / (1.0 + existence * (gain - 1.0)), _CERTAIN)
        found = index >= 0
        taken = np.bincount(index[found], beta[found], minlength=len(measured))
        return replace(tracks, cloud=cloud, existence=existence), taken

    def _bear(
        self, measured: Measurements, taken: np.ndarray, clutter: np.ndarray, first_id: int,
        rng: np.random.Generator,
    ) -> tuple[Tracks, np.ndarray]:
        """
        Start a track from each detection that may be a new object.

        Returns the tracks and, for each detection, the probability that it is false.
        """
        odds = self.detection.probability * self.life.birth_density / clutter
        stray = np.maximum(1.0 - taken, 0.0) / (1.0 + odds)
        existence = stray * odds
        chosen = np.argsort(-existence, kind='stable')[:self.life.max_tracks]
        chosen = np.sort(chosen[existence[chosen] >= self.life.delete_probability])
        if chosen.size == 0:
            return no_tracks(self.particles), stray
        return newborn(
            measured[chosen], existence[chosen], first_id, self.motion, self.particles, rng
        ), stray

    @property
    def _extent_m(self) -> np.ndarray:
        """Columns and rows in metres, (2,); more than any frame has where not known."""
        size = np.array([self.cols, self.rows]) * self.sensor.cell_size_m
        return np.where(size > 0.0, size, FARTHEST_M)


def _elapsed(last_s: float | None, stamp_s: float) -> float:
    if not np.isfinite(stamp_s):
        raise ValueError(f'stamp {stamp_s} is not finite')
    if last_s is not None and stamp_s <= last_s:
        raise ValueError(f'stamp {stamp_s} s is not later than {last_s} s')
    return 0.0 if last_s is None else stamp_s - last_s
