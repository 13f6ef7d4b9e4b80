"""
Which detection is whose: gating, likelihoods, and what tracks leave one another.

All detections in a track's gate and a missed detection are weighed together, as in
probabilistic data association (Bar-Shalom, Li and Kirubarajan 2001, Section 3.4).  Where
tracks share detections, a detection belongs to one of them at most.  What the others leave
of it to a track is one number, its *share*: with the ratios of its detections multiplied by
their shares, each track is updated as if it were alone, which gives the marginals of joint
integrated PDA (Musicki and Evans 2004).
"""

from __future__ import annotations

from lowsnr_common.core.motion import POS
from lowsnr_common.core.particles import log_sum_exp
from lowsnr_track.association_kernels import gaussian_log_densities
from lowsnr_track.joint_association import clusters
from lowsnr_track.joint_association import log_marginals
from lowsnr_track.measurements import Measurements
from lowsnr_track.mmpf import Cloud
import numpy as np

# Joint hypotheses of a cluster that are enumerated; a larger cluster is approximated.
_MOST_HYPOTHESES = 2000
_SWEEPS = 50
_SETTLED = 1e-6
# Claims are compared with one another and with 1: beyond this, rounding would eat the 1.
_CERTAIN_CLAIM = 30.0


def gate(cloud: Cloud, measured: Measurements, bound: float, most: int) -> np.ndarray:
    """
    Choose the detections that each track may have caused.

    The gate is the box around the whole cloud, widened by the error of the detection.  An
    ellipse of the cloud's mean and covariance would lose an object that is where few of the
    particles are: some with a false detection that the others follow, say.

    Parameters
    ----------
    cloud : Cloud
        Predicted particles, (T, N).
    measured
        Detections.
    bound
        Squared error of a detection, in variances along an axis, that the gate allows for.
    most
        Largest number of detections a track, nearest first.

    Returns
    -------
    (T, G) ndarray of int
        Indices of the detections in each gate, in ascending Mahalanobis distance from the
        predicted position; -1 fills the rows.

    """
    inside = np.ones((len(cloud.modes), len(measured)), dtype=bool)
    for axis, column in enumerate(POS):
        states, position = cloud.states[..., column], measured.position[:, axis]
        margin = np.sqrt(bound * measured.cov[:, axis, axis])
        inside &= position + margin >= states.min(axis=-1)[:, None]
        inside &= position - margin <= states.max(axis=-1)[:, None]
    mean, cov = cloud.position_moments
    offset = measured.position - mean[:, None]
    distance = _quadratic(offset[..., 0], offset[..., 1], cov[:, None] + measured.cov)
    distance = np.where(inside, distance, np.inf)
    size = min(most, int(np.max(np.sum(inside, axis=1), initial=0)))
    index = np.argsort(distance, axis=1, kind='stable')[:, :size]
    return np.where(np.take_along_axis(inside, index, axis=1), index, -1)


def log_densities(cloud: Cloud, measured: Measurements, index: np.ndarray) -> np.ndarray:
    """
    Return the log density of each gated detection given each particle.

    Parameters
    ----------
    cloud : Cloud
        Predicted particles, (T, N).
    measured
        Detections.
    index : (T, G) ndarray of int
        Gated detections, -1 for none.

    Returns
    -------
    (T, G, N) ndarray
        Gaussian log densities [nat], -inf where there is no detection.

    """
    return gaussian_log_densities(
        np.ascontiguousarray(cloud.states), np.ascontiguousarray(measured.position),
        np.ascontiguousarray(measured.cov), index)


