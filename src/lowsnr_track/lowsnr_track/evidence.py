# SPDX-License-Identifier: Apache-2.0
"""
Soft evidence: what a frame alone says of an object that a detector with a posterior declares.

Successive posteriors share all frames before, so that a track must not take each as a new
measurement.  What is new in a frame is the ratio of the posterior to what the detector predicted
before it.  With the odds o of an object, and Gaussian densities of its position x, the likelihood
ratio of the frame, "of an object in x" against "of none", is ::

    l(x) = (o / o') N(x; m, C) / N(x; m', C')

where the prime is the prediction.  It is that of an equivalent measurement z with covariance R ::

    R^-1 = C^-1 - C'^-1,    R^-1 z = C^-1 m - C'^-1 m'
    l(x) = (o / o') N(z; x, R) / N(z; m', R + C')

A track that predicts what the detector predicts has the detector's existence, state and
covariance after the frame; one that knows more, such as the velocity, has better ones.
"""

from __future__ import annotations

from dataclasses import dataclass

from lowsnr_common.core.particles import log_sum_exp
from lowsnr_track.data_association import association
from lowsnr_track.measurements import Measurements
from lowsnr_track.particles import Particles
from lowsnr_track.tracks import MAX_EXISTENCE
from lowsnr_track.tracks import Tracks
import numpy as np
import scipy

# Largest variance of the posterior, as a fraction of that predicted, in any direction: a frame
# that says less of a position is taken to say so much.
_MOST_VARIANCE = 0.95
# Probabilities nearer to 0 or 1 would lose the last digits of their odds.
_LEAST_PROB = 1e-12


@dataclass(frozen=True)
class Evidence:
    """
    The equivalent measurements of the detections of a frame.

    Parameters
    ----------
    position : (m, 2) ndarray
        z [m].
    cov : (m, 2, 2) ndarray
        R [m^2].
    log_scale : (m,) ndarray
        ``ln (o / o') - ln N(z; m', R + C')``.

    """

    position: np.ndarray
    cov: np.ndarray
    log_scale: np.ndarray

    def log_ratios(self, particles: Particles, gated: np.ndarray) -> np.ndarray:
        """
        Return ``ln l_j(x_n)`` of each particle and each detection in its gate.

        Parameters
        ----------
        particles : Particles
            Predicted particles, (T, N).
        gated : (T, G) ndarray of int
            Detections in each gate, -1 for none.

        Returns
        -------
        (T, G, N) ndarray
            Log ratios [nat]; -inf where there is no detection.

        """
        measured = Measurements(self.position, self.cov, np.ones(len(self.position)))
        log_ratio = association.log_likelihoods(particles, measured, gated)
        log_ratio += self.log_scale[gated][..., None]
        return log_ratio

    def mixed(
        self, tracks: Tracks, detected: float, ratio: np.ndarray, beta: np.ndarray,
        gated: np.ndarray,
    ) -> np.ndarray:
        """
        Return the log of the evidence, averaged over what each particle may have caused.

        No detection is evidence against an object, ``1 - P_D P_G``.  So is one that is of another
        track: the existence probability is a mean over both hypotheses, and the evidence of a
        track is scaled to lead to it.

        Parameters
        ----------
        tracks
            Predicted tracks T of N particles.
        detected
            P_D P_G.
        ratio : (T, G, N) ndarray
            ``L_tj(x_n)`` of the detections themselves; 0 for no detection.
        beta : (T, G) ndarray
            Their association probabilities.
        gated : (T, G) ndarray of int
            Detections in each gate, -1 for none.

        Returns
        -------
        (T, N) ndarray
            Log-likelihood ratio of the frame for each particle [nat].

        """
        particles = tracks.particles
        total = 1.0 - detected + ratio.sum(axis=1, keepdims=True)
        cause = ratio / total
        with np.errstate(divide='ignore'):
            log_cause = np.log(np.concatenate([(1.0 - detected) / total, cause], axis=1))
        none = np.full((len(tracks), 1, ratio.shape[-1]), np.log1p(-detected))
        evidence = log_sum_exp(
            log_cause + np.concatenate([none, self.log_ratios(particles, gated)], axis=1), axis=1)
        own = cause @ particles.weights[..., None]
        other = np.sum((1.0 - _shares(beta, gated)) * own[..., 0], axis=1)
        log_odds = scipy.special.logit(np.maximum(tracks.existence, _LEAST_PROB))
        after = log_odds + log_sum_exp(evidence + particles.log_weights)
        mean = (1.0 - other) * scipy.special.expit(after) + other * scipy.special.expit(
            log_odds + np.log1p(-detected))
        log_mean = scipy.special.logit(np.minimum(mean, MAX_EXISTENCE))
        return np.asarray(evidence + (log_mean - after)[:, None])


def _shares(beta: np.ndarray, gated: np.ndarray) -> np.ndarray:
    """Return the probability that each detection is of each track, if it is of any, (T, G)."""
    total = association.sum_over_tracks(beta, gated, int(gated.max(initial=-1)) + 1)
    share = np.zeros(beta.shape)
    np.divide(beta, total[gated] if total.size else 1.0, out=share, where=beta > 0.0)
    return share


def frame_evidence(measured: Measurements) -> Evidence:
    """Return the evidence of detections (m,) that say what was predicted, or of none."""
    before = measured.predicted
    if before is None:
        return Evidence(np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0))
    factor = np.linalg.cholesky(before.cov)
    inverse = np.linalg.inv(factor)
    # In these directions the prediction has variance 1 and the posterior the variance ``after``.
    after, axes = np.linalg.eigh(inverse @ measured.cov @ inverse.swapaxes(-1, -2))
    after = np.minimum(after, _MOST_VARIANCE)
    shift = np.einsum(
        'mji,mjk,mk->mi', axes, inverse, measured.position - before.position)
    back = factor @ axes
    position = before.position + np.einsum('mij,mj->mi', back, shift / (1.0 - after))
    cov = (back * (after / (1.0 - after))[:, None]) @ back.swapaxes(-1, -2)
    odds = [scipy.special.logit(np.clip(prob, _LEAST_PROB, 1.0 - _LEAST_PROB))
            for prob in (measured.score, before.score)]
    log_det = 2.0 * np.log(np.einsum('mii->mi', factor)).sum(axis=1)
    log_density = -0.5 * np.sum(shift**2 / (1.0 - after) - np.log(1.0 - after), axis=1) - (
        0.5 * log_det + np.log(2.0 * np.pi))
    return Evidence(position, cov, odds[0] - odds[1] - log_density)
