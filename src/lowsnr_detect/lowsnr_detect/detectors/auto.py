"""
AUTO: a velocity bank for what moves and one for what hardly moves, as one list.

A velocity bank (:mod:`lowsnr_detect.detectors.velocity_bank`) that subtracts what stands in place
holds the false-alarm rate in clutter, but loses objects below about a tenth of a cell a frame.  A
second, slow one that subtracts less finds these.  The larger statistic of both decides in every
cell; with adaptive thresholds each has a tail of its own and half of the false alarms.  Both are
sums of the frames, which scale with the noise, whatever its level: the ratios that a path test
adds (CUSUM, SDT) presume it, and have no tail that could be learned where clutter drives them.
"""

from __future__ import annotations

from dataclasses import dataclass
import functools
from typing import Any
from typing import ClassVar

from lowsnr_common.settings.declare import setting
from lowsnr_detect.detectors.velocity_bank import VelocityBank
from lowsnr_detect.parts.cell_detector import CellDetector
from lowsnr_detect.parts.detector import CORRELATED_FRAMES
from lowsnr_detect.parts.registry import register
import numpy as np


@register('auto')
@dataclass(frozen=True, kw_only=True)
class Auto(CellDetector):
    """Declare what a velocity bank or a slow one finds."""

    centroid_reach: ClassVar[int] = 2
    # A sum keeps half of its excess for four frames, in which a path departs by twice its speed.
    shadow_reach: ClassVar[int] = 8

    fastest: float = setting(
        1.5, 'speed of the fastest velocity of the bank [cells a frame]', gt=0.0, le=16.0)
    thinning_reach: int = setting(
        3, 'cells on each side that a stronger declaration suppresses', ge=0, le=50)
    regions: int = setting(
        1, 'sub-regions of the frame that are processed in parallel; the result is the same',
        ge=1, le=64)

    @functools.cached_property
    def members(self) -> tuple[CellDetector, ...]:
        """Return the velocity bank and the slow one, with the settings of this detector."""
        same: dict[str, Any] = {
            'sensor': self.sensor, 'threshold': self.threshold, 'regions': self.regions,
            'thinning_reach': self.thinning_reach, 'max_detections': self.max_detections}
        return VelocityBank(fastest=self.fastest, **same), VelocityBank(
            fastest=0.25 * self.fastest, rings=1, standing=0.25, **same)

    @property
    def frames_per_declaration(self) -> int:
        """Return the number of frames over which errors of declarations are correlated."""
        return CORRELATED_FRAMES

    def init(self, shape: tuple[int, ...]) -> tuple[Any, ...]:
        """Return the memories of the members before the first frame (..., rows, cols)."""
        return tuple(member.init(shape) for member in self.members)

    def statistic(
        self, state: tuple[Any, ...], frame: np.ndarray,
    ) -> tuple[tuple[Any, ...], np.ndarray]:
        """Return the memories after a frame, and the larger statistic of every cell [nat]."""
        made = [member.statistic(memory, frame)
                for member, memory in zip(self.members, state, strict=True)]
        return tuple(memory for memory, _ in made), np.maximum(*(plane for _, plane in made))
