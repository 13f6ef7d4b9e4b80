"""
PMF: the point-mass filter, the Bayes filter on a grid of positions finer than cells.

The hidden state is the existence E_k of the object (Section V) and x = (point, mode, heading,
speed), with R x R points in every cell.  With ``l_k`` the likelihood ratio of the cell of a
point, eq. (4), b(x) the distribution of a birth, uniform, and ``T(x | y)`` the transition
probability that the motion model leads to
(:mod:`lowsnr_detect.grid.point_classes`), the recursion is that of HMM ::

    m_k(x) = P_b (1 - p_{k-1}) b(x) + (1 - P_d) p_{k-1} sum_y T(x | y) g_{k-1}(y)
    g_k(x) = l_k(x) m_k(x) / a_k,      a_k = sum_x l_k(x) m_k(x)
    o_k    = (1 - P_b) (1 - p_{k-1}) + p_{k-1} [ P_d + (1 - P_d) (1 - inside_k) ]
    log odds of E_k = 1:  ln a_k - ln o_k

where p is the probability of existence given Z^k, g that of x given existence, and inside_k the
probability that the moved object is still in the frame.  HMM remembers one or two moves of whole
cells, in which heading and speed hardly show; PMF knows them, and detects fainter objects at
several times the cost.  The state that is declared is the mean of g within the 3 x 3 cells that
hold most of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace

from lowsnr_common.core.likelihood import relative_likelihood
from lowsnr_common.settings.declare import setting
from lowsnr_detect.grid.point_classes import point_transitions
from lowsnr_detect.grid.transitions import predict
from lowsnr_detect.grid.transitions import Transitions
from lowsnr_detect.parts.detector import Declarations
from lowsnr_detect.parts.existence import declare_posterior
from lowsnr_detect.parts.existence import PosteriorDetector
from lowsnr_detect.parts.local_estimate import best_cells
from lowsnr_detect.parts.local_estimate import grid_moments
from lowsnr_detect.parts.local_estimate import windows
from lowsnr_detect.parts.moves import shifted
from lowsnr_detect.parts.registry import register
import numpy as np


@dataclass(frozen=True)
class Belief:
    """
    The posterior after a frame, ``g_k(x) = scale * planes``.

    Parameters
    ----------
    planes : (C, ..., R rows, R cols) ndarray
        m_k of each class and point.
    scale : (..., R rows, R cols) ndarray
        l_k / a_k of each point.
    log_odds : (...,) ndarray or None
        Log odds of existence [nat]; None before the first frame.
    resolution
        Points R per cell and axis.

    """

    planes: np.ndarray
    scale: np.ndarray
    log_odds: np.ndarray | None
    resolution: int

    def moved(self, by: tuple[int, int], cell_size_m: float) -> Belief:
        """Return the belief in cells whose first one moved ``by`` rows and columns."""
        step = -self.resolution * np.array(by)
        return replace(
            self, planes=shifted(self.planes, step, 0.0), scale=shifted(self.scale, step, 0.0))


@register('pmf')
@dataclass(frozen=True, kw_only=True)
class PMF(PosteriorDetector):
    """Forward recursion of ``p(point, mode, heading, speed, E_k | Z^k)``."""

    resolution: int = setting(2, 'points per cell and axis', ge=1, le=8)
    headings: int = setting(24, 'intervals of the heading', ge=4, le=128)
    speeds: int = setting(2, 'intervals of the speed', ge=1, le=16)
    regions: int = setting(
        1, 'sub-regions of the frame that are processed in parallel; the result is the same',
        ge=1, le=64)

    @property
    def transitions(self) -> Transitions:
        """Transition probabilities T(x | y)."""
        return point_transitions(
            self.motion, self.sensor.cell_size_m / self.resolution, self.sensor.frame_period_s,
            self.headings, self.speeds)

    def init(self, shape: tuple[int, ...]) -> Belief:
        """Return the belief before the first frame of shape (..., rows, cols): no object."""
        *batch, rows, cols = shape
        points = (*batch, self.resolution * rows, self.resolution * cols)
        return Belief(
            np.zeros((self.transitions.count, *points)), np.zeros(points), None, self.resolution)

    def step(
        self, state: Belief, frame: np.ndarray, rng: np.random.Generator,
    ) -> tuple[Belief, Declarations]:
        """
        Predict, weigh by the frame and declare.

        Parameters
        ----------
        state : Belief
            Belief after the last frame.
        frame : (..., rows, cols) ndarray
            Cell intensities.
        rng
            Not used; the filter is deterministic.

        """
        born, stays, absent = self.existence.predict(state.log_odds)
        likelihood, peak = relative_likelihood(self.sensor, frame)
        weight = likelihood.repeat(self.resolution, axis=-2).repeat(self.resolution, axis=-1)
        points = weight.shape[-2] * weight.shape[-1]
        planes, mass = predict(
            self.transitions, state.planes, state.scale, stays, born / points, self.regions)
        # What left the frame no longer exists; rounding may leave less than nothing.
        absent = absent + np.maximum(born + stays - mass.sum(axis=(-2, -1)), 0.0)
        total = (mass * weight).sum(axis=(-2, -1))
        log_odds = np.log(total) + peak - np.log(absent)
        state = replace(
            state, planes=planes, scale=weight / total[..., None, None], log_odds=log_odds)
        return state, declare_posterior(
            log_odds, self.threshold, lambda found: self._local_moments(
                planes[:, found], state.scale[found], (mass * weight)[found]))

    def _local_moments(
        self, planes: np.ndarray, scale: np.ndarray, mass: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and covariance of the best local mode of n runs."""
        R, transitions = self.resolution, self.transitions
        count, rows, cols = mass.shape
        cells = best_cells(
            mass.reshape(count, rows // R, R, cols // R, R).sum(axis=(2, 4)))
        runs = np.arange(count)
        joint = windows(planes, runs, cells, R) * windows(scale[None], runs, cells, R)
        return grid_moments(
            joint, cells, transitions.velocity, transitions.velocity_cov, self.sensor.cell_size_m)
