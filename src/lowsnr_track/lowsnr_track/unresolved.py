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
:mod:`lowsnr_track.association`, which defines the other symbols.

Note: p_st and c(S) are averages over the particles, which they do not reweight.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from lowsnr_common.core.motion import POS
from lowsnr_common.core.particles import log_sum_exp
from lowsnr_track import association
from lowsnr_track.joint_association import clusters
from lowsnr_track.joint_association import group_hypotheses
from lowsnr_track.joint_association import groups
from lowsnr_track.joint_association import log_group_prior
from lowsnr_track.measurements import Measurements
from lowsnr_track.particles import Particles
import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.special import ndtr

_NONE = -1
# Tracks that are unresolved with a smaller probability are taken as resolved.
_NEGLIGIBLE = 1e-3
# The largest number of joint hypotheses that are enumerated, which takes some milliseconds.  Of
# more tracks, the less likely ones are associated as if all were resolved.
_MAX_HYPOTHESES = 10_000


@dataclass(frozen=True)
class Candidates:
    """
    Tracks, the detections in their gates, and how probably the tracks are unresolved.

    Parameters
    ----------
    particles : Particles
        Predicted particles, (T, N).
    measured
        Detections (m,).
    existence, detected : (T,) ndarray
        pi_t, and P_D P_G.
    scale : (T, G) ndarray
        ``P_D P_G / lambda_j`` [m^2].
    gated : (T, G) ndarray of int
        Detections in each gate, -1 for none.

    """

    particles: Particles
    measured: Measurements
    existence: np.ndarray
    detected: np.ndarray
    scale: np.ndarray
    gated: np.ndarray

    def __getitem__(self, index: np.ndarray) -> Candidates:
        """Return the tracks of an index."""
        chosen = Candidates(self.particles[index], self.measured, *(
            part[index] for part in (self.existence, self.detected, self.scale, self.gated)))
        chosen.__dict__['ratios'] = tuple(part[index] for part in self.ratios)
        return chosen

    @cached_property
    def ratios(self) -> tuple[np.ndarray, np.ndarray]:
        """``L_tj(x_n)`` (T, G, N), 0 for no detection, and L_tj (T, G)."""
        return association.likelihood_ratios(
            self.particles, self.measured, self.scale, self.gated)

    def linked(self, reach_m: float) -> np.ndarray:
        """
        Return p_st, that two detected objects are within reach of each other on both axes.

        Positions are Gaussian, with the covariance of the particles and the median one of the
        detections; (T, T), 0 on the diagonal and where it is negligible.
        """
        mean, cov = self._positions
        variance = np.diagonal(cov, axis1=-2, axis2=-1) + np.median(
            np.diagonal(self.measured.cov, axis1=-2, axis2=-1), axis=0)
        apart = abs(mean[:, None] - mean)
        std = np.sqrt(variance[:, None] + variance)
        near: np.ndarray = np.prod(
            ndtr((reach_m - apart) / std) - ndtr((-reach_m - apart) / std), axis=-1)
        near[near < _NEGLIGIBLE] = 0.0
        np.fill_diagonal(near, 0.0)
        return near

    @property
    def _positions(self) -> tuple[np.ndarray, np.ndarray]:
        mean, cov = self.particles.moments
        return mean[:, POS], cov[:, POS][:, :, POS]

    def log_group(self, members: list[int], j: int) -> float:
        """Return ``log L_Sj`` of a group and detection j, ``log (1 - P_D P_G)`` for j = -1."""
        if j == _NONE:
            return float(np.log1p(-self.detected[members].mean()))
        column = self.gated[members] == j
        with np.errstate(divide='ignore'):
            if len(members) == 1:
                return float(np.log(self.ratios[1][members][column][0]))
            log_scale = np.log(self.scale[members][column].mean())
        mean, cov = (part[members] for part in self._positions)
        spread = self._error(mean, j) + cov.sum(axis=0) / len(members)**2
        offset = self.measured.position[j] - mean.mean(axis=0)
        squared = offset @ np.linalg.solve(spread, offset)
        return float(log_scale - 0.5 * (squared + np.linalg.slogdet(2.0 * np.pi * spread)[1]))

    def shape(self, t: int, members: list[int], j: int) -> np.ndarray:
        """Return ``L_Sj(x_n)`` of the particles (N,) of track t of a group, with mean one."""
        if len(members) == 1:
            ratio, mean = (part[t][self.gated[t] == j][0] for part in self.ratios)
            return np.asarray(ratio / mean)
        others, n = [s for s in members if s != t], len(members)
        mean, cov = self._positions
        of_rest = Measurements(
            (n * self.measured.position[j] - mean[others].sum(axis=0))[None],
            (n**2 * self._error(mean[members], j) + cov[others].sum(axis=0))[None], np.ones(1))
        track = self.particles[np.array([t])]
        log_shape = association.log_likelihoods(
            track, of_rest, np.zeros((1, 1), dtype=np.intp))[0, 0]
        return np.asarray(np.exp(log_shape - log_sum_exp(log_shape + track.log_weights[0])))

    def _error(self, mean: np.ndarray, j: int) -> np.ndarray:
        """Return ``R_j + D_S`` of a group with the means (n, 2)."""
        apart = mean - mean.mean(axis=0)
        error: np.ndarray = self.measured.cov[j] + apart.T @ apart / len(mean)
        return error


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
        tracks.existence, tracks.detected, *tracks.ratios, tracks.gated)
    found = Associated(log_ratio, beta, beta.copy())
    for cluster in clusters(tracks.gated) if reach_m > 0.0 else ():
        some = tracks[cluster]
        linked = some.linked(reach_m)
        _, label = connected_components(linked > 0.0, directed=False)
        for number in np.flatnonzero(np.bincount(label) > 1):
            index = _enumerable(some, np.flatnonzero(label == number))
            rest = np.delete(np.arange(len(cluster)), index)
            free = 1.0 - association.sum_over_tracks(
                beta[cluster[rest]], some.gated[rest], len(tracks.measured))
            _associate_component(
                some[index], linked[np.ix_(index, index)], np.maximum(free, 0.0), found,
                cluster[index])
    return found


