"""
The multiple-model particle filter: a weighted cloud of states, each with its mode.

A mode switches first and then governs the step, so that in every cloud ``modes`` is r_k and
``states`` x_k of the same frame.  The chain acts in :func:`predict` by drawing and nowhere
else: weights are never multiplied with transition probabilities, and a flat likelihood
leaves the modes to the chain.  Leading axes ``...`` are independent clouds, one a track.
See Ristic, Arulampalam and Gordon, *Beyond the Kalman Filter* (2004), chapters 3 and 4.
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
class Cloud:
    """
    Particles that stand for the posterior of state and mode.

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

    def __getitem__(self, index: np.ndarray) -> Cloud:
        """Return the clouds that an index along the first axis picks."""
        chosen = Cloud(self.states[index], self.modes[index], self.log_weights[index])
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
        return np.sum(np.exp(self.log_weights)[..., None] * is_mode, axis=-2)


def uniform_cloud(states: np.ndarray, modes: np.ndarray) -> Cloud:
    """Return particles of equal weight, from states (..., N, 4) and modes (..., N)."""
    return Cloud(states, modes, np.full(modes.shape, -np.log(modes.shape[-1])))


def concatenate(first: Cloud, second: Cloud) -> Cloud:
    """Return the clouds of both, one after the other along the first axis."""
    return Cloud(
        np.concatenate([first.states, second.states]),
        np.concatenate([first.modes, second.modes]),
        np.concatenate([first.log_weights, second.log_weights]))


def predict(
    cloud: Cloud, motion: MotionModes, dt: float, steps: int, rng: np.random.Generator,
) -> Cloud:
    """
    Draw where the particles are ``dt`` later: in each step switch first, then move.

    Parameters
    ----------
    cloud
        Posterior before.
    motion
        Modes, their Markov chain and the process noise.
    dt
        Time that passes [s].
    steps
        Number of equal steps it is divided into; a mode may switch in each.
    rng
        Source of randomness.

    """
    states, modes = cloud.states, cloud.modes
    for _ in range(steps):
        modes = motion.switch(modes, dt / steps, rng)
        states = motion.move(states, modes, dt / steps, rng)
    return replace(cloud, states=states, modes=modes)


def update(cloud: Cloud, log_likelihood: np.ndarray) -> tuple[Cloud, np.ndarray]:
    """
    Weigh every particle by its likelihood.

    Parameters
    ----------
    cloud
        Prior of the frame.
    log_likelihood : (..., N) ndarray
        Log-likelihood of each particle, up to a constant [nat].

    Returns
    -------
    Cloud
        Posterior; uniform weights where every particle was impossible.
    (...,) ndarray
        Log of the likelihood averaged over the prior; -inf where all was impossible.

    """
    log_weights, log_evidence = normalise(cloud.log_weights + log_likelihood)
    return replace(cloud, log_weights=log_weights), log_evidence


def resample(
    cloud: Cloud, below: float, power: float, roughening: float, rng: np.random.Generator,
) -> Cloud:
    """
    Resample the clouds whose effective size has fallen, and roughen what was drawn.

    Particles are drawn by a power of their weights and keep the rest of it as their weight
    (Liu, Chen and Logvinenko 2001), so that unlikely hypotheses stay represented.  Copies of
    one particle are pulled towards the mean and scattered again, both by as much as leaves mean
    and covariance of the cloud as they were (Liu and West 2001).

    Parameters
    ----------
    cloud : Cloud
        Clouds along one leading axis, (T, N).
    below
        Share of N at or below which the effective size brings on resampling.
    power
        Exponent of the weights by which particles are drawn, above 0 to 1; 1 leaves all
        weights equal.
    roughening
        Width of the scatter in units of ``N^(-1/4)`` standard deviations of the cloud, the rate
        of Gordon, Salmond and Smith (1993) for four dimensions; 0 for none.
    rng
        Source of randomness.

    """
    if len(cloud.modes) == 0:
        return cloud
    count = cloud.log_weights.shape[-1]
    worn = np.flatnonzero(effective_size(cloud.log_weights) <= below * count)
    if worn.size == 0:
        return cloud
    drawn = systematic_resample(power * cloud.log_weights[worn], count, rng)
    states, modes, log_weights = cloud.states.copy(), cloud.modes.copy(), cloud.log_weights.copy()
    width = min(roughening * count**-0.25, 1.0)
    mean, cov = cloud.moments
    for t, index in zip(worn, drawn):
        modes[t] = cloud.modes[t].take(index)
        states[t] = cloud.states[t].take(index, axis=0)
        log_weights[t], _ = normalise((1.0 - power) * cloud.log_weights[t].take(index))
        if width > 0.0:
            _roughen(states[t], mean[t], cov[t], width, rng)
    return Cloud(states, modes, log_weights)


def _roughen(
    states: np.ndarray, mean: np.ndarray, cov: np.ndarray, width: float,
    rng: np.random.Generator,
) -> None:
    """Pull the states (N, 4) of one cloud towards its mean and scatter them, in place."""
    # A cloud may lie in a plane or a point, which has no Cholesky factor.
    ridge = (1e-9 * np.trace(cov) + 1e-200) * np.eye(4)
    factor = width * np.linalg.cholesky(cov + ridge).T
    keep = np.sqrt(1.0 - width**2)
    states *= keep
    states += (1.0 - keep) * mean
    # Pairs of opposite sign leave the mean where it is.
    half = len(states) // 2
    noise = rng.standard_normal((len(states) - half, 4)) @ factor
    states[half:] += noise
    states[:half] -= noise[:half]
