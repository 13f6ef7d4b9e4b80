# SPDX-License-Identifier: Apache-2.0
"""
Joint association: a detection belongs to one track at most.

Tracks whose gates share detections form a cluster.  A joint hypothesis of a cluster gives each
track one of its detections or none, and no detection to two tracks; its weight is the product of
the odds psi_tj that it uses (Fortmann, Bar-Shalom and Scheffe 1983).  The marginals b_tj of these
hypotheses define

    nu_tj = (b_tj / b_t0) / psi_tj,

the factor by which the other tracks reduce the odds of track t for detection j.

:mod:`lowsnr_track.data_association.association` defines the other symbols.
"""

from __future__ import annotations

from lowsnr_common.core.particles import log_sum_exp
import numpy as np
import scipy

_NONE = -1
# The largest number of joint hypotheses that are enumerated, which takes a few milliseconds; a
# larger cluster is approximated.
_MAX_HYPOTHESES = 2000
# Belief propagation converges at a geometric rate (Williams and Lau 2014), but slowly where the
# odds are high and many tracks share many detections.  For 6 tracks with the same 6 detections (30
# draws of log psi, seeds 0 to 29) the largest change of a probability after 200 iterations is 6e-5
# at log psi of 6 +- 2, 0.002 at 10 +- 2 and 0.02 at 20 +- 5, where the approximation itself is off
# by up to 0.34, 0.44 and 0.45.  200 iterations take 10 ms.
_MAX_ITERATIONS = 200
_TOLERANCE = 1e-6  # relative to nu, which falls to 1 / exp(_MAX_LOG_PSI)
# The largest log psi [nat].  Sums of 1 and psi are compared: exp(30) = 1e13 still leaves the 1
# three digits of double precision.
_MAX_LOG_PSI = 30.0


def log_exclusion(log_psi: np.ndarray, gated: np.ndarray) -> np.ndarray:
    """
    Return log nu_tj, what the other tracks leave of the odds of each detection.

    A small cluster is enumerated.  In a large one nu comes from belief propagation, which always
    converges and is exact where no two tracks share two detections (Williams and Lau 2014).

    Parameters
    ----------
    log_psi : (T, G) ndarray
        Log odds that the track caused the detection against none, each for the track alone;
        -inf for no detection.
    gated : (T, G) ndarray of int
        Detections in each gate, -1 for none.

    Returns
    -------
    (T, G) ndarray
        log nu, at most 0; 0 where the detection is in no other gate.

    """
    log_nu = np.zeros(gated.shape)
    for cluster in clusters(gated):
        psi, detection = log_psi[cluster], gated[cluster]
        if np.prod(1.0 + np.sum(detection >= 0, axis=1)) <= _MAX_HYPOTHESES:
            log_beta, log_none = log_marginals(psi, detection)
            with np.errstate(invalid='ignore'):
                found = np.where(psi > -np.inf, log_beta - psi - log_none[:, None], 0.0)
            log_nu[cluster] = np.minimum(found, 0.0)
        else:
            log_nu[cluster] = _belief_propagation(psi, detection)
    return log_nu


def clusters(gated: np.ndarray) -> list[np.ndarray]:
    """
    Return the groups of tracks that share detections, directly or through others.

    Parameters
    ----------
    gated : (T, G) ndarray of int
        Detections in each gate, -1 for none.

    Returns
    -------
    list of ndarray of int
        Tracks of each group of two or more, ascending.

    """
    track, column = np.nonzero(gated >= 0)
    if track.size == 0:
        return []
    if np.bincount(gated[track, column]).max() < 2:
        return []
    # A track and a detection in its gate are neighbours in a graph of T tracks and m detections.
    tracks, size = len(gated), len(gated) + int(gated.max()) + 1
    edges = scipy.sparse.coo_array(
        (np.ones(track.size), (track, tracks + gated[track, column])), shape=(size, size))
    _, label = scipy.sparse.csgraph.connected_components(edges, directed=False)
    order = np.argsort(label[:tracks], kind='stable')
    groups = np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
    return [members for members in groups if len(members) > 1]


def log_marginals(log_psi: np.ndarray, gated: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the marginal association probabilities of a cluster, by enumeration.

    Parameters
    ----------
    log_psi : (T, G) ndarray
        Log odds of each detection against none.
    gated : (T, G) ndarray of int
        Detections in each gate, -1 for none.

    Returns
    -------
    (T, G) ndarray
        Log probability that the track caused the detection.
    (T,) ndarray
        Log probability that it caused none.

    """
    choice, log_weight = _hypotheses(log_psi, gated)
    log_weight = log_weight - log_sum_exp(log_weight)
    # All columns, and none, at once; (H, T, G + 1).
    options = np.append(np.arange(gated.shape[1]), _NONE)
    chosen = choice[..., None] == options
    beta = log_sum_exp(np.where(chosen, log_weight[:, None, None], -np.inf), axis=0)
    return beta[:, :-1], beta[:, -1]


def _hypotheses(log_psi: np.ndarray, gated: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the column of each track in each hypothesis (H, T), and the log weights (H,)."""
    tracks = len(gated)
    choice = np.empty((1, 0), dtype=np.intp)
    used = np.full((1, tracks), _NONE)
    log_weight = np.zeros(1)
    for t in range(tracks):
        columns = np.append(np.flatnonzero(gated[t] >= 0), _NONE)
        detection = np.where(columns >= 0, gated[t, columns], _NONE)
        log_odds = np.where(columns >= 0, log_psi[t, columns], 0.0)
        conflict = (used[:, None] == detection[:, None]).any(axis=-1) & (detection >= 0)
        parent, option = np.nonzero(~conflict)
        choice = np.column_stack([choice[parent], columns[option]])
        used = used[parent]
        used[:, t] = detection[option]
        log_weight = log_weight[parent] + log_odds[option]
    return choice, log_weight


def _belief_propagation(log_psi: np.ndarray, gated: np.ndarray) -> np.ndarray:
    """
    Return log nu by the messages of Williams and Lau (2014) between tracks and detections.

    ``mu_tj = psi_tj / (1 + sum_(i != j) psi_ti nu_ti)`` goes from track t to detection j,
    ``nu_tj = 1 / (1 + sum_(s != t) mu_sj)`` back.
    """
    found = gated >= 0
    detection = np.where(found, gated, 0)
    psi = np.exp(np.minimum(np.where(found, log_psi, -np.inf), _MAX_LOG_PSI))
    nu = np.ones(gated.shape)
    for _ in range(_MAX_ITERATIONS):
        before, odds = nu, psi * nu
        others = np.sum(odds, axis=1, keepdims=True) - odds
        mu = psi / (1.0 + np.maximum(others, 0.0))
        total = np.bincount(detection[found], mu[found], minlength=1)
        nu = 1.0 / (1.0 + np.maximum(total[detection] - mu, 0.0))
        if np.all(abs(nu - before) <= _TOLERANCE * nu):
            break
    return np.where(found, np.log(nu), 0.0)
