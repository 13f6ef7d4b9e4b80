# SPDX-License-Identifier: Apache-2.0
"""
Independent references for the tracker: an exact filter, densities and enumeration.

The exact filter of a linear Gaussian system with Markov modes and uncertain association is a
mixture of Kalman filters, one for each history of modes and detections.
"""

from dataclasses import dataclass
import itertools

import numpy as np

H = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])


@dataclass(frozen=True)
class Mixture:
    """Weights (M,), means (M, 4), covariances (M, 4, 4) and modes (M,) of the hypotheses."""

    weight: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    mode: np.ndarray

    def __getitem__(self, index):
        """Return the hypotheses of an index, with weights that sum to one."""
        weight = self.weight[index] / self.weight[index].sum()
        return Mixture(weight, self.mean[index], self.cov[index], self.mode[index])

    def moments(self):
        """Return mean and covariance of the state."""
        mean = self.weight @ self.mean
        offset = self.mean - mean
        spread = np.einsum('m,mi,mj->ij', self.weight, offset, offset)
        return mean, np.einsum('m,mij->ij', self.weight, self.cov) + spread

    def modes(self, count):
        """Return the probability of each mode."""
        return np.bincount(self.mode, self.weight, minlength=count)


def gaussian(mean, cov, modes):
    """Return one Gaussian with all modes equally likely."""
    return Mixture(np.full(modes, 1.0 / modes), np.tile(mean, (modes, 1)),
                   np.tile(cov, (modes, 1, 1)), np.arange(modes))


def predict(mixture, matrices, process_noise, transition):
    """Split every hypothesis by its next mode, then move it."""
    count = len(matrices)
    weight = mixture.weight[:, None] * transition[mixture.mode]
    mean = np.einsum('rij,mj->mri', matrices, mixture.mean)
    cov = np.einsum('rij,mjk,rlk->mril', matrices, mixture.cov, matrices) + process_noise
    mode = np.tile(np.arange(count), len(mixture.weight))
    return Mixture(weight.ravel(), mean.reshape(-1, 4), cov.reshape(-1, 4, 4), mode)


def update(mixture, positions, noise, detected, clutter, most=20_000, negligible=1e-9):
    """
    Split every hypothesis by the detection that the object caused, or none.

    Returns the ``most`` most likely hypotheses that are not negligible, and the likelihood ratio
    of the frame, "object" against "no object".
    """
    innovation = H @ mixture.cov @ H.T + noise
    gain = mixture.cov @ H.T @ np.linalg.inv(innovation)
    reduced = mixture.cov - gain @ H @ mixture.cov
    parts = [Mixture((1.0 - detected) * mixture.weight, mixture.mean, mixture.cov, mixture.mode)]
    for z in positions:
        offset = z - mixture.mean @ H.T
        weight = mixture.weight * densities(offset, innovation) * detected / clutter
        mean = mixture.mean + np.einsum('mij,mj->mi', gain, offset)
        parts.append(Mixture(weight, mean, reduced, mixture.mode))
    split = Mixture(*(np.concatenate([getattr(part, name) for part in parts])
                      for name in ('weight', 'mean', 'cov', 'mode')))
    heavy = np.argsort(-split.weight, kind='stable')[:most]
    heavy = heavy[split.weight[heavy] > negligible * split.weight[heavy[0]]]
    return split[heavy], split.weight.sum()


def densities(offset, cov):
    """Return the normal density of each offset (M, 2)."""
    exponent = -0.5 * np.einsum('mi,mij,mj->m', offset, np.linalg.inv(cov), offset)
    return np.exp(exponent) / np.sqrt(np.linalg.det(2.0 * np.pi * cov))


def joint_marginals(psi):
    """
    Return beta_tj of joint association by enumeration, (T, m + 1), the last for none.

    ``psi`` (T, m) is the weight of each detection relative to none.
    """
    tracks, count = psi.shape
    marginal = np.zeros((tracks, count + 1))
    for choice in itertools.product(range(count + 1), repeat=tracks):
        used = [j for j in choice if j < count]
        if len(used) == len(set(used)):
            weight = np.prod([psi[t, j] for t, j in enumerate(choice) if j < count])
            for t, j in enumerate(choice):
                marginal[t, j] += weight
    return marginal / marginal.sum(axis=1, keepdims=True)


def joint_particles(ratio, existence, detected):
    """
    Return the posterior of tracks with equally weighted particles, by enumeration.

    ``ratio`` (T, m, N) is the likelihood ratio of each detection at each particle, ``existence``
    (T,) the prior.  Returns the probability (T, N) that the object exists and is at the particle,
    and (T, m) that it exists and caused the detection.
    """
    tracks, count, size = ratio.shape
    present, caused, total = np.zeros((tracks, size)), np.zeros((tracks, count)), 0.0
    for choice in itertools.product(range(count + 1), repeat=tracks):
        used = [j for j in choice if j < count]
        if len(used) != len(set(used)):
            continue
        # Of each track: the weight at each particle, and that it does not exist.
        at = np.array([
            existence[t] / size * (ratio[t, j] if j < count else np.full(size, 1.0 - detected))
            for t, j in enumerate(choice)])
        absent = np.array([(1.0 - existence[t]) * (j == count) for t, j in enumerate(choice)])
        weight = at.sum(axis=1) + absent
        total += np.prod(weight)
        for t, j in enumerate(choice):
            others = np.prod(np.delete(weight, t))
            present[t] += others * at[t]
            if j < count:
                caused[t, j] += others * at[t].sum()
    return present / total, caused / total