def weigh(
    cloud: Cloud, existence: np.ndarray, detected: float, log_ratio: np.ndarray,
    index: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Sum over all hypotheses: each detection in the gate is the object's, or none is.

    Parameters
    ----------
    cloud : Cloud
        Predicted particles, (T, N).
    existence : (T,) ndarray
        Predicted probability that each object exists.
    detected
        Probability that an object is detected, and in its gate.
    log_ratio : (T, G, N) ndarray
        Log of how much likelier each detection is of an object in the particle's state than
        false, ``detected`` included [nat]; -inf for none.
    index : (T, G) ndarray of int
        Gated detections, -1 for none.

    Returns
    -------
    (T, N) ndarray
        Log-likelihood ratio of each particle against "no object" [nat].
    (T, G) ndarray
        Probability that the object exists and caused the detection.

    """
    # In units of the best particle's, which keeps the sums in range.
    peak = log_ratio.max(axis=-1, keepdims=True)
    peak = np.where(np.isfinite(peak), peak, 0.0)
    ratio = np.exp(log_ratio - peak)
    with np.errstate(divide='ignore'):
        mean = peak + np.log(ratio @ np.exp(cloud.log_weights)[..., None])
    claim = mean[..., 0] + (np.log(existence) - np.log1p(-detected * existence))[:, None]
    share = log_shares(claim, index)
    mixed = np.swapaxes(np.exp(peak + share[..., None]), -1, -2) @ ratio
    return np.log(1.0 - detected + mixed[:, 0]), association_probabilities(claim, share)


def log_shares(log_claim: np.ndarray, index: np.ndarray) -> np.ndarray:
    """
    Return what the other tracks leave of each detection.

    Tracks that share detections form clusters.  A small cluster is enumerated; in a large one
    the shares come from belief propagation, which always converges and is exact where no two
    tracks share two detections (Williams and Lau 2014).

    Parameters
    ----------
    log_claim : (T, G) ndarray
        Log of the probability that the track caused the detection over the probability
        that it caused none, each for the track alone; -inf for none.
    index : (T, G) ndarray of int
        Detection of every claim, -1 for none.

    Returns
    -------
    (T, G) ndarray
        Log of the share, at most 0; 0 where no other track claims the detection.

    """
    shares = np.zeros(index.shape)
    for cluster in clusters(index):
        claim, slot = log_claim[cluster], index[cluster]
        if np.prod(1.0 + np.sum(slot >= 0, axis=1)) <= _MOST_HYPOTHESES:
            log_beta, log_none = log_marginals(claim, slot)
            with np.errstate(invalid='ignore'):
                found = np.where(slot >= 0, log_beta - claim - log_none[:, None], 0.0)
            shares[cluster] = np.minimum(found, 0.0)
        else:
            shares[cluster] = _propagate(claim, slot)
    return shares


def association_probabilities(log_claim: np.ndarray, log_share: np.ndarray) -> np.ndarray:
    """
    Return beta_1..beta_G of every track.

    Parameters
    ----------
    log_claim, log_share : (T, G) ndarray
        As in :func:`log_shares`.

    Returns
    -------
    (T, G) ndarray
        Probability that the track exists and caused the detection; what is missing to one
        is the probability that it caused none.

    """
    log_weight = log_claim + log_share
    none = np.zeros((len(log_weight), 1))
    total = log_sum_exp(np.concatenate([none, log_weight], axis=1))
    return np.exp(log_weight - total[:, None])


def _propagate(log_claim: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return the log shares by belief propagation between tracks and detections."""
    found = index >= 0
    slot = np.where(found, index, 0)
    claim = np.exp(np.minimum(np.where(found, log_claim, -np.inf), _CERTAIN_CLAIM))
    share = np.ones(index.shape)
    for _ in range(_SWEEPS):
        before, taken = share, claim * share
        rest = np.sum(taken, axis=1, keepdims=True) - taken
        strength = claim / (1.0 + np.maximum(rest, 0.0))
        total = np.bincount(slot[found], strength[found], minlength=1)
        share = 1.0 / (1.0 + np.maximum(total[slot] - strength, 0.0))
        if np.max(abs(share - before)) < _SETTLED:
            break
    return np.where(found, np.log(share), 0.0)


def _quadratic(dx: np.ndarray, dy: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Return d' cov^-1 d for offsets (dx, dy) and covariances (..., 2, 2)."""
    xx, xy, yy = cov[..., 0, 0], cov[..., 0, 1], cov[..., 1, 1]
    scale = 1.0 / (xx * yy - xy**2)
    return dx**2 * (yy * scale) - dx * dy * (2.0 * xy * scale) + dy**2 * (xx * scale)
