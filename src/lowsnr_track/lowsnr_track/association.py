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
  one track at most (:mod:`lowsnr_track.joint_association`); 1 for a track on its own.
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

from lowsnr_common.core.compiled import compiled
from lowsnr_common.core.motion import POS
from lowsnr_common.core.particles import log_sum_exp
from lowsnr_track.joint_association import log_exclusion
from lowsnr_track.measurements import Measurements
from lowsnr_track.mmpf import Particles
import numpy as np


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
        Largest number of detections a track, nearest first.

    Returns
    -------
    (T, G) ndarray of int
        Indices of the detections in each gate, in ascending Mahalanobis distance from the
        predicted position; -1 fills the rows.

    """
    inside = np.ones((len(particles.modes), len(measured)), dtype=bool)
    for axis, column in enumerate(POS):
        states, position = particles.states[..., column], measured.position[:, axis]
        margin = np.sqrt(bound * measured.cov[:, axis, axis])
        inside &= position + margin >= states.min(axis=-1)[:, None]
        inside &= position - margin <= states.max(axis=-1)[:, None]
    mean, cov = particles.position_moments
    offset = measured.position - mean[:, None]
    distance = _quadratic(offset[..., 0], offset[..., 1], cov[:, None] + measured.cov)
    distance = np.where(inside, distance, np.inf)
    size = min(max_gated, int(np.max(np.sum(inside, axis=1), initial=0)))
    gated = np.argsort(distance, axis=1, kind='stable')[:, :size]
    return np.where(np.take_along_axis(inside, gated, axis=1), gated, -1)


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
    found: np.ndarray = _log_gaussians(
        np.ascontiguousarray(particles.states), np.ascontiguousarray(measured.position),
        np.ascontiguousarray(measured.cov), gated)
    return found


def associate(
    particles: Particles, existence: np.ndarray, detected: float, log_ratio: np.ndarray,
    gated: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Sum over the hypotheses: each detection in the gate is the object's, or none is.

    Parameters
    ----------
    particles : Particles
        Predicted particles, (T, N).
    existence : (T,) ndarray
        Predicted existence probabilities pi_t.
    detected
        P_D P_G.
    log_ratio : (T, G, N) ndarray
        ``log L_tj(x_n)`` [nat]; -inf for no detection.
    gated : (T, G) ndarray of int
        Detections in each gate, -1 for none.

    Returns
    -------
    (T, N) ndarray
        Log-likelihood ratio of each particle against "no object" [nat].
    (T, G) ndarray
        Association probabilities beta_tj.

    """
    # A logsumexp over particles and one over hypotheses, which share their exponentials.
    peak = log_ratio.max(axis=-1, keepdims=True)
    peak = np.where(np.isfinite(peak), peak, 0.0)
    ratio = np.exp(log_ratio - peak)
    with np.errstate(divide='ignore'):
        log_mean = peak + np.log(ratio @ np.exp(particles.log_weights)[..., None])
    log_psi = log_mean[..., 0] + (np.log(existence) - np.log1p(-detected * existence))[:, None]
    log_nu = log_exclusion(log_psi, gated)
    mixture = np.swapaxes(np.exp(peak + log_nu[..., None]), -1, -2) @ ratio
    return np.log(1.0 - detected + mixture[:, 0]), association_probabilities(log_psi, log_nu)


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


def _quadratic(dx: np.ndarray, dy: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Return d' cov^-1 d for offsets (dx, dy) and covariances (..., 2, 2)."""
    xx, xy, yy = cov[..., 0, 0], cov[..., 0, 1], cov[..., 1, 1]
    scale = 1.0 / (xx * yy - xy**2)
    squared: np.ndarray = dx**2 * (yy * scale) - dx * dy * (2.0 * xy * scale) + dy**2 * (
        xx * scale)
    return squared


@compiled
def _log_gaussians(
    states: np.ndarray, position: np.ndarray, cov: np.ndarray, gated: np.ndarray,
) -> np.ndarray:
    """
    Return the log density of positions (m, 2) with covariance (m, 2, 2) at states (T, N, 4).

    ``gated`` (T, G) chooses the positions for each track, -1 for none; the result is (T, G, N).
    """
    tracks, count = states.shape[:2]
    density = np.empty((tracks, gated.shape[1], count))
    x, y = np.empty(count), np.empty(count)
    for t in range(tracks):
        for n in range(count):
            x[n], y[n] = states[t, n, 0], states[t, n, 2]
        for g in range(gated.shape[1]):
            j = gated[t, g]
            if j < 0:
                density[t, g] = -np.inf
                continue
            xx, xy, yy = cov[j, 0, 0], cov[j, 0, 1], cov[j, 1, 1]
            determinant = xx * yy - xy**2
            of_x, of_y = -0.5 * yy / determinant, -0.5 * xx / determinant
            of_both = xy / determinant
            constant = np.log(2.0 * np.pi) + 0.5 * np.log(determinant)
            z_x, z_y, out = position[j, 0], position[j, 1], density[t, g]
            for n in range(count):
                dx, dy = z_x - x[n], z_y - y[n]
                out[n] = dx * dx * of_x + dx * dy * of_both + dy * dy * of_y - constant
    return density
