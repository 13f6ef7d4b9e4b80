# SPDX-License-Identifier: Apache-2.0
"""The base of detectors that compare a statistic of every cell with a threshold."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace
import functools
import math
from typing import Any
from typing import ClassVar
from typing import Self

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import setting
from lowsnr_detect.parts.centroids import with_centroids
from lowsnr_detect.parts.detector import Declarations
from lowsnr_detect.parts.detector import Detector
from lowsnr_detect.parts.thinning import declare_cells
from lowsnr_detect.parts.wald_bounds import wald_bounds
import numpy as np


@dataclass(frozen=True, kw_only=True)
class CellDetector:
    """
    Settings and declarations of a detector whose statistic is one plane of cells.

    A subclass computes the plane in :meth:`statistic`; one that overrides :meth:`tested` for its
    speed declares the same.
    """

    feedback: ClassVar[bool] = False
    local: ClassVar[bool] = True
    # Whether the statistic means nothing where the noise is not white.
    needs_white_noise: ClassVar[bool] = False
    # Cells on each side of a declaration over which its position is averaged, 0 for none.
    centroid_reach: ClassVar[int] = 0
    # Cells on each side within which a declaration suppresses far weaker ones.
    shadow_reach: ClassVar[int] = 0

    sensor: SensorModel = field(default_factory=SensorModel)
    alpha: float = setting(
        0.01, 'nominal probability that noise is declared an object', gt=0.0, lt=0.5)
    beta: float = setting(
        0.01, 'nominal probability that an object is missed', gt=0.0, lt=0.5)
    threshold: float = setting(
        4.595, 'statistic above which a cell is declared [nat]', live=True)
    thinning_reach: int = setting(
        0, 'cells on each side that a stronger declaration suppresses', ge=0, le=50)
    max_detections: int = setting(50, 'most declarations in a frame', ge=1, le=10_000)

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def frames_per_declaration(self) -> int:
        """Return the number of frames over which errors of declarations are correlated."""
        return 1

    @functools.cached_property
    def suppressed_reach(self) -> int:
        """Return the cells on each side that a declaration suppresses, blur included."""
        return self.thinning_reach + self.sensor.blur_reach

    @property
    def peak_reach(self) -> int:
        """Return the cells on each side within which a local maximum is the largest."""
        return max(self.suppressed_reach, 1)

    @property
    def halo(self) -> int | None:
        """
        Return the cells around a tile whose measurements act on the statistic inside.

        None where the statistic cannot be computed by tiles, or it is not known that it can.
        """
        return None

    @functools.cached_property
    def position_std_m(self) -> float:
        """Return the standard deviation of a position in its cell, per axis [m]: uniform."""
        return self.sensor.cell_size_m / math.sqrt(12.0)

    def nominal(self) -> Self:
        """Return the test with Wald's upper bound for alpha and beta."""
        return replace(self, threshold=wald_bounds(self.alpha, self.beta)[1])

    @property
    def members(self) -> tuple[CellDetector, ...]:
        """Return the detectors whose statistics are combined: itself, for all but ``auto``."""
        return (self,)

    def init(self, shape: tuple[int, ...]) -> Any:
        """Return the memory before the first frame of shape (..., rows, cols): none."""
        return None

    def statistic(self, state: Any, frame: np.ndarray) -> tuple[Any, np.ndarray]:
        """
        Return the memory after a frame, and the test statistic of its cells.

        Parameters
        ----------
        state
            Memory after the frame before.
        frame : (..., rows, cols) ndarray
            Cell intensities.

        Returns
        -------
        state
            Memory after this frame.
        (..., rows, cols) ndarray
            Statistic [nat]; -inf where there is none.

        """
        raise NotImplementedError

    def step(
        self, state: Any, frame: np.ndarray, rng: np.random.Generator,
    ) -> tuple[Any, Declarations]:
        """Declare the cells of a frame whose statistic exceeds the threshold."""
        state, plane, row_peaks = self.tested(state, frame)
        return state, self.declare(plane, row_peaks)

    def tested(
        self, state: Any, frame: np.ndarray,
    ) -> tuple[Any, np.ndarray, np.ndarray | None]:
        """
        Return what :meth:`statistic` does, and what :meth:`declare` needs besides.

        A subclass that knows the largest statistic of each row (..., rows) returns it too, and
        leaves rows without a declaration undefined.
        """
        return *self.statistic(state, frame), None

    def statistic_map(self, before: Any, frame: np.ndarray, after: Any) -> np.ndarray:
        """Return the statistic of each cell of a frame (..., rows, cols) minus the threshold."""
        return np.asarray(self.statistic(before, frame)[1] - self.threshold)

    def declare(self, plane: np.ndarray, row_peaks: np.ndarray | None = None) -> Declarations:
        """
        Declare the cells of a plane above the threshold, thinned.

        Parameters
        ----------
        plane : (..., rows, cols) ndarray
            Test statistic of each cell [nat], compared as float32.
        row_peaks : (..., rows) ndarray of float32, optional
            Largest statistic of each row, where it is known; rows of the plane that do not
            exceed the threshold are then not read.

        """
        declared = declare_cells(
            np.asarray(plane, dtype=np.float32), self.threshold, reach=self.suppressed_reach,
            most=self.max_detections, cell_size_m=self.sensor.cell_size_m,
            position_std_m=self.position_std_m, row_peaks=row_peaks,
            shadow_reach=self.shadow_reach)
        if self.centroid_reach == 0:
            return declared
        return with_centroids(
            declared, plane, reach=self.centroid_reach, cell_size_m=self.sensor.cell_size_m)


def resolution_of(detector: Detector) -> float:
    """Return the cells along each axis within which two objects are declared once; 0 for none."""
    # The objects lie up to half a cell from the middle of theirs.
    return detector.suppressed_reach + 0.5 if isinstance(detector, CellDetector) else 0.0
