# SPDX-License-Identifier: Apache-2.0
"""
Compiled loops over the particles of all tracks.

Each is one pass over T tracks of N particles; arrays are C-contiguous.  The functions that call
them document what they compute, and tests hold them equal to plain NumPy.
"""

from __future__ import annotations

from lowsnr_common.core.compiled import compiled
import numpy as np


@compiled
def move_tracks(
    states: np.ndarray, modes: np.ndarray, cumulative: np.ndarray, matrices: np.ndarray,
    draw: np.ndarray, noise: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return states (T, N, 4) and modes (T, N) after a step.

    ``cumulative`` (M, M - 1) holds the cumulative transition probabilities of the modes without
    the last, and ``matrices`` (M, 4, 4) F of each mode.  ``draw`` (N,), uniform in [0, 1), and
    ``noise`` (N, 4), of covariance Q, are those of the n-th particle of every track.
    """
    tracks, count = modes.shape
    after, chosen = np.empty_like(states), np.empty_like(modes)
    for t in range(tracks):
        for n in range(count):
            mode = 0
            for bound in cumulative[modes[t, n]]:
                mode += draw[n] >= bound
            chosen[t, n] = mode
            along, across = matrices[mode, 0, 1], matrices[mode, 2, 1]
            cos, sin = matrices[mode, 1, 1], matrices[mode, 3, 1]
            v_x, v_y = states[t, n, 1], states[t, n, 3]
            after[t, n, 0] = states[t, n, 0] + along * v_x - across * v_y + noise[n, 0]
            after[t, n, 1] = cos * v_x - sin * v_y + noise[n, 1]
            after[t, n, 2] = states[t, n, 2] + across * v_x + along * v_y + noise[n, 2]
            after[t, n, 3] = sin * v_x + cos * v_y + noise[n, 3]
    return after, chosen


@compiled
def boxes(states: np.ndarray) -> np.ndarray:
    """Return the least and largest x and y of the particles of each track, (T, 2, 2)."""
    box = np.empty((len(states), 2, 2))
    for t in range(len(states)):
        left, right, low, high = np.inf, -np.inf, np.inf, -np.inf
        for n in range(states.shape[1]):
            x, y = states[t, n, 0], states[t, n, 2]
            left, right = min(left, x), max(right, x)
            low, high = min(low, y), max(high, y)
        box[t, 0, 0], box[t, 0, 1], box[t, 1, 0], box[t, 1, 1] = left, low, right, high
    return box


@compiled
def moments(states: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return mean (T, 4) and covariance (T, 4, 4) of states (T, N, 4) with weights (T, N)."""
    tracks, count = weights.shape
    mean, cov = np.empty((tracks, 4)), np.empty((tracks, 4, 4))
    for t in range(tracks):
        a, b, c, d = 0.0, 0.0, 0.0, 0.0
        for n in range(count):
            w = weights[t, n]
            a += w * states[t, n, 0]
            b += w * states[t, n, 1]
            c += w * states[t, n, 2]
            d += w * states[t, n, 3]
        mean[t, 0], mean[t, 1], mean[t, 2], mean[t, 3] = a, b, c, d
        aa, ab, ac, ad, bb, bc, bd, cc, cd, dd = (0.0,) * 10
        for n in range(count):
            w = weights[t, n]
            x, v = states[t, n, 0] - a, states[t, n, 1] - b
            y, u = states[t, n, 2] - c, states[t, n, 3] - d
            wx, wv, wy = w * x, w * v, w * y
            aa, ab, ac, ad = aa + wx * x, ab + wx * v, ac + wx * y, ad + wx * u
            bb, bc, bd = bb + wv * v, bc + wv * y, bd + wv * u
            cc, cd, dd = cc + wy * y, cd + wy * u, dd + w * u * u
        cov[t, 0] = aa, ab, ac, ad
        cov[t, 1] = ab, bb, bc, bd
        cov[t, 2] = ac, bc, cc, cd
        cov[t, 3] = ad, bd, cd, dd
    return mean, cov


@compiled
def drawn_particles(
    states: np.ndarray, modes: np.ndarray, log_weights: np.ndarray, chosen: np.ndarray,
    draw: np.ndarray, drawn: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return states, modes and log weights of the chosen tracks (C,), copied or drawn.

    Track ``chosen[i]`` is copied where ``draw[i]`` is -1.  Otherwise its particles are those of
    the indices ``drawn[draw[i]]`` (N,).
    """
    size, count = len(chosen), modes.shape[1]
    after, mode = np.empty((size, count, 4)), np.empty((size, count), modes.dtype)
    logs = np.empty((size, count))
    for i in range(size):
        t = chosen[i]
        if draw[i] < 0:
            after[i], mode[i], logs[i] = states[t], modes[t], log_weights[t]
            continue
        for n in range(count):
            source = drawn[draw[i], n]
            for axis in range(4):
                after[i, n, axis] = states[t, source, axis]
            mode[i, n] = modes[t, source]
            logs[i, n] = log_weights[t, source]
    return after, mode, logs


@compiled
def roughen(
    states: np.ndarray, chosen: np.ndarray, mean: np.ndarray, shrinkage: float,
    factor: np.ndarray, noise: np.ndarray,
) -> None:
    """
    Shrink the states (T, N, 4) of the chosen tracks (L,) to their mean and add noise, in place.

    ``mean`` (L, 4) and the lower triangular ``factor`` (L, 4, 4) are those of the chosen tracks;
    the noise (N, 4) is standard normal.
    """
    for i in range(len(chosen)):
        state, low = states[chosen[i]], factor[i]
        a, b, c, d = (1.0 - shrinkage) * mean[i]
        for n in range(len(noise)):
            e_0, e_1, e_2, e_3 = noise[n, 0], noise[n, 1], noise[n, 2], noise[n, 3]
            state[n, 0] = shrinkage * state[n, 0] + a + low[0, 0] * e_0
            state[n, 1] = shrinkage * state[n, 1] + b + low[1, 0] * e_0 + low[1, 1] * e_1
            state[n, 2] = shrinkage * state[n, 2] + c + (
                low[2, 0] * e_0 + low[2, 1] * e_1 + low[2, 2] * e_2)
            state[n, 3] = shrinkage * state[n, 3] + d + (
                low[3, 0] * e_0 + low[3, 1] * e_1 + low[3, 2] * e_2 + low[3, 3] * e_3)


@compiled
def mixtures(
    ratio: np.ndarray, factor: np.ndarray, none: np.ndarray, gated: np.ndarray,
) -> np.ndarray:
    """Return ``none_t + sum_g factor_tg ratio_tgn`` over the detections in gates, (T, N)."""
    tracks, size, count = ratio.shape
    mixture = np.empty((tracks, count))
    for t in range(tracks):
        mixture[t] = none[t]
        for g in range(size):
            if gated[t, g] >= 0:
                for n in range(count):
                    mixture[t, n] += factor[t, g] * ratio[t, g, n]
    return mixture


@compiled
def log_gaussians(
    states: np.ndarray, position: np.ndarray, cov: np.ndarray, log_scale: np.ndarray,
    gated: np.ndarray, density: np.ndarray,
) -> None:
    """
    Fill in the log density of positions (m, 2) with covariance (m, 2, 2) at states (T, N, 4).

    ``gated`` (T, G) chooses the positions for each track, -1 for none, for which nothing is filled
    into ``density`` (T, G, N); ``log_scale`` (T, G) is added.
    """
    for t in range(len(states)):
        for g in range(gated.shape[1]):
            j = gated[t, g]
            if j < 0:
                continue
            xx, xy, yy = cov[j, 0, 0], cov[j, 0, 1], cov[j, 1, 1]
            determinant = xx * yy - xy**2
            of_x, of_y = -0.5 * yy / determinant, -0.5 * xx / determinant
            of_both = xy / determinant
            constant = np.log(2.0 * np.pi) + 0.5 * np.log(determinant) - log_scale[t, g]
            z_x, z_y, out = position[j, 0], position[j, 1], density[t, g]
            for n in range(states.shape[1]):
                dx, dy = z_x - states[t, n, 0], z_y - states[t, n, 2]
                out[n] = dx * dx * of_x + dx * dy * of_both + dy * dy * of_y - constant
