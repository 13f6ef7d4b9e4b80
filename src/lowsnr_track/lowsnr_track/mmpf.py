"""
The multiple-model particle filter: particles of states, each with its motion mode.

A mode switches first and then governs the step, so that ``modes`` holds r_k and ``states`` x_k
of the same frame.  The Markov chain acts in :func:`predict` alone, by drawing modes: weights are
never multiplied with transition probabilities, and a flat likelihood leaves the modes to the
chain.  Leading axes ``...`` are independent filters, one for each track.  See Ristic,
Arulampalam and Gordon, *Beyond the Kalman Filter* (2004), chapters 3 and 4.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace
from functools import cached_property

from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.particles import effective_size
from lowsnr_common.core.particles import normalise
from lowsnr_common.core.particles import systematic_resample
from lowsnr_common.core.particles import weighted_moments
import numpy as np


@dataclass(frozen=True)
class Particles:
    """
    Weighted particles that represent the posterior of state and mode.

    Parameters
    ----------
    states : (..., N, 4) ndarray
        States [m, m/s].
    modes : (..., N) ndarray of int
        Index of the mode that led to each state.
    log_weights : (..., N) ndarray
        Normalised log weights.

    """

    states: np.ndarray
    modes: np.ndarray
    log_weights: np.ndarray

    def __getitem__(self, index: np.ndarray) -> Particles:
        """Return the filters that an index along the first axis picks."""
        chosen = Particles(self.states[index], self.modes[index], self.log_weights[index])
        if 'moments' in self.__dict__:
            mean, cov = self.moments
            chosen.__dict__['moments'] = mean[index], cov[index]
        return chosen

    @cached_property
    def moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean (..., 4) and covariance (..., 4, 4) of the state."""
        return weighted_moments(self.states, self.log_weights)

    @cached_property
    def position_moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean (..., 2) and covariance (..., 2, 2) of the position."""
        return weighted_moments(self.states[..., POS], self.log_weights)

    def mode_probabilities(self, count: int) -> np.ndarray:
        """Return the probability of each of ``count`` modes, (..., count)."""
        is_mode = self.modes[..., None] == np.arange(count)
        probability: np.ndarray = np.sum(
            np.exp(self.log_weights)[..., None] * is_mode, axis=-2)
        return probability


def equally_weighted(states: np.ndarray, modes: np.ndarray) -> Particles:
    """Return particles of equal weight, from states (..., N, 4) and modes (..., N)."""
    return Particles(states, modes, np.full(modes.shape, -np.log(modes.shape[-1])))


def concatenate(first: Particles, second: Particles) -> Particles:
    """Return the filters of both, one after the other along the first axis."""
    return Particles(
        np.concatenate([first.states, second.states]),
        np.concatenate([first.modes, second.modes]),
        np.concatenate([first.log_weights, second.log_weights]))


def predict(
    particles: Particles, motion: MotionModes, dt: float, steps: int, rng: np.random.Generator,
) -> Particles:
    """
    Draw the particles a time ``dt`` later: in each step the mode switches, then the state moves.

    Parameters
    ----------
    particles
        Posterior of the frame before.
    motion
        Modes, their Markov chain and the process noise.
    dt
        Time since that frame [s].
    steps
        Number of equal steps that divide it; a mode may switch in each.
    rng
        Source of randomness.

    """
    states, modes = particles.states, particles.modes
    for _ in range(steps):
        modes = motion.switch(modes, dt / steps, rng)
        states = motion.move(states, modes, dt / steps, rng)
    return replace(particles, states=states, modes=modes)


def update(
    particles: Particles, log_likelihood: np.ndarray,
) -> tuple[Particles, np.ndarray]:
    """
    Multiply the weight of every particle by its likelihood.

    Parameters
    ----------
    particles
        Prior of the frame.
    log_likelihood : (..., N) ndarray
        Log-likelihood of each particle, up to a constant [nat].

    Returns
    -------
    Particles
        Posterior; uniform weights where every particle has likelihood zero.
    (...,) ndarray
        Log of the likelihood averaged over the prior; -inf where every one is zero.

    """
    log_weights, log_evidence = normalise(particles.log_weights + log_likelihood)
    return replace(particles, log_weights=log_weights), log_evidence


def resample(
    particles: Particles, below: float, power: float, roughening: float,
    rng: np.random.Generator,
) -> Particles:
    """
    Resample the filters whose effective size is low, and roughen the drawn particles.

    Particles are drawn by a power of their weights and keep the rest of it as their weight
    (Liu, Chen and Logvinenko 2001), so that unlikely hypotheses stay represented.  Roughening
    spreads the copies of one particle: it shrinks all towards the mean and adds noise, both by
    as much as leaves mean and covariance unchanged (Liu and West 2001).

    Parameters
    ----------
    particles : Particles
        Filters along one leading axis, (T, N).
    below
        Effective size, as a fraction of N, at or below which a filter is resampled.
    power
        Exponent of the weights by which particles are drawn, above 0 to 1; 1 leaves all
        weights equal.
    roughening
        Standard deviation of the noise, in units of ``N^(-1/4)`` standard deviations of the
        particles, the rate of Gordon, Salmond and Smith (1993) for four dimensions; 0 for none.
    rng
        Source of randomness.

    """
    if len(particles.modes) == 0:
        return particles
    count = particles.log_weights.shape[-1]
    low = np.flatnonzero(effective_size(particles.log_weights) <= below * count)
    if low.size == 0:
        return particles
    drawn = systematic_resample(power * particles.log_weights[low], count, rng)
    states, modes = particles.states.copy(), particles.modes.copy()
    log_weights = particles.log_weights.copy()
    width = min(roughening * count**-0.25, 1.0)
    mean, cov = particles.moments
    for t, index in zip(low, drawn):
        modes[t] = particles.modes[t].take(index)
        states[t] = particles.states[t].take(index, axis=0)
        log_weights[t], _ = normalise((1.0 - power) * particles.log_weights[t].take(index))
        if width > 0.0:
            _roughen(states[t], mean[t], cov[t], width, rng)
    return Particles(states, modes, log_weights)


def _roughen(
    states: np.ndarray, mean: np.ndarray, cov: np.ndarray, width: float,
    rng: np.random.Generator,
) -> None:
    """Shrink the states (N, 4) of one filter towards their mean and add noise, in place."""
    # Particles in a plane or a point have no Cholesky factor without the ridge.
    ridge = (1e-9 * np.trace(cov) + 1e-200) * np.eye(4)
    factor = width * np.linalg.cholesky(cov + ridge).T
    shrinkage = np.sqrt(1.0 - width**2)
    states *= shrinkage
    states += (1.0 - shrinkage) * mean
    # Pairs of opposite sign leave the mean where it is.
    half = len(states) // 2
    noise = rng.standard_normal((len(states) - half, 4)) @ factor
    states[half:] += noise
    states[:half] -= noise[:half]
