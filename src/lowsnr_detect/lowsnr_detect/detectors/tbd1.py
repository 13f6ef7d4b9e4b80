# SPDX-License-Identifier: Apache-2.0
"""
TBD1 and MMTBD1, Section V-A: existence is one more variable that the particles carry.

The filter of Salmond and Birch (2001) estimates ``p(x_k, r_k, E_k | Z^k)`` with particles
(x, r, E) of state, mode and existence, which each frame

1. predicts: E_k from its Markov chain (P_b, P_d); where an object survives, r_k from the chain of
   the modes and then ``x_k = F(r_k) x_{k-1} + v_k``, eq. (1); where it is born, x_k and r_k from
   the birth density b through a proposal q, with the weight ``b(x) / q(x)``;
2. weights: with the likelihood ratio ``l(x) = p(Z_k | x) / p(Z_k | no object)``, eq. (3), where
   E_k = 1, and with 1 where E_k = 0;
3. decides: ``p(E_k = 1 | Z^k) = sum of the weights with E_k = 1 / sum of all weights``;
4. resamples.

With one mode it is TBD1, with several MMTBD1.

Note: births are proposed where the frame is bright (:mod:`lowsnr_detect.parts.births`), of
which the paper gives no details.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace

from lowsnr_common.core.frame_map import moved_states
from lowsnr_common.core.likelihood import state_log_ratio
from lowsnr_common.core.particles import log_sum_exp
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
    Equally weighted particles.

    Parameters
    ----------
    exists : (..., N) ndarray of bool
        Existence of the object.
    states : (..., N, 4) ndarray
        States [m, m/s]; without meaning where there is no object.
    modes : (..., N) ndarray of int
        Modes; without meaning where there is no object.

    """

    exists: np.ndarray
    states: np.ndarray
    modes: np.ndarray

    def moved(self, by: tuple[int, int], cell_size_m: float) -> Particles:
        """Return the particles in cells whose first one moved ``by`` rows and columns."""
        return replace(self, states=moved_states(self.states, by, cell_size_m))


@register('mmtbd1')
@dataclass(frozen=True, kw_only=True)
class MMTBD1(PosteriorDetector):
    """Multiple-model particle filter whose particles carry the existence of the object."""

    particles: int = setting(4000, 'particles, with and without an object', ge=1, le=10_000_000)

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
        now, log_weights = self._predicted(state, frame, rng)
        ratio = state_log_ratio(self.sensor, frame, now.states)
        # An object that moved out of the frame does not exist.
        exists = now.exists & (ratio > -np.inf)
        with_object = np.where(exists, log_weights + ratio, -np.inf)
        without = np.where(exists, -np.inf, 0.0)
        log_odds = log_sum_exp(with_object) - log_sum_exp(without)
        chosen = systematic_resample(np.where(exists, with_object, without), self.particles, rng)
        resampled = Particles(
            pick(exists, chosen), pick(now.states, chosen), pick(now.modes, chosen))
        return resampled, declare_posterior(
            log_odds, self.threshold, self.decision,
            particle_posterior(self.sensor, frame.shape[-2:], now.states, with_object))

    def posterior(
        self, state: Particles, shape: tuple[int, ...],
    ) -> tuple[np.ndarray, Posterior]:
        """Return log odds and posterior that the particles represent once resampled."""
        number = np.asarray(np.count_nonzero(state.exists, axis=-1))
        with np.errstate(divide='ignore'):
            log_odds = np.log(number) - np.log(np.maximum(self.particles - number, 0.5))
        return np.asarray(log_odds), particle_posterior(
            self.sensor, (shape[-2], shape[-1]), state.states,
            np.where(state.exists, 0.0, -np.inf))

    def _predicted(
        self, state: Particles | None, frame: np.ndarray, rng: np.random.Generator,
    ) -> tuple[Particles, np.ndarray]:
        """Draw existence, mode and state; return them with their log weights."""
        chain, period = self.existence, self.sensor.frame_period_s
        proposal = log_birth_proposal(self.sensor.log_likelihood_ratio(frame))
        # One birth is drawn for every particle; a particle whose object survives ignores it.
        cells = systematic_resample(proposal, self.particles, rng)
        states, modes = draw_births(cells, frame.shape[-1], self.sensor, self.motion, rng)
        correction = -np.log(proposal.shape[-1]) - pick(proposal, cells)
        draw = rng.random(cells.shape)
        if state is None:
            return Particles(draw < chain.initial_prob, states, modes), correction
        old_modes = self.motion.switch(state.modes, period, rng)
        old_states = self.motion.move(state.states, old_modes, period, rng)
        was = state.exists
        exists = np.where(was, draw >= chain.death_prob, draw < chain.birth_prob)
        return Particles(
            exists, np.where(was[..., None], old_states, states), np.where(was, old_modes, modes),
        ), np.where(was, 0.0, correction)


@register('tbd1')
@dataclass(frozen=True, kw_only=True)
class TBD1(MMTBD1):
    """MMTBD1 with one mode: constant velocity."""

    motion: ConstantVelocity = field(default_factory=ConstantVelocity)
