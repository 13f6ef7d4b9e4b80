# SPDX-License-Identifier: Apache-2.0
"""
Tracks with the detections in their gates: how probably they are unresolved, and their likelihoods.

:mod:`lowsnr_track.data_association.unresolved` has the formulas.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import fields
from functools import cached_property

from lowsnr_common.core.motion import POS
from lowsnr_common.core.particles import log_sum_exp
from lowsnr_track.data_association import association
from lowsnr_track.data_association.group_hypotheses import floored_log
from lowsnr_track.data_association.group_hypotheses import Groups
from lowsnr_track.measurements import Measurements
from lowsnr_track.particles import Particles
import numpy as np
import scipy

_NONE = -1
# Tracks that are unresolved with a smaller probability are taken as resolved.
_NEGLIGIBLE = 1e-3
# A group that is less likely does not change the particles of its tracks.
_UNLIKELY = 1e-12


@dataclass(frozen=True)
class Candidates:
    """
    Tracks, the detections in their gates, and their likelihood ratios.

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
    ratio : (T, G, N) ndarray
        ``L_tj(x_n)``; 0 for no detection.
    mean : (T, G) ndarray
        ``L_tj``.

    """

    particles: Particles
    measured: Measurements
    existence: np.ndarray
    detected: np.ndarray
    scale: np.ndarray
    gated: np.ndarray
    ratio: np.ndarray
    mean: np.ndarray

    def __getitem__(self, index: np.ndarray) -> Candidates:
        """Return the tracks of an index."""
        return Candidates(**{
            part.name: value if part.name == 'measured' else value[index]
            for part in fields(self) for value in [getattr(self, part.name)]})

    def linked(self, reach_m: float) -> np.ndarray:
        """
        Return p_st, that two detected objects are within reach of each other on both axes.

        Positions are Gaussian, with the covariance of the particles and the median one of the
        detections; (T, T), 0 on the diagonal and where it is negligible.
        """
        mean, cov = self._positions
        variance = np.diagonal(cov, axis1=-2, axis2=-1) + np.median(
            np.diagonal(self.measured.cov, axis1=-2, axis2=-1), axis=0)
        distance = abs(mean[:, None] - mean)
        std = np.sqrt(variance[:, None] + variance)
        above, below = (
            scipy.special.ndtr((edge - distance) / std) for edge in (reach_m, -reach_m))
        near: np.ndarray = np.prod(above - below, axis=-1)
        near[near < _NEGLIGIBLE] = 0.0
        np.fill_diagonal(near, 0.0)
        return near

    def log_likelihoods(self, groups: Groups) -> np.ndarray:
        """Return ``log L_Sj`` of each group (G,), ``log (1 - P_D P_G)`` of those missed."""
        members, size = groups.members, groups.members.sum(axis=1)
        caused = members[..., None] & (self.gated == groups.cause[:, None, None])
        mean, cov = self._positions
        spread = self._error(groups) + _sums(members, cov) / size[:, None, None]**2
        offset = self.measured.position[groups.cause] - _sums(members, mean) / size[:, None]
        squared = np.sum(offset * np.linalg.solve(spread, offset[..., None])[..., 0], axis=-1)
        log_gaussian = -0.5 * (squared + np.linalg.slogdet(2.0 * np.pi * spread)[1])
        log_scale = floored_log((caused * self.scale).sum(axis=(1, 2)) / size)
        return np.select(
            [groups.cause == _NONE, size == 1],
            [floored_log(1.0 - members @ self.detected / size),
             floored_log((caused * self.mean).sum(axis=(1, 2)))], log_scale + log_gaussian)

    def mixture(self, t: int, groups: Groups, probability: np.ndarray) -> np.ndarray:
        """Return the sum of ``L_Sj(x_n)`` (N,) with mean one over groups of track t, weighted."""
        alone = groups.members.sum(axis=1) == 1
        seen = groups.cause != _NONE
        weight = np.array([
            probability[alone & (groups.cause == j) & seen].sum() for j in self.gated[t]])
        possible = self.mean[t] > 0.0
        found = probability[~seen].sum() + (
            weight[possible] / self.mean[t, possible]) @ self.ratio[t, possible]
        chosen = ~alone & seen & (probability > _UNLIKELY)
        if chosen.any():
            found = found + probability[chosen] @ self._shapes(t, groups[chosen])
        return np.asarray(found)

    def _shapes(self, t: int, groups: Groups) -> np.ndarray:
        """Return ``L_Sj(x_n)`` (G, N) of the particles of track t in groups, with mean one."""
        mean, cov = self._positions
        others, size = groups.members.copy(), groups.members.sum(axis=1)
        others[:, t] = False
        detections = Measurements(
            size[:, None] * self.measured.position[groups.cause] - _sums(others, mean),
            size[:, None, None]**2 * self._error(groups) + _sums(others, cov),
            np.ones(len(size)))
        track = self.particles[np.array([t])]
        log_shape = association.log_likelihoods(
            track, detections, np.arange(len(size))[None])[0]
        return np.asarray(np.exp(
            log_shape - log_sum_exp(log_shape + track.log_weights[0])[:, None]))

    def _error(self, groups: Groups) -> np.ndarray:
        """Return ``R_j + D_S`` of each group (G, 2, 2)."""
        mean = self._positions[0]
        centre = _sums(groups.members, mean) / groups.members.sum(axis=1)[:, None]
        offset = (mean - centre[:, None]) * groups.members[..., None]
        spread = np.swapaxes(offset, 1, 2) @ offset / groups.members.sum(axis=1)[:, None, None]
        return np.asarray(self.measured.cov[groups.cause] + spread)

    @cached_property
    def _positions(self) -> tuple[np.ndarray, np.ndarray]:
        mean, cov = self.particles.moments
        return mean[:, POS], cov[:, POS][:, :, POS]


def candidates(
    particles: Particles, measured: Measurements, existence: np.ndarray, detected: np.ndarray,
    scale: np.ndarray, gated: np.ndarray,
) -> Candidates:
    """Return tracks with the likelihood ratios of their detections."""
    return Candidates(
        particles, measured, existence, detected, scale, gated,
        *association.likelihood_ratios(particles, measured, scale, gated))


def _sums(members: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the sum of values (T, ...) over the tracks of each group (G, T)."""
    return np.asarray(np.tensordot(members.astype(float), values, axes=1))
