# SPDX-License-Identifier: Apache-2.0
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

With a fixed lag the answer is about frame t = k - lag, given all frames to k.  With w_t(x) and
v_t(x) the ratios by which the frames after t change the probability of an object in x, and of
none around x, the mass ``w_t p_t`` follows backwards from ``w_k = v_k = 1`` ::

    s(y) = w_j(y) p_j(y) / m_j(y),      u(x) = v_j(x) / (1 - A_j(x) + Q_j(x))
    v_{j-1}(x) = (1 - sum_y P_b b(y)) u(x) + sum_y P_b b(y) s(y)
    w_{j-1}(x) = v_{j-1}(x) + (1 - P_d) sum_y T(y | x) [s(y) - u(x)]

with the sums of v over the window of x.  An object appears whether or not there was another
before it, as in m.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace
from typing import Any
from typing import ClassVar
from typing import Self

from lowsnr_common.core.likelihood import cell_log_ratio
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.records import Prediction
from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import setting
from lowsnr_detect.decisions.decision import Decision
from lowsnr_detect.decisions.decision import declared_at
from lowsnr_detect.grid.declared_objects import masses
from lowsnr_detect.grid.declared_objects import strongest_first
from lowsnr_detect.grid.fixed_lag import FixedLag
from lowsnr_detect.grid.move_classes import move_transitions
from lowsnr_detect.grid.neighbourhoods import declared_objects
from lowsnr_detect.grid.neighbourhoods import near_log_odds
from lowsnr_detect.grid.neighbourhoods import posterior
from lowsnr_detect.grid.neighbourhoods import predicted_objects
from lowsnr_detect.grid.neighbourhoods import window_sums
from lowsnr_detect.grid.transitions import expect
from lowsnr_detect.grid.transitions import inside
from lowsnr_detect.grid.transitions import predict
from lowsnr_detect.grid.transitions import Transitions
from lowsnr_detect.parts.detector import CORRELATED_FRAMES
from lowsnr_detect.parts.detector import Declarations
from lowsnr_detect.parts.local_estimate import grid_moments
from lowsnr_detect.parts.local_estimate import no_moments
from lowsnr_detect.parts.registry import register
import numpy as np
import scipy

