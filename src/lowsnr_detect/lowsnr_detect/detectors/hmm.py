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

Where objects are bound for one of several destinations, x has also the pair of a destination and
a frame of arrival that an object carries from its birth on
(:mod:`lowsnr_detect.grid.bound_steps`).
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
import functools
from typing import ClassVar

from lowsnr_common.core.bound_motion import Destinations
from lowsnr_common.core.destination import Destination
from lowsnr_common.core.likelihood import relative_likelihood
from lowsnr_common.settings.declare import setting
from lowsnr_detect.grid.bound_steps import bound_count
from lowsnr_detect.grid.bound_steps import step_arrays
from lowsnr_detect.grid.fixed_lag import LEAST_RATIO
from lowsnr_detect.grid.grid_detector import GridDetector
from lowsnr_detect.grid.grid_filter import as_plane
from lowsnr_detect.grid.grid_filter import birth_belief
from lowsnr_detect.grid.grid_filter import total
from lowsnr_detect.grid.grid_posterior import GridBelief
from lowsnr_detect.grid.move_steps import Belief
from lowsnr_detect.grid.move_steps import MoveSteps
from lowsnr_detect.parts.local_estimate import Posterior
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


@register('hmm')
@dataclass(frozen=True, kw_only=True)
class HMM(GridDetector):
    """Forward recursion of ``p(cell, last moves, E_k | Z^k)``, with an optional fixed lag."""

    costly: ClassVar[tuple[str, ...]] = ('order', 'motion.max_speed_mps', 'destinations')

    destination: Destination = field(default_factory=Destination)
    destinations: Destinations = field(default_factory=Destinations)
    order: int = setting(2, 'last moves that the next one depends on', ge=0, le=2)
    regions: int = setting(
        1, 'sub-regions of the frame that are processed in parallel; the result is the same',
        ge=1, le=64)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.destinations.check_only(self.destination)
        self.destinations.check_motion(self.motion)

    @functools.cached_property
    def steps(self) -> MoveSteps:
        """Return P(x | y) and b(x)."""
        return MoveSteps(self.motion, self.sensor, self.order, self.destination,
                         self.destinations, self.regions)

    @property
    def state_planes(self) -> int:
        """Return the number of histories of moves, and of what an object is bound for."""
        return self.steps.model.history.size * bound_count(self.destinations)

    @property
    def step_arrays(self) -> int:
        """Return how many arrays of all states a step makes."""
        return step_arrays(self.destinations)

    def located(self, beliefs: tuple[Belief, ...]) -> tuple[np.ndarray, Posterior]:
        """Return log odds and posterior in the frame of the first belief, given all of them."""
        log_odds, weights = self._backward(beliefs)
        joint, then = weights.reshape(-1, *weights.shape[3:]), beliefs[0]
        velocity, cov = (each.reshape(-1, *each.shape[2:]).repeat(weights.shape[2], axis=0)
                         for each in (self.steps.model.velocity, self.steps.model.velocity_cov))
        where = GridBelief(
            joint, np.broadcast_to(1.0, joint.shape[1:]), velocity, cov, self.sensor.cell_size_m)
        return log_odds, where.posterior(
            lambda runs: joint[:, runs].sum(axis=0),
            None if self.lag else then.likelihood, then.peak)

    def filtered(self, last: Belief | None, frame: np.ndarray) -> Belief:
        """Make one step of the forward recursion, with l_k divided by its largest value."""
        born, stays, absent = self.existence.predict(last.log_odds if last else None)
        likelihood, peak = relative_likelihood(self.sensor, frame)
        if last is None:
            weights = self.steps.births(1, frame.shape, (0, 0)) * (as_plane(born) * likelihood)
            mass = total(weights).sum(axis=0)
        else:
            weights, inside, mass = self.steps.forward(last, likelihood, stays, born)
            absent = absent + stays * (1.0 - inside)
        log_odds = np.log(mass) + peak - np.log(absent)
        return Belief(weights, mass, log_odds, likelihood, peak, last.frame + 1 if last else 1,
                      last.shift if last else (0, 0))

    def _backward(self, state: tuple[Belief, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Return log odds and g_t r_t, not normalised, of the oldest frame t, given all frames."""
        then, chain, steps = state[0], self.existence, self.steps
        if len(state) == 1:
            return then.log_odds, then.weights
        survives, shape = 1.0 - chain.death_prob, then.likelihood.shape
        ratio, gone = np.ones_like(state[-1].weights), None
        for later in state[:0:-1]:
            number, shift = later.frame, later.shift
            if gone is None or steps.vary(number):
                inside = np.ones((*ratio.shape[:3], *[1] * (len(shape) - 2), *shape[-2:]))
                gone = 1.0 - survives * steps.expected(number, inside, shift)
            # Numerator and denominator are divided by exp(peak), which could overflow.
            peak = np.maximum(later.peak, 0.0)
            one = np.exp(-peak)
            value = ratio * later.likelihood * as_plane(np.exp(later.peak - peak))
            present = survives * steps.expected(number, value, shift) + gone * as_plane(one)
            born = total(steps.births(number, shape, shift) * value).sum(axis=0)
            absent = (1.0 - chain.birth_prob) * one + chain.birth_prob * born
            ratio = steps.before(
                np.maximum(present / as_plane(absent), LEAST_RATIO), number)
        weights = then.given * ratio
        return then.log_odds + np.log(total(weights).sum(axis=0)), weights
