# SPDX-License-Identifier: Apache-2.0
"""
Joint association of objects that may be unresolved: together they cause one detection.

A detector declares objects once that are nearer to each other than its resolution.  With p_st,
the probability that the objects of tracks s and t are, those that exist form groups: each pair is
linked with probability p_st, independently of the others, and objects that links connect are a
group, which causes one detection or none (Koch and van Keuk 1997; Svensson, Ulmke and Danielsson
2012).  The weight of a joint hypothesis is the product of

- ``1 - pi_t`` of each track without an object, and pi_t of each other one;
- ``1 - p_st`` of each pair in different groups, and ``c(S)`` of each group S, the probability that
  links connect its tracks;
- ``1 - P_D P_G`` of each group that is missed, and ``L_Sj`` of each that caused detection j.

The detection of n objects is one of their mean, in any place among them::

    L_Sj = P_D P_G N(z_j; mean of m_s, R_j + D_S + sum_s C_s / n^2) / lambda_j
    L_Sj(x_t) ~ N(n z_j - sum_(s != t) m_s; x_t, n^2 (R_j + D_S) + sum_(s != t) C_s)

where m_s and C_s are mean and covariance of the predicted position of each, and D_S is the
covariance of the means.  A group of one has the likelihood ratio of
:mod:`lowsnr_track.data_association.association`, which defines the other symbols.

Note: p_st and c(S) are averages over the particles, which they do not reweight.
"""

from __future__ import annotations

from dataclasses import dataclass

from lowsnr_common.core.particles import log_sum_exp
from lowsnr_track.data_association import association
from lowsnr_track.data_association.candidates import Candidates
from lowsnr_track.data_association.group_hypotheses import floored_log
from lowsnr_track.data_association.group_hypotheses import group_hypotheses
from lowsnr_track.data_association.group_hypotheses import log_weights
from lowsnr_track.data_association.joint_association import clusters
import numpy as np

_NONE = -1
# The largest number of joint hypotheses of a component that are enumerated, by a bound.  With
# 2,000 particles the largest components take 6 to 15 ms of one core of an EPYC host: 5 tracks with
# the same 2 detections 6, 4 with 6 13, 3 with 18 15; 2 with 32 take 5.
_MAX_HYPOTHESES = 10_000


@dataclass(frozen=True)
class Associated:
    """
    Tracks associated with the detections of a frame.

    Parameters
    ----------
    log_ratio : (T, N) ndarray
        Log-likelihood ratio of each particle against "no object" [nat].
    beta : (T, G) ndarray
        Probability that the object exists and caused the detection, alone or with others.
    share : (T, G) ndarray
        The same, with one n-th of a detection of n objects; over the tracks it sums to the
        probability that some object caused the detection.

    """

    log_ratio: np.ndarray
    beta: np.ndarray
    share: np.ndarray


def associate(tracks: Candidates, reach_m: float) -> Associated:
    """
    Associate tracks, some of which may be unresolved.

    Parameters
    ----------
    tracks
        Tracks, T.
    reach_m
        Distance along either axis within which objects are declared once [m]; 0 for none.

    """
    log_ratio, beta = association.associate(
        tracks.existence, tracks.detected, tracks.ratio, tracks.mean, tracks.gated)
    found = Associated(log_ratio, beta.copy(), beta.copy())
    for cluster in clusters(tracks.gated) if reach_m > 0.0 else ():
        linked = tracks[cluster].linked(reach_m)
        for component in linked_components(linked, np.sum(tracks.gated[cluster] >= 0, axis=1)):
            index, rest = cluster[component], np.delete(cluster, component)
            free = 1.0 - association.sum_over_tracks(
                beta[rest], tracks.gated[rest], len(tracks.measured))
            _associate_component(
                tracks[index], linked[np.ix_(component, component)], free, found, index)
    return found


def linked_components(linked: np.ndarray, number: np.ndarray) -> list[list[int]]:
    """
    Return the sets of two tracks and more that are associated together.

    The strongest links come first; one is left out where it would connect more tracks than can be
    enumerated, given the number of detections in each gate (T,).
    """
    part = {t: [t] for t in range(len(linked))}
    pairs = np.argwhere(np.triu(linked) > 0.0)
    for s, t in pairs[np.argsort(-linked[tuple(pairs.T)], kind='stable')].tolist():
        if part[s] is part[t]:
            continue
        joined = part[s] + part[t]
        # A track has no object, one alone with a detection or none, or joins one before it.
        options = 2.0 + np.sort(number[joined])[::-1] + np.arange(len(joined))
        if np.prod(options) <= _MAX_HYPOTHESES:
            part.update(dict.fromkeys(joined, sorted(joined)))
    return [joined for t, joined in part.items() if len(joined) > 1 and joined[0] == t]


def _associate_component(
    tracks: Candidates, linked: np.ndarray, free: np.ndarray, found: Associated,
    index: np.ndarray,
) -> None:
    """
    Associate linked tracks; write the result into the rows ``index`` of ``found``.

    ``free`` (m,) is the probability that each detection is not of another track.
    """
    groups, chosen = group_hypotheses(tracks.gated, linked)
    log_weight = log_weights(
        groups, chosen, tracks.log_likelihoods(groups) + floored_log(np.append(free, 1.0))[
            groups.cause], tracks.existence, linked)
    log_odds = floored_log(tracks.existence) - floored_log(1.0 - tracks.existence)
    found.beta[index] = found.share[index] = 0.0
    for t, row in enumerate(index.tolist()):
        exists = chosen[:, t] != _NONE
        log_absent, log_exists = (
            log_sum_exp(log_weight[chance]) for chance in (~exists, exists))
        # Of each group, given that the object exists.
        probability = np.bincount(
            chosen[exists, t], np.exp(log_weight[exists] - log_exists), len(groups.cause))
        present = probability / (1.0 + np.exp(log_absent - log_exists))
        caused = (tracks.gated[t][:, None] == groups.cause) & (groups.cause != _NONE)
        found.beta[row] = caused @ present
        found.share[row] = caused @ (present / groups.members.sum(axis=1))
        found.log_ratio[row] = floored_log(tracks.mixture(t, groups, probability)) + (
            log_exists - log_absent - log_odds[t])
