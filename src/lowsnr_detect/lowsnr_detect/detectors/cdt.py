# SPDX-License-Identifier: Apache-2.0
"""
CDT, Section III: threshold every cell of every frame by itself.

The likelihood ratio of a cell is compared with th, eq. (4); by the sensor model it is
``L(z) = exp(-I (I - 2 z) / (2 sigma^2))``, so that the test is ``z > th'`` with
``th' = (sigma^2 / I) ln(th) + I / 2``.  CDT is SDT with s_m = 1.
"""

from __future__ import annotations

from dataclasses import dataclass

from lowsnr_detect.parts.cell_detector import CellDetector
from lowsnr_detect.parts.registry import register
from lowsnr_detect.parts.wald_bounds import ratio_terms
import numpy as np


@register('cdt')
@dataclass(frozen=True, kw_only=True)
class CDT(CellDetector):
    """Conventional detection: declare the cells with ``ln L(z) > ln th``, eq. (4)."""

    @property
    def halo(self) -> int:
        """Return the reach of the blur."""
        return self.sensor.blur_reach

    def statistic(self, state: None, frame: np.ndarray) -> tuple[None, np.ndarray]:
        """Return no memory, and ln L of every cell of a frame (..., rows, cols)."""
        plane, factor, offset = ratio_terms(self.sensor, frame)
        log_ratio = plane.astype(np.float32) * factor - offset
        return None, log_ratio.reshape(frame.shape)
