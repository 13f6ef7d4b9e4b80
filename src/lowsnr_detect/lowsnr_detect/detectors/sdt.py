"""
SDT, Section IV-A: add measurements along every path until the sum decides.

A path is (cell, M, T_M).  Of all paths that end in a cell with M measurements only the one
with the largest sum can matter, now or later, so one plane for each depth M and a maximum
over the vicinity replace the enumeration of paths exactly, under the rule that a declaration
closes its (cell, M) state.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace
import math
from typing import ClassVar

from lowsnr_detect.detector import Declarations
from lowsnr_detect.directed import favoured_cells
from lowsnr_detect.directed import favoured_moves
from lowsnr_detect.moves import best_vicinity
from lowsnr_detect.moves import move_model
from lowsnr_detect.regions import by_regions
from lowsnr_detect.registry import register
from lowsnr_detect.sequential import vicinity_max
from lowsnr_detect.sequential import wald_bounds
from lowsnr_detect.thinning import declare_cells
from lowsnr_sensor.config import check_settings
from lowsnr_sensor.config import setting
from lowsnr_sensor.destination import Destination
from lowsnr_sensor.measurement import SensorModel
from lowsnr_sensor.motion import MotionModes
import numpy as np


@dataclass(frozen=True)
class Paths:
    """
    The open paths after a frame.

    Parameters
    ----------
    log_ratio : (s_m - 1, ..., rows, cols) ndarray
        ln L_M of the best open path of every cell and depth M < s_m; -inf for none [nat].
    frame
        Number of the frame, from 1; 0 before the first.

    """

    log_ratio: np.ndarray
    frame: int


@register('sdt')
@dataclass(frozen=True, kw_only=True)
class SDT:
    """Sequential detection over all motions of at most ``radius`` cells a frame."""

    feedback: ClassVar[bool] = True
    local: ClassVar[bool] = True

    sensor: SensorModel = field(default_factory=SensorModel)
    max_iterations: int = setting(5, 'frames s_m after which the test is truncated', ge=1, le=64)
    radius: int = setting(
        1, 'cells an object may move from a frame to the next, 1 in the paper', ge=0, le=16)
    restart: str = setting(
        'all', "which cells start a path: 'all', or 'unused' ones outside the vicinity of "
        'every open path', choices=('all', 'unused'))
    alpha: float = setting(
        0.01, 'nominal probability that a path of noise is declared', gt=0.0, lt=0.5)
    beta: float = setting(
        1e-4, 'nominal probability that the path of an object is dropped', gt=0.0, lt=0.5)
    threshold: float = setting(
        0.0, 'log-likelihood ratio of the truncated test at M = s_m, tau of eq. (8) [nat]')
    upper_threshold: float = setting(
        100.0, 'log-likelihood ratio th_2 that declares a path before M = s_m, never below '
        'threshold; at the same false-alarm rate early declarations cost detections, so it is '
        'out of reach unless nominal [nat]')
    move_prior: bool = setting(
        False, 'whether the log probability of each move is added to the sum of a path; not in '
        'the paper')
    motion: MotionModes = field(default_factory=MotionModes)
    destination: Destination = field(default_factory=Destination)
    regions: int = setting(
        1, 'sub-regions of the frame that are worked on in parallel; the result is the same',
        ge=1, le=64)
    thinning_reach: int = setting(
        -1, 'cells on each side that a stronger declaration suppresses; -1 takes the reach of '
        'the test', ge=-1, le=50)
    max_detections: int = setting(50, 'most declarations in a frame', ge=1, le=10_000)

    def __post_init__(self) -> None:
        check_settings(self)
        if self.destination.probability and not self.move_prior:
            raise ValueError(
                'SDT.move_prior = False, must be true where destination.probability is above 0')

    def nominal(self) -> SDT:
        """Return Wald's test: th_2 for alpha and beta, truncated at equal likelihood."""
        return replace(
            self, threshold=0.0, upper_threshold=wald_bounds(self.alpha, self.beta)[1])

    @property
    def frames_per_declaration(self) -> int:
        """Frames that a declaration rests on."""
        return self.max_iterations

    def init(self, shape: tuple[int, ...]) -> Paths:
        """Return the open paths before the first frame: none."""
        return Paths(np.full((self.max_iterations - 1, *shape), -np.inf), 0)

    def step(
        self, state: Paths, frame: np.ndarray, rng: np.random.Generator,
    ) -> tuple[Paths, Declarations]:
        """
        Extend every open path, start new ones, and decide.

        Parameters
        ----------
        state : Paths
            Memory after the last frame.
        frame : (..., rows, cols) ndarray
            Cell intensities.
        rng
            Not used; SDT is deterministic.

        """
        ratio = self.sensor.log_likelihood_ratio(frame)
        number = state.frame + 1
        planes = (state.log_ratio, ratio, *self._log_favour(number, ratio.shape))
        result = by_regions(self._advanced, planes, self.regions, self.radius)
        still_open, decided = Paths(result[:-1], number), result[-1]
        excess = np.where(decided > self.threshold, decided - self.threshold, -np.inf)
        declared = declare_cells(
            excess, decided.max(axis=(-2, -1)), reach=self._reach,
            most=self.max_detections, cell_size_m=self.sensor.cell_size_m,
            position_std_m=self._position_std_m)
        return still_open, declared

    def _log_favour(self, number: int, shape: tuple[int, ...]) -> tuple[np.ndarray, ...]:
        """Return what starts and moves into a frame add, where there is a destination."""
        if not self.destination.is_ahead(number):
            return ()
        rows, cols = shape[-2:]
        known = self.destination, self.motion, self.sensor, 0, number, (rows, cols)
        moves, mean = favoured_moves(*known)
        return np.log(favoured_cells(*known)[0, 0]), np.log(moves[0] / mean[0, 0])

    def _advanced(
        self, state: np.ndarray, ratio: np.ndarray, start: np.ndarray | float = 0.0,
        moves: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return the open paths by depth and, last, the best of those up for decision."""
        lower = wald_bounds(self.alpha, self.beta)[0]
        depths = self.max_iterations
        paths = np.empty((depths, *ratio.shape))
        vicinity = self._vicinity(state, moves)
        paths[0] = ratio + start
        if self.restart == 'unused' and depths > 1:
            paths[0][vicinity.max(axis=0) > -np.inf] = -np.inf
        paths[1:] = vicinity + ratio
        early = paths[:-1] > max(self.upper_threshold, self.threshold)
        closed = early | (paths[:-1] <= lower)
        np.maximum(
            paths[-1], np.where(early, paths[:-1], -np.inf).max(axis=0, initial=-np.inf),
            out=paths[-1])
        paths[:-1][closed] = -np.inf
        return paths

    def _vicinity(self, state: np.ndarray, moves: np.ndarray | None) -> np.ndarray:
        """Return the best open path that may move into each cell, by depth."""
        if not self.move_prior:
            return vicinity_max(state, self.radius)
        model = move_model(self.motion, self.sensor, 0)
        near = np.all(abs(model.moves) <= self.radius, axis=1)
        log_prob = np.log(model.kernel.ravel()[near])
        if moves is not None:
            log_prob = log_prob[:, None, None] + moves[near]
        return best_vicinity(state, model.moves[near], log_prob)

    @property
    def _reach(self) -> int:
        """Cells that neighbouring paths of one object cross together (DESIGN: 7x7, 5x5)."""
        if self.thinning_reach >= 0:
            return self.thinning_reach
        return self.sensor.blur_reach + math.ceil(
            self.radius * min(self.max_iterations - 1, 3 if self.max_iterations > 5 else 2))

    @property
    def _position_std_m(self) -> float:
        return self.sensor.cell_size_m * math.sqrt(1.0 / 12.0 + 0.4 * (self.max_iterations > 1))
