# SPDX-License-Identifier: Apache-2.0
"""
TBD2 and MMTBD2, Section V-B: the presence probability from birth and continuing particles.

The filter of Rutten, Gordon and Maskell (2005) estimates the two terms of eq. (9),
``p(x_k, r_k | E_k = 1, Z^k)`` by particles and ``p_k = p(E_k = 1 | Z^k)``.  With l(x) the
likelihood ratio of a state, eq. (3), b and q density and proposal of the births, the
unnormalised weights are ::

    birth particles, N_b:        w = P_b (1 - p_{k-1}) l(x) b(x) / (q(x) N_b)
    continuing particles, N_c:   w = (1 - P_d) p_{k-1} l(x) / N_c

where the continuing particles moved by their mode, ``x_k = F(r_k) x_{k-1} + v_k``, and ::

    p_k / (1 - p_k) = sum of all w / [ (1 - P_b) (1 - p_{k-1}) + P_d p_{k-1} + gone ]

with ``gone`` the probability (1 - P_d) p_{k-1} times the fraction of the continuing particles
that left the frame.  N_c particles are then resampled from all.  With one mode it is TBD2, with
several MMTBD2.

Note: births are proposed where the frame is bright (:mod:`lowsnr_detect.parts.births`), of
which the paper gives no details.  A destination, which the paper's Section VII proposes,
multiplies the weights by its arrival likelihood.  Of several destinations, with an unknown time
of arrival, each particle carries one from its birth on (:mod:`lowsnr_common.core.bound_motion`).
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace

from lowsnr_common.core.bound_motion import Bound
from lowsnr_common.core.bound_motion import Destinations
from lowsnr_common.core.bound_motion import draw_bound
from lowsnr_common.core.bound_motion import move_bound
from lowsnr_common.core.destination import Destination
from lowsnr_common.core.destination import move_towards
from lowsnr_common.core.destination import state_likelihood
from lowsnr_common.core.frame_map import moved_states
from lowsnr_common.core.likelihood import state_log_ratio
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.particles import normalise
from lowsnr_common.core.particles import pick
from lowsnr_common.core.particles import systematic_resample
from lowsnr_common.settings.declare import setting
from lowsnr_detect.parts.births import ConstantVelocity
from lowsnr_detect.parts.births import draw_births
from lowsnr_detect.parts.births import log_birth_proposal
from lowsnr_detect.parts.detector import Declarations
from lowsnr_detect.parts.existence import declare_posterior
from lowsnr_detect.parts.existence import PosteriorDetector
from lowsnr_detect.parts.local_estimate import particle_posterior
from lowsnr_detect.parts.local_estimate import Posterior
from lowsnr_detect.parts.registry import register
import numpy as np


@dataclass(frozen=True)
class Particles:
    """
    Equally weighted particles given that there is an object, and the odds of its existence.

    Parameters
    ----------
    states : (..., N, 4) ndarray
        States [m, m/s].
    modes : (..., N) ndarray of int
        Modes.
    log_odds : (...,) ndarray
        Log odds of existence [nat].
    frame
        Number of the frame, from 1.
    bound : Bound of (..., N) or None
        Their destinations; None where there are none.
    shift
        Rows and columns by which the first cell has moved in the scene.

    """

    states: np.ndarray
    modes: np.ndarray
    log_odds: np.ndarray
    frame: int
    bound: Bound | None = None
    shift: tuple[int, int] = (0, 0)

    def moved(self, by: tuple[int, int], cell_size_m: float) -> Particles:
        """Return the particles in cells whose first one moved ``by`` rows and columns."""
        return replace(
            self, states=moved_states(self.states, by, cell_size_m),
            bound=self.bound and self.bound.moved(by, cell_size_m),
            shift=(self.shift[0] + by[0], self.shift[1] + by[1]))


@register('mmtbd2')
@dataclass(frozen=True, kw_only=True)
class MMTBD2(PosteriorDetector):
    """Multiple-model particle filter with birth particles and continuing particles."""

    destination: Destination = field(default_factory=Destination)
    destinations: Destinations = field(default_factory=Destinations)
    particles: int = setting(3000, 'continuing particles N_c', ge=1, le=10_000_000)
    birth_particles: int = setting(1000, 'birth particles N_b', ge=1, le=10_000_000)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.destinations.check_only(self.destination)
        self.destinations.check_motion(self.motion)

    def step(
        self, state: Particles | None, frame: np.ndarray, rng: np.random.Generator,
    ) -> tuple[Particles, Declarations]:
        """
        Predict, weight, decide and resample.

        Parameters
        ----------
        state : Particles or None
            Memory after the last frame; None before the first.
        frame : (..., rows, cols) ndarray
            Cell intensities.
        rng
            Source of randomness.

        """
        born, stays, absent = self.existence.predict(state.log_odds if state else None)
        number = state.frame + 1 if state else 1
        shift = state.shift if state else (0, 0)
        states, modes, log_weights = self._births(number, frame, shift, rng)
        log_weights = log_weights + np.log(born)[..., None]
        bound = self._bound(state, modes.shape, rng)
        if state:
            moved, moved_modes, log_factor = self._continuing(state, frame.shape, rng)
            log_moved = state_log_ratio(self.sensor, frame, moved)
            absent = absent + stays * np.mean((log_moved == -np.inf) * np.exp(log_factor), axis=-1)
            log_moved += np.log(stays / self.particles)[..., None] + log_factor
            states = np.concatenate([states, moved], axis=-2)
            modes = np.concatenate([modes, moved_modes], axis=-1)
            log_weights = np.concatenate([log_weights, log_moved], axis=-1)
        log_weights, log_sum = normalise(log_weights)
        log_odds = log_sum - np.log(absent)
        chosen = systematic_resample(log_weights, self.particles, rng)
        bound = bound and Bound(pick(bound.place, chosen), pick(bound.arrival, chosen))
        resampled = Particles(
            pick(states, chosen), pick(modes, chosen), log_odds, number, bound, shift)
        return resampled, declare_posterior(
            log_odds, self.threshold, self.decision,
            particle_posterior(self.sensor, frame.shape[-2:], states, log_weights))

    def posterior(
        self, state: Particles, shape: tuple[int, ...],
    ) -> tuple[np.ndarray, Posterior]:
        """Return log odds of existence and the posterior of the resampled particles."""
        return state.log_odds, particle_posterior(
            self.sensor, (shape[-2], shape[-1]), state.states, np.zeros(state.modes.shape))

    def _bound(
        self, state: Particles | None, born: tuple[int, ...], rng: np.random.Generator,
    ) -> Bound | None:
        """Return the destinations of births and continuing particles, if there are any."""
        if not self.destinations.densities:
            return None
        births = draw_bound(self.destinations.densities, born, rng)
        if not (state and state.bound):
            return births
        births = births.moved(state.shift, self.sensor.cell_size_m)
        return Bound.join([births, state.bound])

    def _continuing(
        self, state: Particles, shape: tuple[int, ...], rng: np.random.Generator,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | float]:
        """Move the continuing particles; return states, modes and log factor of the weights."""
        period, number = self.sensor.frame_period_s, state.frame + 1
        modes = self.motion.switch(state.modes, period, rng)
        if state.bound:
            return move_bound(
                self.motion, state.states, modes, state.bound.place,
                state.bound.left_s(number, period), period, rng), modes, 0.0
        if not self.destination.is_ahead(number):
            return self.motion.move(state.states, modes, period, rng), modes, 0.0
        states, log_factor = move_towards(
            self._destination(state.shift), self.motion, state.states, modes, number, period,
            _area_m2(self.sensor, shape), rng)
        return states, modes, log_factor

    def _destination(self, shift: tuple[int, int]) -> Destination:
        """Return where objects are bound for in cells whose first one has moved."""
        return self.destination.moved(shift, self.sensor.cell_size_m)

    def _births(
        self, number: int, frame: np.ndarray, shift: tuple[int, int], rng: np.random.Generator,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Draw the birth particles; return states, modes and ln(l b / (q N_b))."""
        proposal = log_birth_proposal(self.sensor.log_likelihood_ratio(frame))
        cells = systematic_resample(proposal, self.birth_particles, rng)
        states, modes = draw_births(cells, frame.shape[-1], self.sensor, self.motion, rng)
        correction = -np.log(proposal.shape[-1] * self.birth_particles) - pick(proposal, cells)
        if self.destination.is_ahead(number):
            correction += np.log(state_likelihood(
                self._destination(shift), states, number, self.sensor.frame_period_s,
                _area_m2(self.sensor, frame.shape)))
        return states, modes, state_log_ratio(self.sensor, frame, states) + correction


def _area_m2(sensor: SensorModel, shape: tuple[int, ...]) -> float:
    """Return the area of a frame (..., rows, cols)."""
    return shape[-2] * shape[-1] * sensor.cell_size_m**2


@register('tbd2')
@dataclass(frozen=True, kw_only=True)
class TBD2(MMTBD2):
    """MMTBD2 with one mode: constant velocity."""

    motion: ConstantVelocity = field(default_factory=ConstantVelocity)
