"""
BERNOULLI: local Bernoulli filters on the grid of cells, for many objects in frames of any size.

The hidden state of an object is its cell and its history of up to two last moves, as in HMM,
but instead of one object in the frame there is at most one in every neighbourhood.  With
``l_k(x)`` the likelihood ratio of a cell, eq. (4), and T the transition probabilities, the mass
p of an object in x follows ::

    m_k(x) = P_b b(x) + (1 - P_d) sum_y T(x | y) p_{k-1}(y)
    p_k(x) = l_k(x) m_k(x) / (1 - A_k(x) + Q_k(x))

where A and Q are the sums of m and of l m over the mass that competes with that of x for one
object (:mod:`lowsnr_detect.grid.neighbourhoods`): p is the posterior of a Bernoulli filter
that knows this mass alone.  The mass of 3 x 3 cells is the probability that they hold an
object.  Where it is largest and exceeds the threshold, an object is declared, with the mean and
covariance of its state in these cells; the next is looked for in the other cells.  There is no
association, and no number of objects.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace
from typing import ClassVar
from typing import Self

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import setting
from lowsnr_detect.grid.move_classes import move_transitions
from lowsnr_detect.grid.neighbourhoods import declared_objects
from lowsnr_detect.grid.neighbourhoods import left_over
from lowsnr_detect.grid.neighbourhoods import posterior
from lowsnr_detect.grid.neighbourhoods import predicted_objects
from lowsnr_detect.grid.transitions import predict
from lowsnr_detect.grid.transitions import Transitions
from lowsnr_detect.parts.detector import CORRELATED_FRAMES
from lowsnr_detect.parts.detector import Declarations
from lowsnr_detect.parts.local_estimate import grid_moments
from lowsnr_detect.parts.local_estimate import windows
from lowsnr_detect.parts.registry import register
import numpy as np
import scipy

# Largest log-likelihood ratio of a cell: outliers would overflow.
_MOST_LOG_RATIO = 100.0


@dataclass(frozen=True)
class Mass:
    """
    The mass of all states after a frame, ``p_k(x) = scale * planes``.

    Parameters
    ----------
    planes : (C, ..., rows, cols) ndarray
        m_k of each history of moves and cell.
    scale : (..., rows, cols) ndarray
        Factor of each cell.
    mass : (..., rows, cols) ndarray
        Sum of p_k over the histories.

    """

    planes: np.ndarray
    scale: np.ndarray
    mass: np.ndarray


@register('bernoulli')
@dataclass(frozen=True, kw_only=True)
class Bernoulli:
    """A Bernoulli filter in every neighbourhood of the frame."""

    feedback: ClassVar[bool] = False
    local: ClassVar[bool] = True

    sensor: SensorModel = field(default_factory=SensorModel)
    motion: MotionModes = field(default_factory=MotionModes)
    order: int = setting(1, 'last moves that the next one depends on', ge=0, le=2)
    birth_prob: float = setting(
        2e-5, 'probability P_b that an object appears in a cell', gt=0.0, lt=0.1)
    death_prob: float = setting(
        0.03, 'probability P_d that an object disappears from a frame to the next', gt=0.0,
        lt=1.0)
    threshold: float = setting(
        0.0, 'log posterior odds above which an object is declared [nat]', live=True)
    regions: int = setting(
        1, 'sub-regions of the frame that are processed in parallel; the result is the same',
        ge=1, le=64)
    max_detections: int = setting(50, 'most declarations in a frame', ge=1, le=10_000)

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def frames_per_declaration(self) -> int:
        """Return the number of frames over which errors of declarations are correlated."""
        return CORRELATED_FRAMES

    @property
    def transitions(self) -> Transitions:
        """Return the transition probabilities T."""
        return move_transitions(self.motion, self.sensor, self.order)

    def nominal(self) -> Self:
        """Return the detector that declares what is more likely than not."""
        return replace(self, threshold=0.0)

    def init(self, shape: tuple[int, ...]) -> Mass:
        """Return the mass before the first frame of shape (..., rows, cols): none."""
        return Mass(np.zeros((self.transitions.count, *shape)), np.zeros(shape), np.zeros(shape))

    def step(
        self, state: Mass, frame: np.ndarray, rng: np.random.Generator,
    ) -> tuple[Mass, Declarations]:
        """
        Predict, weigh by the frame, normalise every neighbourhood, and declare.

        Parameters
        ----------
        state : Mass
            Mass after the last frame.
        frame : (..., rows, cols) ndarray
            Cell intensities.
        rng
            Not used; the filter is deterministic.

        """
        planes, predicted = predict(
            self.transitions, state.planes, state.scale, np.array(1.0 - self.death_prob),
            np.array(self.birth_prob), self.regions)
        ratio = np.minimum(self.sensor.log_likelihood_ratio(frame), _MOST_LOG_RATIO)
        mass = self._posterior(state, predicted, np.exp(ratio))
        state = Mass(planes, mass / predicted, mass)
        return state, self._declare(state)

    def _posterior(
        self, state: Mass, predicted: np.ndarray, likelihood: np.ndarray,
    ) -> np.ndarray:
        """Return the mass of every cell (..., rows, cols) after a frame."""
        after = np.empty(predicted.shape)
        for run in np.ndindex(*predicted.shape[:-2]):
            cells, owned = predicted_objects(
                self.transitions, state.planes[(slice(None), *run)], state.scale[run],
                state.mass[run])
            after[run] = posterior(
                predicted[run], likelihood[run], owned * (1.0 - self.death_prob), cells,
                self.death_prob)
        return after

    def _declare(self, state: Mass) -> Declarations:
        """Declare the 3 x 3 cells whose log odds of an object exceed the threshold."""
        *batch, rows, cols = state.mass.shape
        cells, log_odds = declared_objects(
            state.mass.reshape(-1, rows, cols), self.threshold, self.max_detections)
        used = log_odds > self.threshold
        # A score of zero means no declaration, so that a tiny probability is rounded up.
        prob = np.maximum(scipy.special.expit(log_odds), np.finfo(float).tiny)
        score = np.where(used, prob, 0.0)
        mean, cov = np.full((*used.shape, 4), np.nan), np.full((*used.shape, 4, 4), np.nan)
        if used.any():
            run, where = np.nonzero(used)[0], cells[used]
            planes = state.planes.reshape(len(state.planes), -1, rows, cols)
            joint = windows(planes, run, where) * windows(
                state.scale.reshape(1, -1, rows, cols), run, where)
            joint = joint * left_over(run, where)[:, None]
            mean[used], cov[used] = grid_moments(
                joint, where, self.transitions.velocity, self.transitions.velocity_cov,
                self.sensor.cell_size_m)
        return Declarations(
            log_odds[:, 0].reshape(batch), score.reshape(*batch, -1),
            mean.reshape(*batch, -1, 4), cov.reshape(*batch, -1, 4, 4))
