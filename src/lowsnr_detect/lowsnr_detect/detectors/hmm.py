# SPDX-License-Identifier: Apache-2.0
"""
HMM: the Bayes-Markov filter on the grid of cells, exact for the moves it assumes.

The hidden state is the existence E_k of the object (Section V), its cell c and its history of
up to two last moves, x = (c, history).  With ``l_k(c)`` the likelihood ratio of a cell, eq. (4),
``b(x)`` the distribution of a birth, uniform over the cells, and ``P(x | y)`` the probability
of a move, the forward recursion (Rabiner 1989) is ::

    a_k(x) = l_k(c) [ P_b (1 - p_{k-1}) b(x) + (1 - P_d) p_{k-1} sum_y P(x | y) g_{k-1}(y) ]
    o_k    = (1 - P_b) (1 - p_{k-1}) + p_{k-1} [ P_d + (1 - P_d) (1 - inside_k) ]
    log odds of E_k = 1:  ln sum_x a_k(x) - ln o_k,      g_k(x) = a_k(x) / sum_x a_k(x)

where p is the probability of existence given Z^k, g that of x given existence, and inside_k the
probability that the moved object is still in the frame.  No path is dropped and nothing is
sampled, so that no detector with the same assumptions detects more.

With a fixed lag the answer is about frame t = k - lag, given all frames to k.  With
``beta_t(x)`` the likelihood of the frames after t given x, and ``beta_t(0)`` that given no
object, the ratio ``r_t(x) = beta_t(x) / beta_t(0)`` follows backwards from r_k = 1 ::

    r_{j-1}(x) = { (1 - P_d) sum_y P(y | x) l_j(y) r_j(y) + 1 - (1 - P_d) sum_y P(y | x) }
                 / { 1 - P_b + P_b sum_y b(y) l_j(y) r_j(y) }

(the second term of the numerator: the object died, or left the frame, before frame j), and ::

    log odds of E_t = 1:  log odds after frame t + ln sum_x g_t(x) r_t(x)

Unless ``decision`` asks for another, the state that is declared is the mean of g within the
3 x 3 cells that hold most of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
from typing import ClassVar

from lowsnr_common.core.destination import Destination
from lowsnr_common.core.likelihood import relative_likelihood
from lowsnr_common.settings.declare import setting
from lowsnr_detect.grid.fixed_lag import LEAST_RATIO
from lowsnr_detect.grid.grid_detector import GridDetector
from lowsnr_detect.grid.grid_filter import as_plane
from lowsnr_detect.grid.grid_filter import birth_belief
from lowsnr_detect.grid.grid_filter import expect_belief
from lowsnr_detect.grid.grid_filter import move_and_weigh
from lowsnr_detect.grid.grid_filter import over_runs
from lowsnr_detect.grid.grid_filter import total
from lowsnr_detect.grid.grid_posterior import GridBelief
from lowsnr_detect.parts.destination_moves import cell_likelihoods
from lowsnr_detect.parts.destination_moves import move_likelihoods
from lowsnr_detect.parts.local_estimate import Posterior
from lowsnr_detect.parts.moves import move_model
from lowsnr_detect.parts.moves import MoveModel
from lowsnr_detect.parts.moves import shifted
from lowsnr_detect.parts.registry import register
import numpy as np


def forward(
    model: MoveModel, belief: np.ndarray, likelihood: np.ndarray, stays: np.ndarray,
    born: np.ndarray,
) -> np.ndarray:
    """
    Return a_k of the forward recursion: the definition, in NumPy.

    Parameters
    ----------
    model
        P(x | y) and the histories of b(x).
    belief : (dropped, kept, ..., rows, cols) ndarray
        g_{k-1}.
    likelihood : (..., rows, cols) ndarray
        l_k.
    stays, born : (...,) ndarray
        ``(1 - P_d) p_{k-1}`` and ``P_b (1 - p_{k-1})``.

    Returns
    -------
    (dropped, kept, ..., rows, cols) ndarray
        a_k, not normalised.

    """
    # P(x | y): the older of two remembered moves is dropped, the new one is remembered.
    dropped, kept, *rest = belief.shape
    flat = belief.reshape(dropped, kept, -1).swapaxes(0, 1)
    moved = (model.kernel @ flat).reshape(kept, len(model.moves), *rest)
    for number, move in enumerate(model.moves):
        moved[:, number] = shifted(moved[:, number], move, 0.0)
    if model.history.size == 1:
        moved = moved.sum(axis=1, keepdims=True)
    moved = moved.reshape(belief.shape)
    births = birth_belief(model, likelihood.shape)
    return np.asarray(likelihood * (as_plane(born) * births + as_plane(stays) * moved))


@dataclass(frozen=True)
class Belief:
    """
    The posterior after a frame.

    Parameters
    ----------
    weights : (dropped, kept, ..., rows, cols) ndarray
        a_k, in proportion to g_k, with sum ``mass``.
    mass : (...,) ndarray
        Sum of the weights.
    log_odds : (...,) ndarray
        Log odds of existence [nat].
    likelihood : (..., rows, cols) ndarray
        l_k, divided by its largest value.
    peak : (...,) ndarray
        Log of that value [nat].
    frame
        Number of the frame, from 1.

    """

    weights: np.ndarray
    mass: np.ndarray
    log_odds: np.ndarray
    likelihood: np.ndarray
    peak: np.ndarray
    frame: int

    @property
    def given(self) -> np.ndarray:
        """Probability g_k of history and cell given existence, as the weights."""
        return np.asarray(self.weights / as_plane(self.mass))


@register('hmm')
@dataclass(frozen=True, kw_only=True)
class HMM(GridDetector):
    """Forward recursion of ``p(cell, last moves, E_k | Z^k)``, with an optional fixed lag."""

    costly: ClassVar[tuple[str, ...]] = ('order', 'motion.max_speed_mps')

    destination: Destination = field(default_factory=Destination)
    order: int = setting(2, 'last moves that the next one depends on', ge=0, le=2)
    regions: int = setting(
        1, 'sub-regions of the frame that are processed in parallel; the result is the same',
        ge=1, le=64)

    @property
    def state_planes(self) -> int:
        """Return the number of histories of moves."""
        return move_model(self.motion, self.sensor, self.order).history.size

    def located(self, beliefs: tuple[Belief, ...]) -> tuple[np.ndarray, Posterior]:
        """Return log odds and posterior in the frame of the first belief, given all of them."""
        model = move_model(self.motion, self.sensor, self.order)
        log_odds, weights = self._backward(model, beliefs)
        joint, then = weights.reshape(-1, *weights.shape[2:]), beliefs[0]
        where = GridBelief(
            joint, np.ones(joint.shape[1:]), model.velocity.reshape(-1, 2),
            model.velocity_cov.reshape(-1, 2, 2), self.sensor.cell_size_m)
        return log_odds, where.posterior(
            lambda runs: joint[:, runs].sum(axis=0),
            None if self.lag else then.likelihood, then.peak)

    def filtered(self, last: Belief | None, frame: np.ndarray) -> Belief:
        """Make one step of the forward recursion, with l_k divided by its largest value."""
        model = move_model(self.motion, self.sensor, self.order)
        born, stays, absent = self.existence.predict(last.log_odds if last else None)
        likelihood, peak = relative_likelihood(self.sensor, frame)
        number = last.frame + 1 if last else 1
        if last is None:
            weights = self._births(model, number, frame.shape) * (as_plane(born) * likelihood)
            mass = total(weights)
        else:
            weights, inside, mass = self._moved(model, last, likelihood, stays, born)
            absent = absent + stays * (1.0 - inside)
        log_odds = np.log(mass) + peak - np.log(absent)
        return Belief(weights, mass, log_odds, likelihood, peak, number)

    def _moved(
        self, model: MoveModel, last: Belief, likelihood: np.ndarray, stays: np.ndarray,
        born: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return what :func:`forward` does, compiled; with inside_k, and the sum of a_k."""
        number, scale = last.frame + 1, 1.0 / last.mass
        if not self.destination.is_ahead(number):
            weights, inside, mass = move_and_weigh(
                model, last.weights, likelihood, stays * scale, born, regions=self.regions)
            return weights, inside * scale, mass
        rows, cols = likelihood.shape[-2:]
        factor, mean = move_likelihoods(
            self.destination, self.motion, self.sensor, self.order, number, (rows, cols))
        belief = last.given / over_runs(mean, last.weights.ndim - 4)
        weights, inside, _ = move_and_weigh(
            model, belief, likelihood, stays, np.zeros_like(born), factor, self.regions)
        weights += self._births(model, number, likelihood.shape) * (as_plane(born) * likelihood)
        return weights, inside, total(weights)

    def _births(self, model: MoveModel, number: int, shape: tuple[int, ...]) -> np.ndarray:
        """Return b(x) in a frame."""
        births = birth_belief(model, shape)
        if not self.destination.is_ahead(number):
            return births
        rows, cols = shape[-2:]
        factor = cell_likelihoods(
            self.destination, self.motion, self.sensor, self.order, number, (rows, cols))
        return np.asarray(births * over_runs(factor, len(shape) - 2))

    def _backward(
        self, model: MoveModel, state: tuple[Belief, ...],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return log odds and g_t r_t, not normalised, of the oldest frame t, given all frames."""
        then, chain = state[0], self.existence
        if len(state) == 1:
            return then.log_odds, then.weights
        survives, shape = 1.0 - chain.death_prob, then.likelihood.shape
        inside, gone = np.ones((*model.history.shape, *shape[-2:])), None
        ratio = np.ones_like(then.weights)
        for later in state[:0:-1]:
            number = later.frame
            births = self._births(model, number, shape)
            if gone is None or self.destination.is_ahead(number):
                gone = over_runs(
                    1.0 - survives * self._expected(model, number, inside), then.log_odds.ndim)
            # Numerator and denominator are divided by exp(peak), which could overflow.
            peak = np.maximum(later.peak, 0.0)
            one = np.exp(-peak)
            value = ratio * later.likelihood * as_plane(np.exp(later.peak - peak))
            present = survives * self._expected(model, number, value) + gone * as_plane(one)
            absent = (1.0 - chain.birth_prob) * one + chain.birth_prob * total(births * value)
            ratio = np.maximum(present / as_plane(absent), LEAST_RATIO)
        weights = then.given * ratio
        return then.log_odds + np.log(total(weights)), weights

    def _expected(self, model: MoveModel, number: int, value: np.ndarray) -> np.ndarray:
        """Return ``sum_y P(y | x) value(y)`` for the moves into a frame."""
        if not self.destination.is_ahead(number):
            return expect_belief(model, value)
        rows, cols = value.shape[-2:]
        factor, mean = move_likelihoods(
            self.destination, self.motion, self.sensor, self.order, number, (rows, cols))
        expected = expect_belief(model, value, factor)
        return np.asarray(expected / over_runs(mean, value.ndim - 4))
