# SPDX-License-Identifier: Apache-2.0
"""
Gating and association probabilities: which detection is of which track.

For track t, with predicted particles x_n of weights w_n and the predicted existence probability
``pi_t = P(chi_k | Z^(k-1))``, and detection j at z_j with covariance R_j::

    L_tj(x) = P_D P_G N(z_j; H x, R_j) / lambda_j
    L_tj    = sum_n w_n L_tj(x_n)
    psi_tj  = pi_t L_tj / (1 - pi_t P_D P_G)
    beta_tj = psi_tj nu_tj / (1 + sum_i psi_ti nu_ti),    beta_t0 = 1 - sum_j beta_tj

- P_D: probability that an object is detected; P_G: that its detection lies in the gate.
- lambda_j: density of false detections at z_j, over the likelihood ratio of its score.
- L_tj(x): likelihood ratio of detection j, "of an object in state x" against "false".
- psi_tj: odds of "the object exists and caused detection j" against "it caused none".
- nu_tj in (0, 1]: by how much the other tracks reduce these odds, because a detection belongs to
  one track at most (:mod:`lowsnr_track.data_association.joint_association`); 1 for a track on its
  own.
- beta_tj: probability that the object exists and caused detection j; the sums run over the gate.

With one track and pi = 1 these are the beta_j of probabilistic data association (Bar-Shalom, Li
and Kirubarajan 2001, Section 3.4): ``L_j / (1 - P_D P_G + sum_i L_i)``.  With pi below 1 they are
those of integrated PDA (Musicki, Evans and Stankovic 1994), and with several tracks the marginals
of joint integrated PDA (Musicki and Evans 2004).  A particle's likelihood ratio is the sum over
the same hypotheses, ``1 - P_D P_G + sum_j nu_tj L_tj(x_n)``.

Note: the gate cuts nothing off a particle's density that is worth a correction, so P_G is taken
as a part of the probability of detection; the PDA filter has ``P_D N / lambda`` for ``L(x)``.
"""

from __future__ import annotations

from lowsnr_common.core.motion import POS
from lowsnr_common.core.particles import log_sum_exp
from lowsnr_track import track_kernels
from lowsnr_track.data_association.joint_association import log_exclusion
from lowsnr_track.measurements import Measurements
from lowsnr_track.particles import Particles
import numpy as np

_LEAST_LOG = float(np.log(np.finfo(float).tiny))  # of a probability that is 0


def gate(
    particles: Particles, measured: Measurements, bound: float, max_gated: int,
) -> np.ndarray:
    """
    Choose the detections that each track may have caused.

    The gate is the box around all particles, widened by the error of the detection.  The usual
    ellipse of mean and covariance would lose an object that only few particles follow, while
    the others follow a false detection.

    Parameters
    ----------
    particles : Particles
        Predicted particles, (T, N).
    measured
        Detections (m,).
    bound
        Squared error of a detection that the gate allows for, in variances along an axis.
    max_gated
        Largest number of detections a track; of more, those nearest to the predicted position.

    Returns
    -------
    (T, G) ndarray of int
        Indices of the detections in each gate; -1 fills the rows.

    """
    if len(particles.modes) == 0 or len(measured) == 0:
        return np.empty((len(particles.modes), 0), dtype=np.intp)
    inside = np.ones((len(particles.box), len(measured)), dtype=bool)
    for axis in (0, 1):
        at, margin = measured.position[:, axis], np.sqrt(bound * measured.cov[:, axis, axis])
        low, high = particles.box[:, 0, axis, None], particles.box[:, 1, axis, None]
        inside &= (at + margin >= low) & (at - margin <= high)
    track, detection = np.nonzero(inside)
    number = inside.sum(axis=1)
    most = int(number.max(initial=0))
    if most > max_gated:
        nearest_first = np.lexsort((_distance(particles, measured, track, detection), track))
        detection = detection[nearest_first]
    column = np.arange(track.size) - np.repeat(np.cumsum(number) - number, number)
    gated = np.full((len(inside), most), -1)
    gated[track, column] = detection
    return gated[:, :max_gated]


def _distance(
    particles: Particles, measured: Measurements, track: np.ndarray, detection: np.ndarray,
) -> np.ndarray:
    """Return the squared Mahalanobis distance of each detection from its track."""
    mean, cov = (part[..., POS] for part in particles.moments)
    offset = measured.position[detection] - mean[track]
    spread = cov[:, POS][track] + measured.cov[detection]
    squared: np.ndarray = np.sum(
        offset * np.linalg.solve(spread, offset[..., None])[..., 0], axis=-1)
    return squared