def _enumerable(tracks: Candidates, index: np.ndarray) -> np.ndarray:
    """Return the most likely tracks of an index whose hypotheses can be enumerated."""
    likely = index[np.argsort(-tracks.existence[index], kind='stable')]
    options = 2.0 + np.sum(tracks.gated[likely] >= 0, axis=1) + np.arange(len(likely))
    return np.sort(likely[np.cumprod(options) <= _MAX_HYPOTHESES])


def _associate_component(
    tracks: Candidates, linked: np.ndarray, free: np.ndarray, found: Associated,
    index: np.ndarray,
) -> None:
    """
    Associate linked tracks; write the result into the rows ``index`` of ``found``.

    ``free`` (m,) is the probability that each detection is not of another track.
    """
    group, cause = group_hypotheses(tracks.gated, linked)
    held = list(groups(group, cause))
    with np.errstate(divide='ignore'):
        log_free = np.log(np.append(free, 1.0))
    log_weight = log_group_prior(group, tracks.existence, linked)
    for members, j, chosen in held:
        log_weight[chosen] += tracks.log_group(members, j) + log_free[j]
    weight = np.exp(log_weight - log_sum_exp(log_weight))
    missed, absent = weight @ ((group >= 0) & (cause == _NONE)), weight @ (group == _NONE)
    mixture = np.tile(missed[:, None], tracks.particles.modes.shape[-1])
    found.beta[index] = found.share[index] = 0.0
    for members, j, chosen in held:
        probability = weight[chosen].sum()
        if j == _NONE or probability == 0.0:
            continue
        for t in members:
            column = tracks.gated[t] == j
            found.beta[index[t], column] += probability
            found.share[index[t], column] += probability / len(members)
            mixture[t] += probability * tracks.shape(t, members, j)
    against = (1.0 - tracks.existence) / (tracks.existence * absent)
    found.log_ratio[index] = np.log(mixture * against[:, None])
