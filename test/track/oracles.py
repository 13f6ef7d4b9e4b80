"""Independent references for the tracker: Kalman mixtures, closed forms, enumeration."""

from dataclasses import dataclass
import itertools

import numpy as np

H = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])


@dataclass
class Gaussian:
    """One hypothesis of a mixture: its weight, moments and current mode."""

    weight: float
    mean: np.ndarray
    cov: np.ndarray
    mode: int


def density(value, mean, cov):
    """Return the normal density, by the textbook formula."""
    offset = np.asarray(value) - mean
    exponent = -0.5 * offset @ np.linalg.inv(cov) @ offset
    return np.exp(exponent) / np.sqrt(np.linalg.det(2 * np.pi * cov))


def kalman_update(mean, cov, z, noise):
    """Return posterior mean and covariance and the likelihood of one position."""
    innovation = H @ cov @ H.T + noise
    gain = cov @ H.T @ np.linalg.inv(innovation)
    likelihood = density(z, H @ mean, innovation)
    return mean + gain @ (z - H @ mean), (np.eye(4) - gain @ H) @ cov, likelihood


def exact_predict(mixture, matrices, process_noise, transition):
    """Split every hypothesis by the mode it switches to, then move it."""
    return [
        Gaussian(item.weight * transition[item.mode, mode],
                 matrices[mode] @ item.mean,
                 matrices[mode] @ item.cov @ matrices[mode].T + process_noise, mode)
        for item in mixture for mode in range(len(matrices))
        if transition[item.mode, mode] > 0.0
    ]


def exact_update(mixture, positions, noise, detected, clutter):
    """Split every hypothesis by the detection that is its own, or none; drop what is nothing."""
    split = []
    for item in mixture:
        split.append(Gaussian((1 - detected) * item.weight, item.mean, item.cov, item.mode))
        for z in positions:
            mean, cov, likelihood = kalman_update(item.mean, item.cov, z, noise)
            weight = item.weight * detected * likelihood / clutter
            split.append(Gaussian(weight, mean, cov, item.mode))
    total = sum(item.weight for item in split)
    kept = [item for item in split if item.weight > 1e-10 * total]
    for item in kept:
        item.weight /= total
    return kept, total


def exact_moments(mixture):
    """Return mean and covariance of a mixture."""
    mean = sum(item.weight * item.mean for item in mixture)
    cov = sum(item.weight * (item.cov + np.outer(item.mean - mean, item.mean - mean))
              for item in mixture)
    return mean, cov


def exact_modes(mixture, count):
    """Return the probability of each mode."""
    return np.array([sum(item.weight for item in mixture if item.mode == mode)
                     for mode in range(count)])


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
