# SPDX-License-Identifier: Apache-2.0
"""
CUSUM: Page's test, the sequential test for a start that is not known, along every path.

Page (1954) adds the log-likelihood ratios of the measurements and starts again from zero
wherever the sum falls below it, which maximises over the unknown start.  Here the sum S_k(c)
of cell c also maximises over the path that ends there, as the algorithm of Viterbi (1967)
does, with the log probability ln P(m) of every move m::

    S_k(c) = min{ max[ 0, max_m ( S_{k-1}(c - m) + ln P(m) ) - nu ], h } + ln L(z_k^c)

An object is declared where ``S_k(c) > ln th``.  The drift nu >= 0 is that of Page's test.

Note: the cap h = ln th + headroom is not in Page's test.  It bounds how many frames the sum
of an object takes to fall below the threshold after the object has gone.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
from typing import ClassVar

from lowsnr_common.core.motion import MotionModes
from lowsnr_common.images.bands import in_bands
from lowsnr_common.settings.declare import setting
from lowsnr_detect.parts.cell_detector import CellDetector
from lowsnr_detect.parts.detector import CORRELATED_FRAMES
from lowsnr_detect.parts.moves import best_vicinity
from lowsnr_detect.parts.moves import move_model
from lowsnr_detect.parts.moves import move_radius
from lowsnr_detect.parts.moves import shifted
from lowsnr_detect.parts.path_kernels import extend_sums
from lowsnr_detect.parts.registry import register
from lowsnr_detect.parts.wald_bounds import ratio_terms
import numpy as np

# Frames after which the start of a sum is taken to be forgotten at the edges of a tile.
_REMEMBERED = 32


def page_recursion(
    sums: np.ndarray, log_ratio: np.ndarray, moves: np.ndarray, log_prob: np.ndarray,
    drift: float, cap: float,
) -> np.ndarray:
    """
    Return S_k of every cell: the definition of the test, in NumPy.

    Parameters
    ----------
    sums : (..., rows, cols) ndarray
        S_{k-1} of every cell [nat]; -inf before the first frame.
    log_ratio : (..., rows, cols) ndarray
        ln L(z_k) of every cell [nat].
    moves : (n, 2) ndarray of int
        Rows and columns of each move m.
    log_prob : (n,) ndarray
        ln P(m) [nat].
    drift, cap
        nu and h [nat].

    Returns
    -------
    (..., rows, cols) ndarray
        S_k of every cell [nat].

    """
    best = np.max([
        shifted(sums, move, -np.inf) + prob for move, prob in zip(moves, log_prob)], axis=0)
    return np.asarray(np.clip(best - drift, 0.0, cap) + log_ratio)


@register('cusum')
@dataclass(frozen=True, kw_only=True)
class CUSUM(CellDetector):
    """Page's test over all paths: declare the cells with ``S_k > ln th``."""

    feedback: ClassVar[bool] = True
    # Ratios of likelihoods in white noise: what stays in place adds to a sum without end.
    needs_white_noise: ClassVar[bool] = True
    # At 6 dB hits within 1.5 cells are most frequent with 2: P_D .55, .57, .60, .59 for 0 to 3
    # (150 runs, random.yaml).
    centroid_reach: ClassVar[int] = 2

    motion: MotionModes = field(default_factory=MotionModes)
    drift: float = setting(
        0.0, 'nu, subtracted from the sum of every path in every frame [nat]', ge=0.0)
    headroom: float = setting(
        10.0, 'how far above the threshold a sum is remembered, so that an object that has gone '
        'is no longer declared [nat]', ge=0.0)
    thinning_reach: int = setting(
        3, 'cells on each side that a stronger declaration suppresses', ge=0, le=50)
    regions: int = setting(
        1, 'sub-regions of the frame that are processed in parallel; the result is the same',
        ge=1, le=64)

    @property
    def halo(self) -> int:
        """
        Return how far a path comes from in 32 frames, with the blur.

        Note: a sum has no longest path; older starts are forgotten where it was capped or zero.
        """
        return self.sensor.blur_reach + _REMEMBERED * move_radius(self.motion, self.sensor)

    @property
    def frames_per_declaration(self) -> int:
        """Return the number of frames over which errors of declarations are correlated."""
        return CORRELATED_FRAMES

    def init(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return the sum of every cell before the first frame: no path."""
        return np.full(shape, -np.inf, dtype=np.float32)

    def statistic(
        self, state: np.ndarray, frame: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """
        Extend the best path into every cell, or start one there.

        Parameters
        ----------
        state : (..., rows, cols) ndarray of float32
            Sum of log ratios of the best path of every cell [nat].
        frame : (..., rows, cols) ndarray
            Cell intensities.

        Returns
        -------
        state, plane : (..., rows, cols) ndarray of float32
            The sums after the frame, which are the statistic.

        """
        sums = self._extended(state, frame)
        return sums, sums

    def _extended(self, state: np.ndarray, frame: np.ndarray) -> np.ndarray:
        """Return what :func:`page_recursion` does, by compiled loops over bands of rows."""
        model = move_model(self.motion, self.sensor, 0)
        best = best_vicinity(state, model.moves, np.log(model.kernel.ravel()), self.regions)
        plane, factor, offset = ratio_terms(self.sensor, frame)
        best, sums = best.reshape(plane.shape), np.empty_like(plane, dtype=np.float32)
        drift = np.float32(self.drift)
        cap = np.float32(max(self.threshold, 0.0) + self.headroom)
        in_bands(
            lambda first, last: extend_sums(
                best, plane, factor, offset, drift, cap, first, last, sums),
            plane.shape[-2], self.regions)
        return sums.reshape(frame.shape)
