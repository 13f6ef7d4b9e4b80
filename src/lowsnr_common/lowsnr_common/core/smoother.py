# SPDX-License-Identifier: Apache-2.0
"""
Fixed-interval smoothing of the path of one object that switches between motion modes.

The model is that of :mod:`lowsnr_common.core.motion`: given its mode, the motion is linear and
Gaussian, and so are the measurements of position.  A filter keeps a normal density for each mode
(GPB2; Bar-Shalom, Li and Kirubarajan 2001, section 11.6.5).  The backward pass is expectation
correction: Barber, "Expectation correction for smoothed inference in switching linear dynamical
systems", JMLR 7 (2006), a step of Rauch, Tung and Striebel for each pair of modes.  With one mode
both are exact.
"""

from __future__ import annotations

from dataclasses import dataclass

from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import process_noise_cov
import numpy as np
import scipy


@dataclass(frozen=True)
class SmoothedPath:
    """
    The path of an object given all measurements.

    Parameters
    ----------
    states : (K, 4) ndarray
        Mean states [m, m/s].
    covs : (K, 4, 4) ndarray
        Their covariances.
    modes : (K, modes) ndarray
        Probability of each mode in the step that led to a state; of the first one, the prior.

    """

    states: np.ndarray
    covs: np.ndarray
    modes: np.ndarray


@dataclass(frozen=True)
class _Mixture:
    """A normal density for each mode: means (modes, 4), covariances, and log probabilities."""

    mean: np.ndarray
    cov: np.ndarray
    log_weight: np.ndarray


def smooth(
    motion: MotionModes, times_s: np.ndarray, positions: np.ndarray, noise: np.ndarray,
    start: np.ndarray, start_cov: np.ndarray,
) -> SmoothedPath:
    """
    Smooth a path.

    Note: ``Pr(r_k | r_{k+1}, all measurements)`` is taken to be that given the mean of the later
    state, as in Barber's (16) to (19), and mixtures over the other mode are replaced by normal
    densities with the same mean and covariance.  Without the later state (Kim 1994) errors are
    three times as large.

    Parameters
    ----------
    motion
        Motion modes.
    times_s : (K,) ndarray
        Times of the states, ascending [s].
    positions : (K, 2) ndarray
        Measured positions [m]; NaN where there is none.
    noise : (K, 2, 2) ndarray
        Covariances of their errors, positive definite [m^2].
    start, start_cov : (4,) and (4, 4) ndarray
        Mean and covariance of the first state before its measurement, positive definite.

    """
    count = motion.count
    begin = _Mixture(
        np.tile(start, (count, 1)), np.tile(start_cov, (count, 1, 1)),
        np.full(count, -np.log(count)))
    filtered = [_collapsed(*_measured(
        begin.mean[None], begin.cov[None], begin.log_weight[None], positions[0], noise[0]))]
    steps = [_Step.of(motion, dt) for dt in np.diff(times_s).tolist()]
    for step, position, cov in zip(steps, positions[1:], noise[1:], strict=True):
        filtered.append(_collapsed(*_measured(*step.predict(filtered[-1]), position, cov)))
    smoothed = [filtered[-1]]
    for step, before in zip(reversed(steps), reversed(filtered[:-1]), strict=True):
        smoothed.append(step.look_back(before, smoothed[-1]))
    totals = [_collapsed(each.mean[:, None], each.cov[:, None], each.log_weight[:, None])
              for each in reversed(smoothed)]
    return SmoothedPath(
        np.array([each.mean[0] for each in totals]), np.array([each.cov[0] for each in totals]),
        np.exp([each.log_weight for each in reversed(smoothed)]))


@dataclass(frozen=True)
class _Step:
    """One step of the model: F of each mode, Q, and the log probabilities of the Markov chain."""

    transition: np.ndarray
    noise: np.ndarray
    log_switch: np.ndarray

    @classmethod
    def of(cls, motion: MotionModes, dt: float) -> _Step:
        with np.errstate(divide='ignore'):  # a mode may not change within no time
            log_switch = np.log(motion.mode_transition(dt))
        return cls(motion.transition_matrices(dt), process_noise_cov(
            dt, motion.acceleration_density), log_switch)

    def predict(self, before: _Mixture) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return mean, covariance and log weight of each mode before [i] and after [j]."""
        f = self.transition
        mean = np.einsum('jab,ib->ija', f, before.mean)
        cov = f @ before.cov[:, None] @ f.swapaxes(-1, -2) + self.noise
        return mean, cov, before.log_weight[:, None] + self.log_switch

    def look_back(self, before: _Mixture, after: _Mixture) -> _Mixture:
        """Return the smoothed densities of a step from the filtered ones and those after it."""
        mean, cov, log_weight = self.predict(before)
        cross = before.cov[:, None] @ self.transition.swapaxes(-1, -2)
        gain = np.linalg.solve(cov, cross.swapaxes(-1, -2)).swapaxes(-1, -2)
        off = after.mean - mean
        smoothed = before.mean[:, None] + np.einsum('ijab,ijb->ija', gain, off)
        spread = before.cov[:, None] + gain @ (after.cov - cov) @ gain.swapaxes(-1, -2)
        log_weight = log_weight + _log_density(off, cov)
        log_weight = log_weight - scipy.special.logsumexp(log_weight, axis=0) + after.log_weight
        return _collapsed(
            smoothed.swapaxes(0, 1), spread.swapaxes(0, 1), log_weight.T)


def _measured(
    mean: np.ndarray, cov: np.ndarray, log_weight: np.ndarray, position: np.ndarray,
    noise: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return densities (..., 4) given a measured position, and their log weights."""
    if np.isnan(position).any():
        return mean, cov, log_weight
    across = cov[..., POS, :]
    innovation = across[..., POS] + noise
    off = position - mean[..., POS]
    gain = np.linalg.solve(innovation, across).swapaxes(-1, -2)
    return (
        mean + np.einsum('...ab,...b->...a', gain, off), cov - gain @ across,
        log_weight + _log_density(off, innovation))


def _log_density(off: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Return the log of a normal density (..., d) off its mean, but for a constant."""
    whitened = np.linalg.solve(cov, off[..., None])[..., 0]
    return np.asarray(-0.5 * (np.sum(off * whitened, axis=-1) + np.linalg.slogdet(cov)[1]))


def _collapsed(mean: np.ndarray, cov: np.ndarray, log_weight: np.ndarray) -> _Mixture:
    """Return mixtures over the first axis as normal densities of the same moments."""
    total = scipy.special.logsumexp(log_weight, axis=0)
    weight = np.exp(log_weight - np.where(np.isfinite(total), total, 0.0))[..., None]
    centre = np.sum(weight * mean, axis=0)
    off = mean - centre
    spread = cov + off[..., :, None] * off[..., None, :]
    merged = np.sum(weight[..., None] * spread, axis=0)
    return _Mixture(
        centre, (merged + merged.swapaxes(-1, -2)) / 2.0,
        total - scipy.special.logsumexp(total))
