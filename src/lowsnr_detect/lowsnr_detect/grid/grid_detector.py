# SPDX-License-Identifier: Apache-2.0
"""The base of the filters on a grid that declare one object, with an optional fixed lag."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lowsnr_detect.grid.fixed_lag import FixedLag
from lowsnr_detect.parts.detector import Declarations
from lowsnr_detect.parts.existence import declare_posterior
from lowsnr_detect.parts.existence import PosteriorDetector
from lowsnr_detect.parts.local_estimate import Posterior
import numpy as np


@dataclass(frozen=True, kw_only=True)
class GridDetector(FixedLag, PosteriorDetector):
    """A detector of one object that defines ``filtered`` and ``located``."""

    def located(self, beliefs: tuple[Any, ...]) -> tuple[np.ndarray, Posterior]:
        """Return log odds and posterior in the frame of the first belief, given all of them."""
        raise NotImplementedError

    def smoothed(self, beliefs: tuple[Any, ...]) -> Declarations:
        """Declare the object of the frame of the first belief, given all of them."""
        log_odds, where = self.located(beliefs)
        return declare_posterior(log_odds, self.threshold, self.decision, where)

    def posterior(
        self, state: tuple[Any, ...], shape: tuple[int, ...],
    ) -> tuple[np.ndarray, Posterior]:
        """Return log odds and posterior in the newest frame, without the later ones of a lag."""
        return self.located(state[-1:])
