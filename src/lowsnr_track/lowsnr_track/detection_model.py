"""What the tracker takes the detector to do: miss, invent and repeat, and how scores count."""

from __future__ import annotations

from dataclasses import dataclass

from lowsnr_common.settings.config import check_settings
from lowsnr_common.settings.config import setting
from lowsnr_track.measurements import Measurements
import numpy as np

# How many frames the clutter density given counts as, where it is estimated.
_PRIOR_FRAMES = 5
# Detections, best first, that others may be echoes of.
_MOST_SOURCES = 256
# The least number of false detections a frame that an estimate comes to.
_LEAST_CLUTTER = 0.005


@dataclass(frozen=True, kw_only=True)
class DetectionModel:
    """Probabilities of detection and of false detections."""

    probability: float = setting(
        0.8, 'probability that an object is detected in a frame', gt=0.0, lt=1.0, live=True)
    gate_probability: float = setting(
        0.999, "probability that an object's detection falls into its track's gate",
        gt=0.0, lt=1.0, live=True)
    max_gated: int = setting(
        32, 'most detections weighed for a track, nearest first', ge=1, le=1000)
    clutter_density: float = setting(
        2.5e-4, 'false detections a cell and frame', gt=0.0, le=1.0, live=True)
    clutter_memory_frames: int = setting(
        50, 'frames over which the clutter density is estimated from detections that no track '
        'explains; 0 takes it as given', ge=0, le=1_000_000)
    echo_density: float = setting(
        0.01, 'further false detections a cell and frame next to a better one, within as many '
        'cells as a detection rests on frames', ge=0.0, le=1.0, live=True)
    use_scores: bool = setting(True, 'whether a better score makes a detection count more')
    score_limit: float = setting(
        10.0, 'log odds above which a score counts no more [nat]', gt=0.0, le=36.0)

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def in_gate_probability(self) -> float:
        """Probability that an object is detected, and in its gate."""
        return self.probability * self.gate_probability

    @property
    def gate_bound(self) -> float:
        """Largest squared error of a detection in the gate, chi-square of two dimensions."""
        return -2.0 * np.log1p(-self.gate_probability)

    def score_ratio(self, score: np.ndarray) -> np.ndarray:
        """
        Return how much likelier each score is of an object than of noise.

        The log ratio of noise falls off exponentially above a threshold, one nat a nat, so
        that the ratio is in proportion to the odds of the score; over noise its mean is one.

        Parameters
        ----------
        score : (m,) ndarray
            Probabilities as the detector has them, 1/2 at its threshold.

        Returns
        -------
        (m,) ndarray
            Likelihood ratios; one where scores are not used.

        """
        if not self.use_scores:
            return np.ones(len(score))
        with np.errstate(divide='ignore'):
            odds = np.log(score) - np.log1p(-score)
        return np.exp(np.clip(odds, 0.0, self.score_limit)) / (1.0 + self.score_limit)

    def echoes(self, measured: Measurements, reach_m: float) -> np.ndarray:
        """
        Return the density of false detections that objects cause around them.

        A path that holds some frames of an object and some of noise may be declared, too, a
        few cells away from the object and with a lower score.  So a detection with a better
        one near it may be an echo.

        Parameters
        ----------
        measured
            Detections (m,).
        reach_m
            Distance along either axis up to which there are echoes [m].

        Returns
        -------
        (m,) ndarray
            Density [1/cell] at each detection.

        """
        if not self.use_scores or len(measured) < 2:
            return np.zeros(len(measured))
        best = np.argsort(-measured.score, kind='stable')[:_MOST_SOURCES]
        offset = abs(measured.position[:, None] - measured.position[best])
        better = measured.score[:, None] < measured.score[best]
        near = (offset[..., 0] <= reach_m) & (offset[..., 1] <= reach_m)
        return self.echo_density * (near & better).any(axis=1)

    def next_clutter(self, clutter: float, stray: float, cells: int, frames: int) -> float:
        """
        Return the clutter density after a frame: a mean that forgets.

        Parameters
        ----------
        clutter
            Density before the frame [1/cell].
        stray
            Expected number of detections in the frame that are no object's.
        cells
            Cells of a frame; 0 where not known, which leaves the density as it is.
        frames
            Frames before this one.

        """
        if self.clutter_memory_frames == 0 or cells == 0:
            return clutter
        share = 1.0 / (1.0 + min(_PRIOR_FRAMES + frames, self.clutter_memory_frames))
        return max(clutter + share * (stray / cells - clutter), _LEAST_CLUTTER / cells)
