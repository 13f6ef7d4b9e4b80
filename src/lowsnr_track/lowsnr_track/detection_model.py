# SPDX-License-Identifier: Apache-2.0
"""The tracker's model of the detector: missed detections, false detections and scores."""

from __future__ import annotations

from dataclasses import dataclass

from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import setting
from lowsnr_track.measurements import Measurements
import numpy as np

# The best detections, near which others may be secondary: m x 256 comparisons instead of m x m,
# so that time and memory grow in proportion to the detections m (40 MB for 10,000).
_MAX_PRIMARY = 256
# The least estimate of false detections a frame.  An estimate of zero would make any detection an
# object; this is the posterior mean of a Poisson rate after 100 frames without a false detection
# (Jeffreys' prior: 0.5 / 100).  A mean that forgets over 50 frames, the default, rests on 100.
_MIN_FALSE_PER_FRAME = 0.005
# Mean log odds of a false detection that repeats one of the frame before, and of an object's.
_REPEATED_MEAN = 1.7
_OBJECT_MEAN = 5.0


@dataclass(frozen=True, kw_only=True)
class DetectionModel:
    """Detection probability P_D, gate probability P_G and the densities of false detections."""

    probability: float = setting(
        0.9, 'detection probability P_D of an object in a frame', gt=0.0, lt=1.0, live=True)
    gate_probability: float = setting(
        0.999, "gate probability P_G, that an object's detection lies in its track's gate",
        gt=0.0, lt=1.0, live=True)
    max_gated: int = setting(
        32, 'most detections associated with a track in a frame, nearest first', ge=1, le=1000)
    clutter_density: float = setting(
        2.5e-4, 'clutter density lambda: false detections a cell and frame', gt=0.0, le=1.0,
        live=True)
    clutter_memory_frames: int = setting(
        50, 'frames over which the clutter density is estimated from detections that belong to '
        'no object; 0 keeps the given density', ge=0, le=1_000_000)
    clutter_prior_frames: int = setting(
        5, 'frames that the given clutter density counts as in its estimate', ge=0, le=1_000_000)
    secondary_density: float = setting(
        0.01, 'density of secondary detections, false ones that an object causes around itself, '
        'a cell and frame: near a detection with a better score, within as many cells as a '
        'detection rests on frames', ge=0.0, le=1.0, live=True)
    repeated: float = setting(
        0.3, 'probability that a false detection which rests on several frames is repeated in '
        'the next frame; half of it a frame later', ge=0.0, lt=1.0, live=True)
    resolution: float = setting(
        0.0, 'resolution: cells along each axis within which the detector declares two objects '
        'once, so that tracks as near may share a detection; 0 for never', ge=0.0)
    use_scores: bool = setting(
        True, 'whether a detection counts more the better its score is')
    score_limit: float = setting(
        10.0, 'log odds above which a score counts no more [nat]', gt=0.0, le=36.0)

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def in_gate_probability(self) -> float:
        """P_D P_G, the probability that an object is detected inside its gate."""
        return self.probability * self.gate_probability

    @property
    def gate_bound(self) -> float:
        """Squared error [variances] of a detection that P_G allows for, chi-square of two."""
        return float(-2.0 * np.log1p(-self.gate_probability))

    def score_ratio(self, score: np.ndarray) -> np.ndarray:
        """
        Return the likelihood ratio of each score, "of an object" against "of noise".

        Above a detector's threshold the log odds x of noise are distributed as ``exp(-x)``, so
        that the ratio is in proportion to the odds ``exp(x)``.  Limited at L they have the mean
        ``1 + L`` over noise, and the ratio, whose mean over noise is one, is
        ``exp(min(x, L)) / (1 + L)``.

        Parameters
        ----------
        score : (m,) ndarray
            Probabilities that the detector states, 1/2 at its threshold.

        Returns
        -------
        (m,) ndarray
            Likelihood ratios; one where scores are not used.

        """
        if not self.use_scores:
            return np.ones(len(score))
        odds: np.ndarray = np.exp(np.minimum(self.log_odds(score), self.score_limit))
        return odds / (1.0 + self.score_limit)

    def repetition(self, score: np.ndarray) -> np.ndarray:
        """
        Return the likelihood ratio of each detection, "repeated" against "of an object".

        Repeated false detections have better scores than others: on white noise their log odds
        are exponential with a mean of 1.7, where those of others have a mean of one [nat].  Those
        of an object of unknown brightness are taken as exponential with a mean of 5.

        Parameters
        ----------
        score : (m,) ndarray
            Probabilities that the detector states, 1/2 at its threshold.

        Returns
        -------
        (m,) ndarray
            ``p(x | repeated) / (P_D P_G p(x | object))``.

        """
        if not self.use_scores:
            return np.full(len(score), 1.0 / self.in_gate_probability)
        falls = 1.0 / _REPEATED_MEAN - 1.0 / _OBJECT_MEAN
        ratio: np.ndarray = _OBJECT_MEAN / _REPEATED_MEAN * np.exp(-falls * self.log_odds(score))
        return ratio / self.in_gate_probability

    def log_odds(self, score: np.ndarray) -> np.ndarray:
        """Return the log odds of scores above the threshold, from 0 to 36 nat."""
        with np.errstate(divide='ignore'):
            log_odds = np.log(score) - np.log1p(-score)
        clipped: np.ndarray = np.clip(log_odds, 0.0, 36.0)
        return clipped

    def secondary(self, measured: Measurements, reach_m: float) -> np.ndarray:
        """
        Return the density of secondary detections: false ones that objects cause.

        A path that holds some frames of an object and some of noise may be declared as well, a
        few cells away from the object and with a lower score.  A detection near one with a
        better score may therefore be secondary.

        Parameters
        ----------
        measured
            Detections (m,).
        reach_m
            Distance along either axis up to which there are secondary detections [m].

        Returns
        -------
        (m,) ndarray
            Density [1/cell] at each detection.

        """
        if not self.use_scores or len(measured) < 2:
            return np.zeros(len(measured))
        primary = np.argsort(-measured.score, kind='stable')[:_MAX_PRIMARY]
        offset = abs(measured.position[:, None] - measured.position[primary])
        better = measured.score[:, None] < measured.score[primary]
        near = (offset[..., 0] <= reach_m) & (offset[..., 1] <= reach_m)
        possible: np.ndarray = (near & better).any(axis=1)
        return self.secondary_density * possible

    def estimated_clutter(
        self, density: float, false_count: float, cells: int, frames: int,
    ) -> float:
        """
        Return the clutter density after a frame.

        At first it is the posterior mean of a Poisson rate whose gamma prior is worth
        ``clutter_prior_frames``, then a mean that forgets.

        Parameters
        ----------
        density
            Clutter density before the frame [1/cell].
        false_count
            Expected number of the frame's detections that are clutter.
        cells
            Cells of a frame; 0 for an unknown size, which keeps the density.
        frames
            Frames before this one.

        """
        if self.clutter_memory_frames == 0 or cells == 0:
            return density
        past = min(self.clutter_prior_frames + frames, self.clutter_memory_frames)
        gain = 1.0 / (1.0 + past)
        return max(density + gain * (false_count / cells - density), _MIN_FALSE_PER_FRAME / cells)
