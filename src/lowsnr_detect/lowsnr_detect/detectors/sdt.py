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
import functools
import math
from typing import ClassVar

from lowsnr_common.core.destination import Destination
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.settings.config import check_settings
from lowsnr_common.settings.config import setting
from lowsnr_detect.parts.bands import in_bands
from lowsnr_detect.parts.destination_moves import favoured_cells
from lowsnr_detect.parts.destination_moves import favoured_moves
from lowsnr_detect.parts.detector import Declarations
from lowsnr_detect.parts.moves import best_vicinity
from lowsnr_detect.parts.moves import move_model
from lowsnr_detect.parts.path_kernels import extend_paths
from lowsnr_detect.parts.registry import register
from lowsnr_detect.parts.thinning import declare_above
from lowsnr_detect.parts.wald_bounds import floor32
from lowsnr_detect.parts.wald_bounds import ratio_terms
from lowsnr_detect.parts.wald_bounds import wald_bounds
import numpy as np

_KIND = np.dtype(np.float32)
_NO_FAVOUR = np.empty((0, 0), _KIND)


@dataclass(frozen=True)
class Paths:
    """
    The open paths after a frame.

    Parameters
    ----------
    log_ratio : (s_m - 1, ..., rows, cols) ndarray of float32
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
        0.0, 'log-likelihood ratio of the truncated test at M = s_m, tau of eq. (8) [nat]',
        live=True)
    upper_threshold: float = setting(
        100.0, 'log-likelihood ratio th_2 that declares a path before M = s_m, never below '
        'threshold; at the same false-alarm rate early declarations cost detections, so it is '
        'out of reach unless nominal [nat]', live=True)
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
        return Paths(np.full(
            (self.max_iterations - 1, *shape), -np.inf, dtype=np.float32), 0)

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
        number = state.frame + 1
        start, moves = self._log_favour(number, frame.shape)
        paths, decided, peaks = self._extended(state.log_ratio, frame, start, moves)
        declared = declare_above(
            decided, self.threshold, reach=self._reach, most=self.max_detections,
            cell_size_m=self.sensor.cell_size_m, position_std_m=self._position_std_m,
            row_peaks=peaks)
        return Paths(paths, number), declared

    def _log_favour(
        self, number: int, shape: tuple[int, ...],
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Return what starts (rows, cols) and moves into a frame add, for a destination."""
        if not self.destination.is_ahead(number):
            return _NO_FAVOUR, None
        rows, cols = shape[-2:]
        known = self.destination, self.motion, self.sensor, 0, number, (rows, cols)
        moves, mean = favoured_moves(*known)
        start = np.log(favoured_cells(*known)[0, 0])
        return start.astype(_KIND), np.log(moves[0] / mean[0, 0])

    def _extended(
        self, state: np.ndarray, frame: np.ndarray, start: np.ndarray, moves: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the open paths, the best of those up for decision, and the best of each row."""
        plane, factor, offset = ratio_terms(self.sensor, frame)
        rows = plane.shape[1]
        before = self._moved(state, moves).reshape(-1, *plane.shape)
        paths, decided = np.empty(before.shape, _KIND), np.empty(plane.shape, _KIND)
        peaks = np.empty(plane.shape[:2], _KIND)
        radius, unused = 0 if self.move_prior else self.radius, self.restart == 'unused'
        in_bands(
            lambda first, last: extend_paths(
                before, plane, factor, offset, start, radius, unused, self._bounds, first, last,
                paths, decided, peaks),
            rows, self.regions)
        return (paths.reshape(state.shape), decided.reshape(frame.shape),
                peaks.reshape(frame.shape[:-1]))

    def _moved(self, state: np.ndarray, moves: np.ndarray | None) -> np.ndarray:
        """Return the best open path that may move into each cell, where moves differ."""
        if not self.move_prior:
            return state
        model = move_model(self.motion, self.sensor, 0)
        near = np.all(abs(model.moves) <= self.radius, axis=1)
        log_prob = np.log(model.kernel.ravel()[near])
        if moves is not None:
            log_prob = log_prob[:, None, None] + moves[near]
        return best_vicinity(state, model.moves[near], log_prob, self.regions)

    @functools.cached_property
    def _bounds(self) -> tuple[float, float, float]:
        """Lower and upper bound and threshold, as float32 compares with them [nat]."""
        lower, upper = wald_bounds(self.alpha, self.beta)[0], self.upper_threshold
        return (
            float(floor32(lower)), float(floor32(max(upper, self.threshold))),
            float(floor32(self.threshold)))

    @functools.cached_property
    def _reach(self) -> int:
        """Cells that neighbouring paths of one object cross together (DESIGN: 7x7, 5x5)."""
        if self.thinning_reach >= 0:
            return self.thinning_reach
        return self.sensor.blur_reach + math.ceil(
            self.radius * min(self.max_iterations - 1, 3 if self.max_iterations > 5 else 2))

    @functools.cached_property
    def _position_std_m(self) -> float:
        return self.sensor.cell_size_m * math.sqrt(1.0 / 12.0 + 0.4 * (self.max_iterations > 1))
