"""CDT, Section III: threshold every cell of every frame by itself."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace
from typing import ClassVar

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.settings.config import check_settings
from lowsnr_common.settings.config import setting
from lowsnr_detect.parts.detector import Declarations
from lowsnr_detect.parts.registry import register
from lowsnr_detect.parts.thinning import declare_above
from lowsnr_detect.parts.wald_bounds import ratio_terms
from lowsnr_detect.parts.wald_bounds import wald_bounds
import numpy as np


@register('cdt')
@dataclass(frozen=True, kw_only=True)
class CDT:
    """Conventional detection: declare the cells with ``z > th'``, eq. (4)."""

    feedback: ClassVar[bool] = False
    local: ClassVar[bool] = True

    sensor: SensorModel = field(default_factory=SensorModel)
    alpha: float = setting(
        0.01, 'nominal probability that a cell of noise is declared', gt=0.0, lt=0.5)
    beta: float = setting(
        0.01, 'nominal probability that an object is missed', gt=0.0, lt=0.5)
    threshold: float = setting(
        4.595, 'log-likelihood ratio above which a cell is declared [nat]', live=True)
    thinning_reach: int = setting(
        0, 'cells on each side that a stronger declaration suppresses', ge=0, le=50)
    max_detections: int = setting(50, 'most declarations in a frame', ge=1, le=10_000)

    def __post_init__(self) -> None:
        check_settings(self)

    def nominal(self) -> CDT:
        """Return the test with Wald's upper bound for alpha and beta."""
        return replace(self, threshold=wald_bounds(self.alpha, self.beta)[1])

    @property
    def frames_per_declaration(self) -> int:
        """Frames that a declaration rests on."""
        return 1

    def init(self, shape: tuple[int, ...]) -> None:
        """Return the memory: none."""

    def step(
        self, state: None, frame: np.ndarray, rng: np.random.Generator,
    ) -> tuple[None, Declarations]:
        """Declare the cells of a frame (..., rows, cols) above the threshold."""
        plane, factor, offset = ratio_terms(self.sensor, frame)
        ratio = plane.astype(np.float32) * factor - offset
        declared = declare_above(
            ratio.reshape(frame.shape), self.threshold,
            reach=self.thinning_reach + self.sensor.blur_reach,
            most=self.max_detections, cell_size_m=self.sensor.cell_size_m,
            position_std_m=self.sensor.cell_size_m / np.sqrt(12.0))
        return state, declared
