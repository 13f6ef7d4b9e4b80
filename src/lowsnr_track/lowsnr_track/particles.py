# SPDX-License-Identifier: Apache-2.0
"""Weighted particles of the tracks of a frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from lowsnr_common.core.bound_motion import Bound
from lowsnr_common.core.streams import standard_normal
from lowsnr_track import track_kernels
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
    bound : Bound of (..., N) or None
        Where each particle is bound for; None where there are no destinations.

    """

    states: np.ndarray
    modes: np.ndarray
    log_weights: np.ndarray
    bound: Bound | None = None

    def __getitem__(self, index: np.ndarray) -> Particles:
        """Return the filters that an index along the first axis picks."""
        chosen = Particles(
            self.states[index], self.modes[index], self.log_weights[index],
            self.bound and self.bound[index])
        if 'weights' in self.__dict__:
            chosen.__dict__['weights'] = self.weights[index]
        if 'moments' in self.__dict__:
            mean, cov = self.moments
            chosen.__dict__['moments'] = mean[index], cov[index]
        return chosen

    @cached_property
    def weights(self) -> np.ndarray:
        """Weights (..., N), which sum to one."""
        weights: np.ndarray = np.exp(self.log_weights)
        return weights

    @cached_property
    def moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean (..., 4) and covariance (..., 4, 4) of the state."""
        found: tuple[np.ndarray, np.ndarray] = track_kernels.moments(
            np.ascontiguousarray(self.states), np.ascontiguousarray(self.weights))
        return found

    @cached_property
    def box(self) -> np.ndarray:
        """Least and largest position along either axis, (..., 2, 2)."""
        found: np.ndarray = track_kernels.boxes(np.ascontiguousarray(self.states))
        return found

    def mode_probabilities(self, count: int) -> np.ndarray:
        """Return the probability of each of ``count`` modes, (..., count)."""
        is_mode = self.modes[..., None] == np.arange(count)
        probability: np.ndarray = np.sum(self.weights[..., None] * is_mode, axis=-2)
        return probability


def normalised(log_weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Scale weights to sum to one.

    Parameters
    ----------
    log_weights : (..., N) ndarray
        Log weights; the array is overwritten.

    Returns
    -------
    (..., N) ndarray
        Normalised log weights; uniform where every weight is zero.
    (..., N) ndarray
        The weights themselves.
    (...,) ndarray
        Log of the sum of the weights; -inf where every weight is zero.

    """
    peak = log_weights.max(axis=-1, keepdims=True)
    dead = peak[..., 0] == -np.inf
    if dead.any():
        log_weights[dead], peak[dead] = 0.0, 0.0
    log_weights -= peak
    weights = np.exp(log_weights)
    total = weights.sum(axis=-1, keepdims=True)
    weights /= total
    log_weights -= np.log(total)
    log_sum = (peak + np.log(total))[..., 0]
    return log_weights, weights, np.where(dead, -np.inf, log_sum)


def equally_weighted(states: np.ndarray, modes: np.ndarray) -> Particles:
    """Return particles of equal weight, from states (..., N, 4) and modes (..., N)."""
    return Particles(states, modes, np.full(modes.shape, -np.log(modes.shape[-1])))


def concatenate(first: Particles, second: Particles) -> Particles:
    """Return the filters of both, one after the other along the first axis."""
    if len(first.modes) == 0:  # which does not say whether there are destinations
        return second
    both = Particles(
        np.concatenate([first.states, second.states]),
        np.concatenate([first.modes, second.modes]),
        np.concatenate([first.log_weights, second.log_weights]),
        first.bound and second.bound and Bound(
            np.concatenate([first.bound.place, second.bound.place]),
            np.concatenate([first.bound.arrival, second.bound.arrival])))
    both.__dict__['weights'] = np.concatenate([first.weights, second.weights])
    return both


def paired_noise(count: int, axes: int, rng: np.random.Generator) -> np.ndarray:
    """Return standard normal noise (count, axes) in pairs of opposite sign."""
    half = count // 2
    noise = standard_normal((count - half, axes), rng)
    return np.concatenate([noise, -noise[:half]])
