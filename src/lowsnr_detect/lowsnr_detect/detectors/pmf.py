# SPDX-License-Identifier: Apache-2.0
"""
PMF: the point-mass filter, the Bayes filter on a grid of positions finer than cells.

The hidden state is the existence E_k of the object (Section V) and x = (point, mode, heading,
speed), with R x R points in every cell.  With ``l_k`` the likelihood ratio of the cell of a
point, eq. (4), or with blur of the point itself, b(x) the distribution of a birth, uniform, and
``T(x | y)`` the transition probability that the motion model leads to
(:mod:`lowsnr_detect.grid.point_classes`), the recursion is that of HMM ::

    m_k(x) = P_b (1 - p_{k-1}) b(x) + (1 - P_d) p_{k-1} sum_y T(x | y) g_{k-1}(y)
    g_k(x) = l_k(x) m_k(x) / a_k,      a_k = sum_x l_k(x) m_k(x)
    o_k    = (1 - P_b) (1 - p_{k-1}) + p_{k-1} [ P_d + (1 - P_d) (1 - inside_k) ]
    log odds of E_k = 1:  ln a_k - ln o_k

where p is the probability of existence given Z^k, g that of x given existence, and inside_k the
probability that the moved object is still in the frame.  HMM remembers one or two moves of whole
cells, in which heading and speed hardly show; PMF knows them, and detects fainter objects at
several times the cost.  Unless ``decision`` asks for another, the state that is declared is the
mean of g within the 3 x 3 cells that hold most of it.

Where objects are bound for one of several destinations, each class holds the mass of every pair of
a destination and a frame of arrival (:mod:`lowsnr_detect.grid.bound_steps`).

With a fixed lag the answer is about frame t = k - lag, given all frames to k.  As in HMM the
ratio ``r_t(x)`` of the likelihoods of the frames after t, given x and given no object, follows
backwards from r_k = 1; what leaves the frame does not exist any more ::

    r_{j-1}(x) = { 1 + (1 - P_d) sum_y T(y | x) [ l_j(y) r_j(y) - 1 ] }
                 / { 1 - P_b + P_b sum_y b(y) l_j(y) r_j(y) }
    log odds of E_t = 1:  log odds after frame t + ln sum_x g_t(x) r_t(x)
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace
from typing import ClassVar

from lowsnr_common.core.bound_motion import Destinations
from lowsnr_common.core.likelihood import relative_likelihood
from lowsnr_common.settings.declare import setting
from lowsnr_detect.grid.bound_steps import bound_count
from lowsnr_detect.grid.bound_steps import folded
from lowsnr_detect.grid.bound_steps import pairs
from lowsnr_detect.grid.bound_steps import StateGrid
from lowsnr_detect.grid.bound_steps import step_arrays
from lowsnr_detect.grid.bound_steps import Tilt
from lowsnr_detect.grid.bound_steps import tilts
from lowsnr_detect.grid.bound_steps import unfolded
from lowsnr_detect.grid.fixed_lag import LEAST_RATIO
from lowsnr_detect.grid.grid_detector import GridDetector
from lowsnr_detect.grid.grid_posterior import GridBelief
from lowsnr_detect.grid.point_classes import point_transitions
from lowsnr_detect.grid.transitions import expect
from lowsnr_detect.grid.transitions import predict
from lowsnr_detect.grid.transitions import Transitions
from lowsnr_detect.parts.local_estimate import Posterior
from lowsnr_detect.parts.moves import shifted
from lowsnr_detect.parts.registry import register
import numpy as np


@dataclass(frozen=True)
class Belief:
    """
    The posterior after a frame, ``g_k(x) = scale * planes``.

    Parameters
    ----------
    planes : (C, 1 + n, ..., R rows, R cols) ndarray
        m_k of each class, of objects bound for none and of each pair ahead, and point.
    scale : (..., R rows, R cols) ndarray
        l_k / a_k of each point.
    mass : (..., R rows, R cols) ndarray
        Sum of g_k over the classes.
    log_odds : (...,) ndarray
        Log odds of existence [nat].
    likelihood : (..., R rows, R cols) ndarray
        l_k of each point, divided by its largest value.
    peak : (...,) ndarray
        Log of that value [nat].
    resolution
        Points R per cell and axis.
    frame
        Number of the frame, from 1.
    shift
        Rows and columns by which the first cell has moved in the scene.

    """

    planes: np.ndarray
    scale: np.ndarray
    mass: np.ndarray
    log_odds: np.ndarray
    likelihood: np.ndarray
    peak: np.ndarray
    resolution: int
    frame: int
    shift: tuple[int, int] = (0, 0)

    def moved(self, by: tuple[int, int], cell_size_m: float) -> Belief:
        """Return the belief in cells whose first one moved ``by`` rows and columns."""
        step = -self.resolution * np.array(by)
        planes, scale, mass, likelihood = (
            shifted(each, step, 0.0)
            for each in (self.planes, self.scale, self.mass, self.likelihood))
        return replace(
            self, planes=planes, scale=scale, mass=mass, likelihood=likelihood,
            shift=(self.shift[0] + by[0], self.shift[1] + by[1]))


@register('pmf')
@dataclass(frozen=True, kw_only=True)
class PMF(GridDetector):
    """Forward recursion of ``p(point, mode, heading, speed, E_k | Z^k)``."""

    costly: ClassVar[tuple[str, ...]] = ('resolution', 'headings', 'speeds', 'destinations')

    destinations: Destinations = field(default_factory=Destinations)
    resolution: int = setting(2, 'points per cell and axis', ge=1, le=8)
    headings: int = setting(24, 'intervals of the heading', ge=4, le=128)
    speeds: int = setting(2, 'intervals of the speed', ge=1, le=16)
    regions: int = setting(
        1, 'sub-regions of the frame that are processed in parallel; the result is the same',
        ge=1, le=64)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.destinations.check_motion(self.motion)

    @property
    def transitions(self) -> Transitions:
        """Transition probabilities T(x | y)."""
        return point_transitions(
            self.motion, self.sensor.cell_size_m / self.resolution, self.sensor.frame_period_s,
            self.headings, self.speeds)

    @property
    def state_planes(self) -> int:
        """Return the number of classes, points in a cell, and what an object is bound for."""
        classes = self.headings * self.speeds * self.motion.count
        return self.resolution**2 * classes * bound_count(self.destinations)

    @property
    def step_arrays(self) -> int:
        """Return how many arrays of all states a step makes."""
        return step_arrays(self.destinations)

    def filtered(self, last: Belief | None, frame: np.ndarray) -> Belief:
        """Predict, and weigh by the frame."""
        born, stays, absent = self.existence.predict(last.log_odds if last else None)
        weight, peak = relative_likelihood(self.sensor, frame, self.resolution)
        planes, mass = self._predicted(last, weight, stays, born)
        # What left the frame no longer exists; rounding may leave less than nothing.
        absent = absent + np.maximum(born + stays - mass.sum(axis=(-2, -1)), 0.0)
        total = (mass * weight).sum(axis=(-2, -1))
        scale = weight / total[..., None, None]
        log_odds = np.log(total) + peak - np.log(absent)
        return Belief(
            planes, scale, mass * scale, log_odds, weight, peak, self.resolution,
            last.frame + 1 if last else 1, last.shift if last else (0, 0))

    def _predicted(
        self, last: Belief | None, weight: np.ndarray, stays: np.ndarray, born: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return m_k of each class, what it is bound for and point, and of each point."""
        number, transitions = last.frame + 1 if last else 1, self.transitions
        shares = pairs(self.destinations).shares(number)
        shape, points = (len(shares), *weight.shape), weight.shape[-2] * weight.shape[-1]
        births = np.multiply.outer(shares, np.broadcast_to(born / points, weight.shape[:-2]))
        scale = np.broadcast_to(last.scale if last else 0.0, shape)
        planes = (folded(last.planes, len(shares)) if last
                  else np.zeros((transitions.count, *shape)))
        if len(shares) == 1 or last is None:
            planes, mass = predict(transitions, planes, scale, stays, births, self.regions)
            return planes, mass.sum(axis=0)
        planes = self._tilt(number, weight.shape, last.shift).moved(lambda mass: predict(
            transitions, mass, scale, stays, np.zeros_like(births), self.regions)[0], planes)
        planes += np.multiply.outer(transitions.appears, births)[..., None, None]
        return planes, planes.sum(axis=(0, 1))

    def _tilt(self, number: int, shape: tuple[int, ...], shift: tuple[int, int]) -> Tilt:
        """Return what destinations make of the steps into a frame."""
        transitions = self.transitions
        return tilts(pairs(self.destinations), StateGrid(
            transitions.velocity, transitions.velocity_cov, self.sensor,
            self.motion.acceleration_density, int(abs(transitions.step).max()), self._expect,
            self.resolution), number, shape, shift)

    def _expect(self, values: np.ndarray) -> np.ndarray:
        """Return the expectations of values after a step of the base motion."""
        return expect(self.transitions, values, self.regions)

    def located(self, beliefs: tuple[Belief, ...]) -> tuple[np.ndarray, Posterior]:
        """Return log odds and posterior in the frame of the first belief, given all of them."""
        then, *later = beliefs
        planes, mass, log_odds = then.planes, then.mass, then.log_odds
        if later:
            planes = planes * self._ratio(later)
            mass = planes.sum(axis=(0, 1)) * then.scale
            log_odds = log_odds + np.log(mass.sum(axis=(-2, -1)))
        velocity, cov = (each.repeat(planes.shape[1], axis=0) for each in (
            self.transitions.velocity, self.transitions.velocity_cov))
        where = GridBelief(
            planes.reshape(-1, *planes.shape[2:]), then.scale, velocity, cov,
            self.sensor.cell_size_m, self.resolution)
        return log_odds, where.posterior(
            lambda runs: mass[runs], None if self.lag else then.likelihood, then.peak)

    def _ratio(self, later: list[Belief]) -> np.ndarray:
        """Return r_t (C, 1 + n, ..., R rows, R cols), given the beliefs after frame t."""
        survives, born = 1.0 - self.existence.death_prob, self.existence.birth_prob
        appears, bound = self.transitions.appears, pairs(self.destinations)
        ratio = np.ones_like(later[-1].planes)
        for belief in later[::-1]:
            # Numerator and denominator are divided by exp(peak), which could overflow.
            peak = np.maximum(belief.peak, 0.0)
            one = np.exp(-peak)
            # In place: arrays of many planes cost more to make than to fill.
            ratio *= belief.likelihood * np.exp(belief.peak - peak)[..., None, None]
            births = np.einsum('c,c...->...', appears, ratio).mean(axis=(-2, -1))
            births = np.tensordot(bound.shares(belief.frame), births, 1)
            ratio -= one[..., None, None]
            if ratio.shape[1] == 1:
                ratio = self._expect(ratio)
            else:
                ratio = self._tilt(belief.frame, belief.likelihood.shape, belief.shift).expected(
                    self._expect, ratio)
            ratio *= survives
            ratio += one[..., None, None]
            ratio /= ((1.0 - born) * one + born * births)[..., None, None]
            np.maximum(ratio, LEAST_RATIO, out=ratio)
            ratio = unfolded(ratio, 1 + bound.ahead(belief.frame - 1))
        return ratio
