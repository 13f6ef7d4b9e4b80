# SPDX-License-Identifier: Apache-2.0
"""
SDT, Section IV-A: add measurements along every path until the sum decides.

With L_M the likelihood ratio of the measurements z_1 ... z_M along a path, the test is ::

    L_M < th_1: H_0,    L_M > th_2: H_1,    else wait for the next frame              (5)
    T_M < th'_1(M): H_0,    T_M > th'_2(M): H_1,    else wait for the next frame      (6)
    T_M = z_1 + ... + z_M                                                             (7)
    T_{s_m} > tau: H_1,    T_{s_m} < tau: H_0                                         (8)

and it is made for all paths that move at most one cell (``radius``) from a frame to the next.

A path is (cell, M, T_M).  Of all paths that end in a cell with M measurements only the one
with the largest T_M can matter, now or later.  One plane for each M and a maximum over the
vicinity therefore replace the enumeration of paths exactly, under the rule that a declaration
closes its (cell, M) state.

:func:`sequential_test` is the definition.  :class:`SDT` runs the same test in compiled loops,
on ``ln L_M = (I / sigma^2) T_M - M I^2 / (2 sigma^2)`` in float32, whose bounds do not depend
on M.  With blur (which Section IV-A leaves out) ln L_M is the sum of the log-likelihood ratios
of the blurred signal, eq. (2).
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace
import functools
import math
from typing import ClassVar
from typing import Self

from lowsnr_common.core.destination import Destination
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.images.bands import in_bands
from lowsnr_common.settings.declare import setting
from lowsnr_detect.parts.cell_detector import CellDetector
from lowsnr_detect.parts.destination_moves import log_destination_terms
from lowsnr_detect.parts.moves import best_vicinity
from lowsnr_detect.parts.moves import move_model
from lowsnr_detect.parts.moves import vicinity_max
from lowsnr_detect.parts.path_kernels import extend_paths
from lowsnr_detect.parts.registry import register
from lowsnr_detect.parts.wald_bounds import floor32
from lowsnr_detect.parts.wald_bounds import ratio_terms
from lowsnr_detect.parts.wald_bounds import wald_bounds
import numpy as np

_NO_START = np.empty((0, 0), np.float32)


def statistic_bound(ln_th: float, M: np.ndarray | int, sensor: SensorModel) -> np.ndarray:
    """
    Return th'(M), the bound on T_M of eq. (6) that equals a bound th on L_M of eq. (5).

    It is ``(sigma^2 / I) ln(th) + M I / 2``, in units of the frame and the shape of M.
    """
    return np.asarray(sensor.noise_std**2 / sensor.intensity * ln_th + M * sensor.intensity / 2.0)


def sequential_test(
    T: np.ndarray, z: np.ndarray, sensor: SensorModel, ln_th: tuple[float, float],
    ln_tau: float, radius: int = 1, restart: str = 'all',
) -> tuple[np.ndarray, np.ndarray]:
    """
    Make the test of eqs. (5) to (8) in one frame: the definition of SDT, in NumPy.

    Parameters
    ----------
    T : (s_m - 1, ..., rows, cols) ndarray
        Largest T_M of the open paths that end in each cell, M = 1 ... s_m - 1; -inf for none.
    z : (..., rows, cols) ndarray
        Measurements of the frame.
    sensor
        Intensity I and noise sigma, without blur.
    ln_th, ln_tau
        ln th_1 and ln th_2 of eq. (5), and the bound of eq. (8) on ln L_M [nat].
    radius, restart
        As for :class:`SDT`.

    Returns
    -------
    (s_m - 1, ..., rows, cols) ndarray
        T after the frame.
    (..., rows, cols) ndarray
        Largest ln L_M of the paths of each cell that eq. (6) declares or eq. (8) decides [nat].
        H_1 is declared where it exceeds ``ln_tau``.

    """
    s_m = len(T) + 1
    M = np.arange(1, s_m + 1).reshape(-1, *[1] * z.ndim)
    # Eq. (7): the best path of the vicinity adds the measurement of the cell; paths start.
    vicinity = vicinity_max(T, radius)
    unused = np.all(np.isneginf(vicinity), axis=0)
    start = z if restart == 'all' else np.where(unused, z, -np.inf)
    T = np.concatenate([start[None], vicinity + z])
    # Eq. (6), for M < s_m.  Note: th_2 is never below tau, so that no declaration is weaker
    # than those of the truncated test.
    th_1 = statistic_bound(ln_th[0], M, sensor)
    th_2 = statistic_bound(max(ln_th[1], ln_tau), M, sensor)
    declared = th_2 < T
    waits = (th_1 < T) & ~declared
    # Eq. (8), for M = s_m: every path is decided.
    declared[-1], waits[-1] = True, False
    ln_L = sensor.intensity / sensor.noise_std**2 * (T - M * sensor.intensity / 2.0)
    return (np.where(waits, T, -np.inf)[:-1],
            np.where(declared, ln_L, -np.inf).max(axis=0))


@dataclass(frozen=True)
class Paths:
    """
    The open paths after a frame.

    ``log_ratio`` (s_m - 1, ..., rows, cols) is ln L_M [nat], in float32, of the best path to each
    cell, -inf for none; ``frame`` is its number, from 0; ``destination`` lies in its cells.
    """

    log_ratio: np.ndarray
    frame: int
    destination: Destination


@register('sdt')
@dataclass(frozen=True, kw_only=True)
class SDT(CellDetector):
    """Sequential detection over all motions of at most ``radius`` cells a frame."""

    feedback: ClassVar[bool] = True

    max_iterations: int = setting(5, 'frames s_m after which the test is truncated', ge=1, le=64)
    radius: int = setting(
        1, 'cells an object may move from a frame to the next, 1 in the paper', ge=0, le=16)
    restart: str = setting(
        'all', "which cells start a path: 'all', or 'unused' ones outside the vicinity of "
        'every open path', choices=('all', 'unused'))
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
        1, 'sub-regions of the frame that are processed in parallel; the result is the same',
        ge=1, le=64)
    thinning_reach: int = setting(
        -1, 'cells on each side that a stronger declaration suppresses; -1 takes the reach of '
        'the test', ge=-1, le=50)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.destination.probability and not self.move_prior:
            raise ValueError(
                'SDT.move_prior = False, must be true where destination.probability is above 0')

    def init(self, shape: tuple[int, ...]) -> Paths:
        """Return the open paths before the first frame: none."""
        none = (self.max_iterations - 1, *shape)
        return Paths(np.full(none, -np.inf, np.float32), 0, self.destination)

    def statistic(self, state: Paths, frame: np.ndarray) -> tuple[Paths, np.ndarray]:
        """Make the test in a frame; return the largest decided ln L_M of every cell."""
        paths, decided, most = self.tested(state, frame, (*self._bounds[:2], -np.inf))
        decided[np.isneginf(most)] = -np.inf
        return paths, decided

    def nominal(self) -> Self:
        """Return Wald's test: th_2 for alpha and beta, truncated at equal likelihood."""
        upper = wald_bounds(self.alpha, self.beta)[1]
        return replace(self, threshold=0.0, upper_threshold=upper)

    def tested(
        self, state: Paths, frame: np.ndarray, bounds: tuple[float, float, float] | None = None,
    ) -> tuple[Paths, np.ndarray, np.ndarray]:
        """Return what :func:`sequential_test` does, as ln L_M: rows above the last bound only."""
        bounds = bounds or self._bounds
        plane, factor, offset = ratio_terms(self.sensor, frame)
        before, start = self._moved(state, frame.shape)
        before = before.reshape(-1, *plane.shape)
        paths, decided, row_peaks = (
            np.empty(shape, np.float32) for shape in (before.shape, plane.shape, plane.shape[:2]))
        radius, unused = 0 if self.move_prior else self.radius, self.restart == 'unused'
        in_bands(
            lambda first, last: extend_paths(
                before, plane, factor, offset, start, radius, unused, bounds, first, last,
                paths, decided, row_peaks),
            plane.shape[1], self.regions)
        after = Paths(paths.reshape(state.log_ratio.shape), state.frame + 1, state.destination)
        return after, decided.reshape(frame.shape), row_peaks.reshape(frame.shape[:-1])

    @functools.cached_property
    def _bounds(self) -> tuple[float, float, float]:
        """Return ln th_1, ln th_2 and ln tau, rounded for comparison in float32 [nat]."""
        lower, upper = wald_bounds(self.alpha, self.beta)[0], self.upper_threshold
        bounds = floor32(lower), floor32(max(upper, self.threshold)), floor32(self.threshold)
        return float(bounds[0]), float(bounds[1]), float(bounds[2])

    def _moved(self, state: Paths, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Return the open paths after their move, and what a start adds to its path [nat]."""
        # Note: not in the paper; without it the compiled loops take the maximum of the vicinity.
        if not self.move_prior:
            return state.log_ratio, _NO_START
        model = move_model(self.motion, self.sensor, 0)
        near = np.all(abs(model.moves) <= self.radius, axis=1)
        log_prob, start, number = np.log(model.kernel.ravel()[near]), _NO_START, state.frame + 1
        if state.destination.is_ahead(number):
            start, log_moves = log_destination_terms(
                state.destination, self.motion, self.sensor, number, shape)
            log_prob = log_prob[:, None, None] + log_moves[near]
        return best_vicinity(state.log_ratio, model.moves[near], log_prob, self.regions), start

    @property
    def halo(self) -> int | None:
        """Return how far a path comes from, with the blur; None where more decides its start."""
        if self.restart == 'unused' or self.destination.probability:
            return None
        return self.sensor.blur_reach + self.radius * (self.max_iterations - 1)

    @property
    def frames_per_declaration(self) -> int:
        """Return the number of frames over which errors of declarations are correlated: s_m."""
        return self.max_iterations

    @functools.cached_property
    def suppressed_reach(self) -> int:
        """Return the cells on each side that a declaration suppresses, blur included."""
        if self.thinning_reach >= 0:
            return self.thinning_reach
        # A path may leave the object in its last frames.  At 6 dB and 1 % false alarms this holds
        # 92 % (s_m = 5) and 91 % (s_m = 8) of the crossing cells around the strongest.
        last = min(self.max_iterations - 1, 3 if self.max_iterations > 5 else 2)
        return self.sensor.blur_reach + self.radius * last

    @functools.cached_property
    def position_std_m(self) -> float:
        """Return the standard deviation of a declared position per axis [m]."""
        # Noise draws paths to cells beside the object: by .67, .30, .105, .010 cells^2 at 3, 6, 9,
        # 12 dB, within 3 cells (s_m = 5, 0.1 false alarms a frame, 150 runs of random.yaml).
        snr = 10.0 ** (self.sensor.snr_db / 10.0) if self.max_iterations > 1 else math.inf
        return self.sensor.cell_size_m * math.sqrt(1.0 / 12.0 + math.exp(-0.29 * snr))
