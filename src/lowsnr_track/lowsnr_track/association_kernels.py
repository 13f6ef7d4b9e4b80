"""
The loop over particles and detections.

The function that calls it documents what it computes, as in
:mod:`lowsnr_common.core.particle_kernels`.
"""

from __future__ import annotations

from lowsnr_common.core.compiled import compiled
import numpy as np


@compiled
def gaussian_log_densities(
    states: np.ndarray, position: np.ndarray, cov: np.ndarray, index: np.ndarray,
) -> np.ndarray:
    """
    Return the log density of positions (m, 2) with covariance (m, 2, 2) at states (T, N, 4).

    ``index`` (T, G) chooses the positions of each cloud, -1 none, of density 0; (T, G, N).
    """
    clouds, count = states.shape[:2]
    density = np.empty((clouds, index.shape[1], count))
    x, y = np.empty(count), np.empty(count)
    for t in range(clouds):
        for n in range(count):
            x[n], y[n] = states[t, n, 0], states[t, n, 2]
        for g in range(index.shape[1]):
            m = index[t, g]
            if m < 0:
                density[t, g] = -np.inf
                continue
            xx, xy, yy = cov[m, 0, 0], cov[m, 0, 1], cov[m, 1, 1]
            determinant = xx * yy - xy**2
            along_x, along_y = -0.5 * yy / determinant, -0.5 * xx / determinant
            between = xy / determinant
            level = np.log(2.0 * np.pi) + 0.5 * np.log(determinant)
            to_x, to_y, out = position[m, 0], position[m, 1], density[t, g]
            for n in range(count):
                dx, dy = to_x - x[n], to_y - y[n]
                out[n] = dx * dx * along_x + dx * dy * between + dy * dy * along_y - level
    return density
