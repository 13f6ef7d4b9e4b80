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


def components(nodes, links):
    """Return the sets of nodes that links (pairs) connect."""
    parts = [{node} for node in nodes]
    for one, two in links:
        joined = set().union(*(part for part in parts if part & {one, two}))
        parts = [part for part in parts if not part & {one, two}] + [joined]
    return [sorted(part) for part in parts]


def joint_groups(given, linked):
    """
    Return the posterior of tracks that may be unresolved, by enumeration of links and causes.

    ``given`` has the tracks, in whose gates the detection of column j is j, and ``linked`` (T, T)
    the probabilities of the links.  Returns the probability (T, N) that the object exists and is
    at the particle, (T, m) that it exists and caused the detection, and (m,) that some object did.
    """
    tracks, count = given.gated.shape
    size = given.particles.modes.shape[1]
    present, caused = np.zeros((tracks, size)), np.zeros((tracks, count))
    shared, total = np.zeros(count), 0.0
    for exists in itertools.product((False, True), repeat=tracks):
        alive = np.flatnonzero(exists)
        pairs = [pair for pair in itertools.combinations(alive, 2) if linked[pair] > 0.0]
        prior = np.prod(np.where(exists, given.existence, 1.0 - given.existence))
        for links in itertools.product((False, True), repeat=len(pairs)):
            groups = components(alive, itertools.compress(pairs, links))
            chance = prior * np.prod([linked[pair] if link else 1.0 - linked[pair]
                                      for pair, link in zip(pairs, links)])
            for causes in itertools.product(range(-1, count), repeat=len(groups)):
                used = [j for j in causes if j >= 0]
                if len(used) > len(set(used)) or any(
                        j not in given.gated[t] for group, j in zip(groups, causes) if j >= 0
                        for t in group):
                    continue
                weight = chance * np.prod([
                    group_likelihood(given, group, j) for group, j in zip(groups, causes)])
                total += weight
                shared[used] += weight
                for group, j in zip(groups, causes):
                    for t in group:
                        present[t] += weight * group_shape(given, group, j, t)
                        caused[t, j] += weight * (j >= 0)
    return present / total, caused / total, shared / total


def group_likelihood(given, group, j):
    """Return the likelihood of a detection of the mean of a group of Gaussians, or of none."""
    if j < 0:
        return 1.0 - given.detected[group].mean()
    if len(group) == 1:
        at = given.particles.states[group[0]] @ H.T
        return given.scale[group[0], j] * densities(
            at - given.measured.position[j], given.measured.cov[[j]]).mean()
    at = [given.particles.states[t] @ H.T for t in group]
    means, cov = np.mean(at, axis=1), [np.cov(each.T, bias=True) for each in at]
    wide = given.measured.cov[j] + np.cov(means.T, bias=True) + np.sum(cov, axis=0) / len(at)**2
    offset = given.measured.position[j] - means.mean(axis=0)
    return given.scale[group, j].mean() * densities(offset[None], wide[None])[0]


def group_shape(given, group, j, track):
    """Return the posterior of the particles of a track in a group, (N,)."""
    at = {t: given.particles.states[t] @ H.T for t in group}
    if j < 0:
        return np.full(len(at[track]), 1.0 / len(at[track]))
    means = np.array([each.mean(axis=0) for each in at.values()])
    wide = given.measured.cov[j] + np.cov(means.T, bias=True) * (len(at) > 1)
    for t in at.keys() - {track}:
        wide = wide + np.cov(at[t].T, bias=True) / len(at)**2
    shift = sum(at[t].mean(axis=0) for t in at.keys() - {track})
    seen = (at[track] + shift) / len(at)
    weight = densities(given.measured.position[j] - seen, wide[None])
    return weight / weight.sum()
