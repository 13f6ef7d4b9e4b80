"""
Independent references for the tracker: an exact filter, closed forms, enumeration.

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
        """Return the hypotheses of an index, weighted to one."""
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
    """Return one Gaussian, whatever the mode."""
    return Mixture(np.full(modes, 1.0 / modes), np.tile(mean, (modes, 1)),
                   np.tile(cov, (modes, 1, 1)), np.arange(modes))


def predict(mixture, matrices, process_noise, transition):
    """Split every hypothesis by the mode it switches to, then move it."""
    count = len(matrices)
    weight = mixture.weight[:, None] * transition[mixture.mode]
    mean = np.einsum('rij,mj->mri', matrices, mixture.mean)
    cov = np.einsum('rij,mjk,rlk->mril', matrices, mixture.cov, matrices) + process_noise
    mode = np.tile(np.arange(count), len(mixture.weight))
    return Mixture(weight.ravel(), mean.reshape(-1, 4), cov.reshape(-1, 4, 4), mode)


def update(mixture, positions, noise, detected, clutter, most=20_000, negligible=1e-9):
    """
    Split every hypothesis by the detection that is its own, or none.

    Returns the ``most`` heaviest hypotheses that are not negligible, and the likelihood ratio
    of the frame against "no object".
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
    """Return the normal density of each offset (M, 2), by the textbook formula."""
    exponent = -0.5 * np.einsum('mi,mij,mj->m', offset, np.linalg.inv(cov), offset)
    return np.exp(exponent) / np.sqrt(np.linalg.det(2.0 * np.pi * cov))


def joint_marginals(claim):
    """
    Return beta_tj of joint association by enumeration, (T, m + 1), the last for none.

    ``claim`` (T, m) is the weight of each detection relative to none.
    """
    tracks, count = claim.shape
    marginal = np.zeros((tracks, count + 1))
    for choice in itertools.product(range(count + 1), repeat=tracks):
        used = [j for j in choice if j < count]
        if len(used) == len(set(used)):
            weight = np.prod([claim[t, j] for t, j in enumerate(choice) if j < count])
            for t, j in enumerate(choice):
                marginal[t, j] += weight
    return marginal / marginal.sum(axis=1, keepdims=True)
