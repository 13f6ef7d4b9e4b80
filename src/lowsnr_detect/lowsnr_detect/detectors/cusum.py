"""
CUSUM: Page's test, the sequential test for a start that is not known, along every path.

It is what SDT becomes without truncation: one plane holds, for every cell, the largest sum of
log ratios of any path that ends there and of any start, and a sum below zero starts anew.  The
log probability of each move counts against the many paths there are (Page 1954; the maximum
over paths is that of the Viterbi algorithm).
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace
from typing import ClassVar

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.settings.config import check_settings
from lowsnr_common.settings.config import setting
from lowsnr_detect.parts.bands import in_bands
from lowsnr_detect.parts.centroids import with_centroids
from lowsnr_detect.parts.detector import Declarations
from lowsnr_detect.parts.moves import best_vicinity
from lowsnr_detect.parts.moves import move_model
from lowsnr_detect.parts.path_kernels import extend_sums
from lowsnr_detect.parts.registry import register
from lowsnr_detect.parts.thinning import declare_above
from lowsnr_detect.parts.wald_bounds import ratio_terms
from lowsnr_detect.parts.wald_bounds import wald_bounds
import numpy as np

_CENTROID_REACH = 2


@register('cusum')
@dataclass(frozen=True, kw_only=True)
class CUSUM:
    """``S = max(0, max over moves (S + ln P(move)) - drift) + ln L``, in every cell."""

    feedback: ClassVar[bool] = True
    local: ClassVar[bool] = True
    # Errors of successive positions are correlated over about three frames at 6 to 9 dB.
    frames_per_declaration: ClassVar[int] = 3

    sensor: SensorModel = field(default_factory=SensorModel)
    motion: MotionModes = field(default_factory=MotionModes)
    drift: float = setting(
        0.0, 'what the sum loses in every frame beside the log ratio [nat]', ge=0.0)
    headroom: float = setting(
        10.0, 'how far above the threshold a sum is remembered, so that an object that is gone '
        'is given up [nat]', ge=0.0)
    alpha: float = setting(
        0.01, 'nominal probability that a path of noise is declared', gt=0.0, lt=0.5)
    beta: float = setting(
        0.01, 'nominal probability that an object is missed', gt=0.0, lt=0.5)
    threshold: float = setting(4.595, 'sum above which a path is declared [nat]', live=True)
    regions: int = setting(
        1, 'sub-regions of the frame that are worked on in parallel; the result is the same',
        ge=1, le=64)
    thinning_reach: int = setting(
        3, 'cells on each side that a stronger declaration suppresses', ge=0, le=50)
    max_detections: int = setting(50, 'most declarations in a frame', ge=1, le=10_000)

    def __post_init__(self) -> None:
        check_settings(self)

    def nominal(self) -> CUSUM:
        """Return the test with Wald's upper bound for alpha and beta."""
        return replace(self, threshold=wald_bounds(self.alpha, self.beta)[1])

    def init(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return the sum of every cell, none at first."""
        return np.full(shape, -np.inf, dtype=np.float32)

    def step(
        self, state: np.ndarray, frame: np.ndarray, rng: np.random.Generator,
    ) -> tuple[np.ndarray, Declarations]:
        """
        Extend the best path into every cell, or start anew, and decide.

        Parameters
        ----------
        state : (..., rows, cols) ndarray of float32
            Sum of log ratios of the best path of every cell [nat].
        frame : (..., rows, cols) ndarray
            Cell intensities.
        rng
            Not used; the test is deterministic.

        """
        model = move_model(self.motion, self.sensor, 0)
        before = best_vicinity(
            state, model.moves, np.log(model.kernel.ravel()), self.regions)
        sums = self._extended(before, frame)
        size = self.sensor.cell_size_m
        declared = declare_above(
            sums, self.threshold, reach=self.thinning_reach + self.sensor.blur_reach,
            most=self.max_detections, cell_size_m=size, position_std_m=size)
        return sums, with_centroids(declared, sums, reach=_CENTROID_REACH, cell_size_m=size)

    def _extended(self, before: np.ndarray, frame: np.ndarray) -> np.ndarray:
        """Return the sums with the log ratio of a frame, those below zero started anew."""
        plane, factor, offset = ratio_terms(self.sensor, frame)
        sums, most = np.empty_like(plane, dtype=np.float32), max(self.threshold, 0.0)
        known = np.float32(self.drift), np.float32(most + self.headroom)
        paths = before.reshape(plane.shape)
        in_bands(
            lambda first, last: extend_sums(
                paths, plane, factor, offset, *known, first, last, sums),
            plane.shape[-2], self.regions)
        return sums.reshape(before.shape)
