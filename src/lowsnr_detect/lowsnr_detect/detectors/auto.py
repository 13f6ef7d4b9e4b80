# SPDX-License-Identifier: Apache-2.0
"""
AUTO: a velocity bank for what moves and a path test for what hardly moves, as one list.

The velocity bank (:mod:`lowsnr_detect.detectors.velocity_bank`) subtracts what stands in place
and therefore holds the false-alarm rate in clutter, but misses objects below about a tenth of a
cell a frame.  Page's test along paths (:mod:`lowsnr_detect.detectors.cusum`) finds these.  The
larger statistic of both decides in every cell; with adaptive thresholds each has a tail of its
own and half of the false alarms, and the path test, which presumes white noise, declares nothing
where the noise clearly is not white.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
import functools
from typing import Any
from typing import ClassVar

from lowsnr_common.core.motion import MotionModes
from lowsnr_common.settings.declare import setting
from lowsnr_detect.detectors.cusum import CUSUM
from lowsnr_detect.detectors.velocity_bank import VelocityBank
from lowsnr_detect.parts.cell_detector import CellDetector
from lowsnr_detect.parts.detector import CORRELATED_FRAMES
from lowsnr_detect.parts.registry import register
import numpy as np

# Headroom of the path test [nat].  The sums around a strong object, and where one was, are soon
# below the threshold; the bank bridges the frames in which a weak one is.
_HEADROOM = 2.0


@register('auto')
@dataclass(frozen=True, kw_only=True)
class Auto(CellDetector):
    """Declare what a velocity bank or a path test finds."""

    feedback: ClassVar[bool] = True
    centroid_reach: ClassVar[int] = 2
    # A sum keeps half of its excess for four frames, in which a path departs by twice its speed.
    shadow_reach: ClassVar[int] = 8

    motion: MotionModes = field(default_factory=MotionModes)
    fastest: float = setting(
        1.5, 'speed of the fastest velocity of the bank [cells a frame]', gt=0.0, le=16.0)
    thinning_reach: int = setting(
        3, 'cells on each side that a stronger declaration suppresses', ge=0, le=50)
    regions: int = setting(
        1, 'sub-regions of the frame that are processed in parallel; the result is the same',
        ge=1, le=64)

    @functools.cached_property
    def members(self) -> tuple[CellDetector, ...]:
        """Return the velocity bank and the path test, with the settings of this detector."""
        same: dict[str, Any] = {
            'sensor': self.sensor, 'threshold': self.threshold, 'regions': self.regions,
            'thinning_reach': self.thinning_reach, 'max_detections': self.max_detections}
        return VelocityBank(fastest=self.fastest, **same), CUSUM(
            motion=self.motion, headroom=_HEADROOM, **same)

    @property
    def halo(self) -> int:
        """Return the larger one of both members."""
        return max(member.halo or 0 for member in self.members)

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