def log_likelihoods(
    particles: Particles, measured: Measurements, gated: np.ndarray,
) -> np.ndarray:
    """
    Return ``log N(z_j; H x_n, R_j)`` for each particle and each detection in its gate.

    Parameters
    ----------
    particles : Particles
        Predicted particles, (T, N).
    measured
        Detections (m,).
    gated : (T, G) ndarray of int
        Detections in each gate, -1 for none.

    Returns
    -------
    (T, G, N) ndarray
        Log densities [nat], of positions in metres; -inf where there is no detection.

    """
    density = np.full((*gated.shape, particles.modes.shape[-1]), -np.inf)
    _fill_log_gaussians(particles, measured, np.zeros(gated.shape), gated, density)
    return density


def _fill_log_gaussians(
    particles: Particles, measured: Measurements, log_scale: np.ndarray, gated: np.ndarray,
    density: np.ndarray,
) -> None:
    track_kernels.log_gaussians(
        np.ascontiguousarray(particles.states), np.ascontiguousarray(measured.position),
        np.ascontiguousarray(measured.cov), log_scale, gated, density)


def likelihood_ratios(
    particles: Particles, measured: Measurements, scale: np.ndarray, gated: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return ``L_tj(x_n)`` for each particle and each detection in its gate, and their means L_tj.

    Parameters
    ----------
    particles : Particles
        Predicted particles, (T, N).
    measured
        Detections (m,).
    scale : (T, G) ndarray
        ``P_D P_G / lambda_j`` [m^2].
    gated : (T, G) ndarray of int
        Detections in each gate, -1 for none.

    Returns
    -------
    (T, G, N) ndarray
        Likelihood ratios; 0 where there is no detection.
    (T, G) ndarray
        Their means over the particles.

    """
    # Memory of zeros that nothing touches costs nothing.
    ratio, mean = np.zeros((*gated.shape, particles.modes.shape[-1])), np.zeros(gated.shape)
    _fill_log_gaussians(particles, measured, np.log(scale), gated, ratio)
    weights = particles.weights
    for t, g in zip(*(index.tolist() for index in np.nonzero(gated >= 0))):
        row = ratio[t, g]
        mean[t, g] = np.exp(row, row) @ weights[t]
    return ratio, mean


def associate(
    existence: np.ndarray, detected: np.ndarray, ratio: np.ndarray, mean: np.ndarray,
    gated: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Sum over the hypotheses: each detection in the gate is the object's, or none is.

    Parameters
    ----------
    existence : (T,) ndarray
        Predicted existence probabilities pi_t.
    detected : (T,) ndarray
        P_D P_G.
    ratio : (T, G, N) ndarray
        ``L_tj(x_n)``; 0 for no detection.
    mean : (T, G) ndarray
        ``L_tj``.
    gated : (T, G) ndarray of int
        Detections in each gate, -1 for none.

    Returns
    -------
    (T, N) ndarray
        Log-likelihood ratio of each particle against "no object" [nat].
    (T, G) ndarray
        Association probabilities beta_tj.

    """
    with np.errstate(divide='ignore'):
        log_none = np.maximum(np.log1p(-detected * existence), _LEAST_LOG)
        log_psi = np.log(mean) + (np.log(existence) - log_none)[:, None]
        log_nu = log_exclusion(log_psi, gated)
        mixture = track_kernels.mixtures(ratio, np.exp(log_nu), 1.0 - detected, gated)
        return np.log(mixture, mixture), association_probabilities(log_psi, log_nu)


def association_probabilities(log_psi: np.ndarray, log_nu: np.ndarray) -> np.ndarray:
    """
    Return beta_tj of every track, (T, G).

    Parameters
    ----------
    log_psi, log_nu : (T, G) ndarray
        Odds of each detection and what the other tracks make of them; -inf for no detection.

    """
    log_odds = log_psi + log_nu
    none = np.zeros((len(log_odds), 1))
    total = log_sum_exp(np.concatenate([none, log_odds], axis=1))
    beta: np.ndarray = np.exp(log_odds - total[:, None])
    return beta


def sum_over_tracks(beta: np.ndarray, gated: np.ndarray, count: int) -> np.ndarray:
    """Return the probability that each of ``count`` detections is of some track, (count,)."""
    found = gated >= 0
    return np.bincount(gated[found], beta[found], minlength=count)