# Largest log-likelihood ratio of a cell: outliers would overflow.
_MOST_LOG_RATIO = 100.0
# Log odds from which on the place of an object is looked for; a threshold is higher.
_LEAST = -5.0


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
    absent : (..., rows, cols) ndarray
        1 / (1 - A_k + Q_k), by which the frame changes the probability of no object.

    """

    planes: np.ndarray
    scale: np.ndarray
    mass: np.ndarray
    absent: np.ndarray


@register('bernoulli')
@dataclass(frozen=True, kw_only=True)
class Bernoulli(FixedLag):
    """A Bernoulli filter in every neighbourhood of the frame."""

    feedback: ClassVar[bool] = False
    local: ClassVar[bool] = True
    costly: ClassVar[tuple[str, ...]] = ('order', 'motion.max_speed_mps')

    sensor: SensorModel = field(default_factory=SensorModel)
    motion: MotionModes = field(default_factory=MotionModes)
    order: int = setting(1, 'last moves that the next one depends on', ge=0, le=2)
    birth_prob: float = setting(
        2e-5, 'probability P_b that an object appears in a cell', gt=0.0, lt=0.1)
    death_prob: float = setting(
        0.03, 'probability P_d that an object disappears from a frame to the next', gt=0.0,
        lt=1.0)
    decision: Decision = field(default_factory=Decision)
    threshold: float = setting(
        0.0, 'statistic of the decision above which an object is declared: for existence its log '
        'posterior odds [nat]', live=True)
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

    @property
    def state_planes(self) -> int:
        """Return the number of histories of moves."""
        return self.transitions.count

    def statistic_map(self, before: Any, frame: np.ndarray, after: Any) -> np.ndarray:
        """Return the log odds of an object in the 3 x 3 cells around each, minus the threshold."""
        return np.asarray(near_log_odds(after[-1].mass) - self.threshold)

    def filtered(self, last: Mass | None, frame: np.ndarray) -> Mass:
        """Predict, weigh by the frame, and normalise every neighbourhood."""
        if last is None:
            none = np.zeros(frame.shape)
            last = Mass(np.zeros((self.transitions.count, *frame.shape)), none, none, none)
        planes, predicted = predict(
            self.transitions, last.planes, last.scale, np.array(1.0 - self.death_prob),
            np.array(self.birth_prob), self.regions)
        ratio = cell_log_ratio(self.sensor, frame)
        likelihood = np.exp(np.clip(ratio, -_MOST_LOG_RATIO, _MOST_LOG_RATIO))
        mass = self._posterior(last, predicted, likelihood)
        scale = mass / predicted
        return Mass(planes, scale, mass, scale / likelihood)

    def smoothed(self, beliefs: tuple[Mass, ...]) -> Declarations:
        """
        Declare the objects of the frame of the first belief, given all of them.

        With a lag the posterior over the prediction is not what one frame says, so that the
        declarations have no prediction.
        """
        declared = self._declare(self.smoothed_mass(beliefs))
        return replace(declared, predicted=None) if self.lag else declared

    def smoothed_mass(self, beliefs: tuple[Mass, ...]) -> Mass:
        """Return the mass in the frame of the first belief, given all of them."""
        then, *later = beliefs
        if not later:
            return then
        planes = then.planes * self._present(later)
        return replace(then, planes=planes, mass=planes.sum(axis=0) * then.scale)

    def _present(self, later: list[Mass]) -> np.ndarray:
        """Return w_t (C, ..., rows, cols), given the beliefs after frame t."""
        survives, shape = 1.0 - self.death_prob, later[0].mass.shape
        stays = survives * inside(self.transitions, shape[-2:], self.regions)
        stays = stays.reshape(len(stays), *[1] * (len(shape) - 2), *shape[-2:])
        born = self.birth_prob * window_sums(np.ones(shape[-2:]))
        present, absent = np.ones_like(later[0].planes), np.ones(shape)
        for belief in later[::-1]:
            # In place: arrays of many planes cost more to make than to fill.
            present *= belief.scale
            none = absent * belief.absent
            births = np.einsum('c,c...->...', self.transitions.appears, present)
            absent = (1.0 - born) * none + self.birth_prob * window_sums(births)
            present = expect(self.transitions, present, self.regions)
            present *= survives
            present -= stays * none
            present += absent
            np.maximum(present, 0.0, out=present)
        return present

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
        """Declare the 3 x 3 cells where the statistic of the decision exceeds the threshold."""
        *batch, rows, cols = state.mass.shape
        bound = min(self.threshold, _LEAST) if self.decision.places else self.threshold
        cells, log_odds = declared_objects(
            state.mass.reshape(-1, rows, cols), bound, self.max_detections)
        statistic, likely = log_odds.copy(), log_odds > bound
        prob = np.full(likely.shape, np.nan)
        (mean, cov), (before, before_cov) = no_moments(likely.shape), no_moments(likely.shape)
        if likely.any():
            where, size = cells[likely], self.sensor.cell_size_m
            predicted, joint = masses(state.planes, state.scale, np.nonzero(likely)[0], where)
            prob[likely] = np.minimum(predicted.sum(axis=(1, 2, 3)), 1.0)
            before[likely], before_cov[likely] = self._moments(predicted, where)
            mean[likely], cov[likely] = self._moments(joint, where)
            if self.decision.places:
                place, share = self.decision.best_places(joint.sum(axis=1), 1)
                statistic[likely] = self.decision.statistic(log_odds[likely], share)
                mean[likely], cov[likely] = declared_at(
                    mean[likely], cov[likely], size * (where - 1 + place))
        # A score of zero means no declaration, so that a tiny probability is rounded up.
        score = np.maximum(scipy.special.expit(log_odds), np.finfo(float).tiny)
        return strongest_first(
            self.threshold, batch, Declarations(statistic, score, mean, cov),
            Prediction(prob, before[..., POS], before_cov[..., POS, :][..., POS]))

    def _moments(self, joint: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and covariance of the state of objects in 3 x 3 cells."""
        return grid_moments(
            joint, cells, self.transitions.velocity, self.transitions.velocity_cov,
            self.sensor.cell_size_m)
