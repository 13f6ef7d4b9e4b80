# SPDX-License-Identifier: Apache-2.0
"""
The multiple-model particle filter: particles of states, each with its motion mode.

A mode switches first and then governs the step, so that ``modes`` holds r_k and ``states`` x_k
of the same frame.  The Markov chain acts in :func:`predict` alone, by drawing modes: weights are
never multiplied with transition probabilities, and a flat likelihood leaves the modes to the
chain.  Leading axes ``...`` are independent filters, one for each track.  See Ristic,
Arulampalam and Gordon, *Beyond the Kalman Filter* (2004), chapters 3 and 4.
"""

from __future__ import annotations

from dataclasses import replace

from lowsnr_common.core.bound_motion import Bound
from lowsnr_common.core.bound_motion import move_bound
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import process_noise_sqrt
from lowsnr_common.core.particles import systematic_resample
from lowsnr_track import track_kernels
from lowsnr_track.particles import normalised
from lowsnr_track.particles import paired_noise
from lowsnr_track.particles import Particles
import numpy as np


def inside(
    particles: Particles, low: np.ndarray, high: np.ndarray,
) -> tuple[Particles, np.ndarray]:
    """
    Take their weight from particles out of bounds.

    Parameters
    ----------
    particles : Particles
        Filters along one leading axis, (T, N).
    low, high : (2,) ndarray
        Bounds of the position [m]; the upper one is out of bounds.

    Returns
    -------
    Particles
        The particles within; where there is none, the weights are uniform.
    (T,) ndarray
        Weight of the particles within.

    """
    fraction = np.ones(len(particles.modes))
    crossing = np.flatnonzero(
        np.any((particles.box[:, 0] < low) | (particles.box[:, 1] >= high), axis=-1))
    if crossing.size == 0:
        return particles, fraction
    position = particles.states[crossing][..., POS]
    within = np.all((position >= low) & (position < high), axis=-1)
    cut, log_fraction = update(particles[crossing], np.where(within, 0.0, -np.inf))
    log_weights = particles.log_weights.copy()
    log_weights[crossing], fraction[crossing] = cut.log_weights, np.exp(log_fraction)
    after = replace(particles, log_weights=log_weights)
    after.__dict__['box'] = particles.box
    return after, fraction


def predict(
    particles: Particles, motion: MotionModes, dt: float, steps: int, rng: np.random.Generator,
    left_s: np.ndarray | None = None,
) -> Particles:
    """
    Draw the particles a time ``dt`` later: in each step the mode switches, then the state moves.

    The n-th particles of all filters share their draws, unless they have destinations.  Each
    filter is as random as it would be alone.

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
    left_s : (..., N) ndarray, optional
        Time from that frame to the arrival of each particle that carries a destination [s].

    """
    states, modes, bound = particles.states, particles.modes, particles.bound
    step_s = dt / steps
    for number in range(1, steps + 1):
        if bound is None or left_s is None:
            states, modes = _move_tracks(states, modes, motion, step_s, rng)
        else:
            modes = motion.switch(modes, step_s, rng)
            states = move_bound(
                motion, states, modes, bound.place, left_s - number * step_s, step_s, rng)
    return replace(particles, states=states, modes=modes)


def _move_tracks(
    states: np.ndarray, modes: np.ndarray, motion: MotionModes, dt: float,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Return states (T, N, 4) and modes (T, N) after a step."""
    count = modes.shape[-1]
    cumulative = np.cumsum(motion.mode_transition(dt), axis=1)[:, :-1]
    noise = paired_noise(count, 4, rng) @ process_noise_sqrt(dt, motion.acceleration_density).T
    moved: tuple[np.ndarray, np.ndarray] = track_kernels.move_tracks(
        states, modes, cumulative, motion.transition_matrices(dt), rng.random(count), noise)
    return moved


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
    log_weights, weights, log_evidence = normalised(particles.log_weights + log_likelihood)
    after = replace(particles, log_weights=log_weights)
    after.__dict__['weights'] = weights
    return after, log_evidence


def resample(
    particles: Particles, below: float, power: float, roughening: float,
    rng: np.random.Generator, kept: np.ndarray | None = None,
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
    kept : (T,) ndarray of bool
        Filters to return; all by default.

    """
    if len(particles.modes) == 0:
        return particles
    count = particles.modes.shape[-1]
    chosen = np.arange(len(particles.modes)) if kept is None else np.flatnonzero(kept)
    size = 1.0 / np.einsum('tn,tn->t', particles.weights, particles.weights)[chosen]
    low = np.flatnonzero(size <= below * count)
    if low.size == 0:
        return particles if len(chosen) == len(particles.modes) else particles[chosen]
    source = chosen[low]
    draw = np.full(len(chosen), -1)
    draw[low] = np.arange(low.size)
    drawn = systematic_resample(power * particles.log_weights[source], count, rng)
    states, modes, log_weights = track_kernels.drawn_particles(
        particles.states, particles.modes, particles.log_weights, chosen, draw, drawn)
    weights = particles.weights[chosen]
    log_weights[low], weights[low], _ = normalised((1.0 - power) * log_weights[low])
    width = min(roughening * count**-0.25, 1.0)
    if width > 0.0:
        mean, cov = (part[source] for part in particles.moments)
        # Particles in a plane or a point have no Cholesky factor without the ridge.  It is in
        # proportion to each axis, so that nothing depends on the unit of time.
        ridge = 1e-9 * np.diagonal(cov, axis1=-2, axis2=-1) + 1e-200
        factor = width * np.linalg.cholesky(cov + ridge[:, None] * np.eye(4))
        track_kernels.roughen(
            states, low, mean, np.sqrt(1.0 - width**2), factor, paired_noise(count, 4, rng))
    bound = particles.bound and _drawn_bound(particles.bound, chosen, low, drawn)
    after = Particles(states, modes, log_weights, bound)
    after.__dict__['weights'] = weights
    return after


def _drawn_bound(bound: Bound, chosen: np.ndarray, low: np.ndarray, drawn: np.ndarray) -> Bound:
    """Return the destinations of the chosen tracks (C,), those in ``low`` drawn by (L, N)."""
    index = np.tile(np.arange(drawn.shape[1]), (len(chosen), 1))
    index[low] = drawn
    rows = chosen[:, None]
    return Bound(bound.place[rows, index], bound.arrival[rows, index])
