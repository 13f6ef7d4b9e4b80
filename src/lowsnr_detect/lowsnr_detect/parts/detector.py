# SPDX-License-Identifier: Apache-2.0
"""
The interface of every detector: settings, a memory, and a step from a frame to declarations.

A detector is a frozen dataclass of settings.  ``init(shape)`` makes its memory for frames of
shape ``(..., rows, cols)``, where leading axes are independent Monte Carlo runs;
``step(state, frame, rng)`` returns the memory after the frame and the declarations in it, or,
of a detector with a lag (:mod:`lowsnr_detect.grid.fixed_lag`), in the frame so long ago.
Nothing is hidden, so that a run can be repeated, batched and compared.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from typing import ClassVar
from typing import Protocol
from typing import Self

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Prediction
import numpy as np

# Frames over which position errors of recursive detectors are correlated: their integrated
# autocorrelation time, 1 + 2 sum of the autocorrelations, at 6 dB is 2.8 frames for HMM, 2.9 for
# CUSUM and 3.5 for MMTBD2 (150 runs of config/scenarios/random.yaml, 1 % of false alarms).
CORRELATED_FRAMES = 3


@dataclass(frozen=True)
class Declarations:
    """
    The output of a detector for one frame.

    There are D slots for declarations in each run, strongest first; in a slot that is not
    used the score is 0 and the rest is NaN.

    Parameters
    ----------
    peak : (...,) ndarray
        Largest value of the test statistic, whether or not it exceeds the threshold [nat].
    score : (..., D) ndarray
        Probability that the declaration is an object.
    state : (..., D, 4) ndarray
        State [m, m/s]; the velocity is NaN where it is not estimated.
    cov : (..., D, 4, 4) ndarray
        Covariance of the state; NaN where the state is NaN.
    predicted : Prediction or None
        What was expected before the frame, (..., D), of a detector with local posteriors.

    """

    peak: np.ndarray
    score: np.ndarray
    state: np.ndarray
    cov: np.ndarray
    predicted: Prediction | None = None

    @property
    def any(self) -> np.ndarray:  # noqa: A003
        """Whether anything is declared, (...,) of bool."""
        return np.asarray(np.any(self.score > 0.0, axis=-1))

    def estimates(self) -> list[Estimate]:
        """
        Return the declarations of a single run (no leading axes) as records.

        A declaration with a velocity gets an id, ``'1'`` for the strongest.
        """
        return [
            Estimate(self.state[n], self.cov[n], float(self.score[n]),
                     str(n + 1) if np.isfinite(self.state[n]).all() else '',
                     None if self.predicted is None else self.predicted[n])
            for n in np.flatnonzero(self.score > 0.0)
        ]


class Detector(Protocol):
    """
    The interface of every detector, which is a frozen dataclass of settings.

    ``feedback`` says whether the threshold acts on the memory (a declaration closes a path):
    the test statistic then depends on the threshold, and calibration simulates it at several.
    It never depends on ``max_detections``, where there is one.
    ``local`` says whether the statistic is a maximum over cells: calibration may then simulate
    a part of a large frame.
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]
    feedback: ClassVar[bool]
    local: ClassVar[bool]

    @property
    def sensor(self) -> SensorModel:
        """Noise, blur and sampling, and the SNR that the detector is designed for."""
        ...

    @property
    def threshold(self) -> float:
        """Log of the value that the test statistic is compared with [nat]."""
        ...

    @property
    def frames_per_declaration(self) -> int:
        """Return the number of frames over which errors of declarations are correlated."""
        ...

    def nominal(self) -> Self:
        """Return the detector with the thresholds of its test as designed."""
        ...

    def init(self, shape: tuple[int, ...]) -> Any:
        """Return the memory before the first frame of shape (..., rows, cols)."""
        ...

    def step(
        self, state: Any, frame: np.ndarray, rng: np.random.Generator,
    ) -> tuple[Any, Declarations]:
        """Advance by one frame (..., rows, cols); return the new memory and the declarations."""
        ...

    def statistic_map(self, before: Any, frame: np.ndarray, after: Any) -> np.ndarray:
        """
        Return by how much the statistic exceeds the threshold in each cell of a frame.

        Parameters
        ----------
        before, after
            Memory before and after the frame.
        frame : (..., rows, cols) ndarray
            Cell intensities.

        Returns
        -------
        (..., rows, cols) ndarray
            Log ratio [nat], -inf where there is no statistic.  Where the statistic is one of
            cells, what is above 0 is declared; a filter of one object compares the sum of the
            odds over the cells, so that it may declare one with no cell above 0.

        """
        ...
