# SPDX-License-Identifier: Apache-2.0
"""
Detectors with adaptive thresholds: from the sequence itself instead of from simulations.

A detector starts at once: before its first frame only the local maxima of its statistic in a few
small frames of white noise are looked at, which the thresholds begin with and are shrunk towards.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace
import functools
import math
from typing import Any
from typing import cast

from lowsnr_common.core.measurement import SensorModel
from lowsnr_detect.adaptive.adaptive_threshold import AdaptiveThreshold
from lowsnr_detect.adaptive.known_tails import white_tail
from lowsnr_detect.adaptive.tail_memory import TailMemory
from lowsnr_detect.parts.cell_detector import CellDetector
from lowsnr_detect.parts.detector import Declarations
from lowsnr_detect.parts.detector import Detector
import numpy as np

# A threshold that acts on no memory: no path is more evident [nat].
_OUT_OF_REACH = 100.0


def statistics(detector: CellDetector) -> tuple[CellDetector, ...]:
    """Return the members of a detector, with no threshold that acts on their memory."""
    return replace(detector, threshold=_OUT_OF_REACH).members


@dataclass(frozen=True)
class AdaptiveMemory:
    """The memories of the members, and what they know of their tails."""

    members: tuple[Any, ...]
    tails: tuple[TailMemory, ...]


@dataclass(frozen=True)
class AdaptiveDetector:
    """
    A detector whose threshold in each cell comes from the earlier frames.

    Parameters
    ----------
    detector
        Detector with a statistic of every cell; its own threshold does not matter.
    prob
        Wanted share of empty frames with a declaration; members of ``detector`` share it.
    shape
        Rows and columns.

    Raises
    ------
    ValueError
        If the detector has no statistic of every cell.

    """

    detector: Detector
    prob: float
    shape: tuple[int, int]

    def __post_init__(self) -> None:
        if not isinstance(self.detector, CellDetector):
            raise ValueError(
                f'{type(self.detector).__name__} has no statistic of every cell, which '
                "operating_point 'adaptive' needs; set it to 'matched', or take another detector")

    @functools.cached_property
    def tails(self) -> tuple[AdaptiveThreshold, ...]:
        """Return the threshold of each member, which begins with that in white noise."""
        members = statistics(cast(CellDetector, self.detector))
        prob = -math.expm1(math.log1p(-self.prob) / len(members))
        return tuple(
            AdaptiveThreshold(
                prob, white_tail(member, *self.shape), self.shape, member.peak_reach,
                member.frames_per_declaration, member.needs_white_noise and len(members) > 1)
            for member in members)

    @functools.cached_property
    def members(self) -> tuple[CellDetector, ...]:
        """
        Return the detectors whose statistics are compared.

        What depends on a threshold in a memory depends on that in white noise: a statistic that
        followed the adaptive threshold would never settle in clutter.
        """
        return tuple(
            replace(member, threshold=tail.start)
            for member, tail in zip(
                cast(CellDetector, self.detector).members, self.tails, strict=True))

    @property
    def sensor(self) -> SensorModel:
        """Return the sensor model of the detector."""
        return self.detector.sensor

    def init(self, shape: tuple[int, ...]) -> AdaptiveMemory:
        """Return the memory before the first frame of shape (..., rows, cols)."""
        return AdaptiveMemory(
            tuple(member.init(shape) for member in self.members),
            tuple(tail.init(math.prod(shape[:-2])) for tail in self.tails))

    def step(
        self, state: AdaptiveMemory, frame: np.ndarray, rng: np.random.Generator,
    ) -> tuple[AdaptiveMemory, Declarations]:
        """Advance by a frame (..., rows, cols); ``rng`` is not used."""
        after, odds = self._compared(state, frame)
        at_zero = cast(CellDetector, replace(self.detector, threshold=0.0))
        return after, at_zero.declare(odds)

    def statistic_map(
        self, before: AdaptiveMemory, frame: np.ndarray, after: AdaptiveMemory,
    ) -> np.ndarray:
        """Return the log odds of each cell with respect to its threshold, (..., rows, cols)."""
        return self._compared(before, frame)[1]

    def _compared(
        self, state: AdaptiveMemory, frame: np.ndarray,
    ) -> tuple[AdaptiveMemory, np.ndarray]:
        """Return the memory after a frame, and the log odds of each cell at its threshold."""
        memories, tails, odds = [], [], []
        for member, memory, threshold, tail in zip(
                self.members, state.members, self.tails, state.tails, strict=True):
            memory, plane = member.statistic(memory, frame)
            tail, compared = threshold.step(tail, plane.reshape(-1, *self.shape))
            memories.append(memory)
            tails.append(tail)
            odds.append(compared.reshape(frame.shape))
        return AdaptiveMemory(tuple(memories), tuple(tails)), np.maximum.reduce(odds)

    def measured(self, state: AdaptiveMemory) -> float:
        """Return the share of the frames with a declaration that continues none before it."""
        shares = [threshold.measured(tail) for threshold, tail in zip(
            self.tails, state.tails, strict=True)]
        return float(np.minimum(np.sum(shares, axis=0), 1.0).mean())

    def largest(self, state: AdaptiveMemory) -> float:
        """Return the largest threshold of the next frame, over cells and members [nat]."""
        return max(float(threshold.thresholds(tail).threshold.max()) for threshold, tail in zip(
            self.tails, state.tails, strict=True))
