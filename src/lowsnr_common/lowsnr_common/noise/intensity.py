# SPDX-License-Identifier: Apache-2.0
"""
The intensity of an object: constant, fluctuating as in the models of Swerling, or unknown.

The power P of an object, relative to that of its SNR, has mean 1 where it fluctuates (Swerling
1960): it is exponential in the cases 1 and 2, and gamma distributed of shape 2 in 3 and 4.  Cases
1 and 3 draw it once for an object, 2 and 4 anew in every frame.  An unknown intensity is drawn
once: its SNR is uniform within ``spread_db`` of the stated one.

A detector does not know P.  Its likelihood is the mean over the distribution of P, frame by frame;
for a power that is drawn once this leaves out what earlier frames tell about it.
"""

from __future__ import annotations

import functools
import math

import numpy as np

FLUCTUATIONS = ('constant', 'swerling1', 'swerling2', 'swerling3', 'swerling4', 'unknown')
# Power that a fluctuating object exceeds with the probability 1e-8, by the shape of its gamma
# distribution.
_MOST_POWER = {1: 18.42, 2: 10.75}
_LEAST_NODES = 16


@functools.lru_cache(maxsize=64)
def amplitudes(kind: str, spread_db: float, ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the nodes of the mean over the amplitude of an object, and their log weights.

    Parameters
    ----------
    kind, spread_db
        One of ``FLUCTUATIONS``, and half the range of an unknown SNR [dB].
    ratio
        ``I / sigma``: nodes are closer than the standard deviation of the noise.

    Returns
    -------
    (n,) ndarray
        Amplitudes relative to that of the SNR.
    (n,) ndarray
        Logarithms of their weights, which sum to one.

    """
    if kind == 'constant':
        return np.ones(1), np.zeros(1)
    if kind == 'unknown':
        limit = spread_db * math.log(10.0) / 20.0
        nodes, weights = _gauss_legendre(2.0 * ratio * math.sinh(limit))
        return np.exp(limit * nodes), np.log(weights)
    shape = _shape(kind)
    largest = math.sqrt(_MOST_POWER[shape])
    nodes, weights = _gauss_legendre(ratio * largest)
    amplitude = largest * (nodes + 1.0) / 2.0
    # The density of the square root of a power with the gamma distribution.
    log_weights = np.log(weights) + (2 * shape - 1) * np.log(amplitude) - shape * amplitude**2
    return amplitude, np.asarray(log_weights - np.log(np.exp(log_weights).sum()))


def draw_offsets_db(
    kind: str, spread_db: float, frames: int, rng: np.random.Generator,
) -> np.ndarray:
    """Return the SNR of an object less the stated one in each of some frames, (frames,) [dB]."""
    if kind == 'constant':
        return np.zeros(frames)
    count = frames if kind in ('swerling2', 'swerling4') else 1
    if kind == 'unknown':
        offsets = rng.uniform(-spread_db, spread_db, count)
    else:
        shape = _shape(kind)
        offsets = 10.0 * np.log10(rng.gamma(shape, 1.0 / shape, count))
    return np.broadcast_to(offsets, frames).copy()


def _shape(kind: str) -> int:
    """Return the shape of the gamma distribution of the power."""
    return 1 if kind in ('swerling1', 'swerling2') else 2


def _gauss_legendre(length: float) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes in (-1, 1) and weights of sum one for so many standard deviations."""
    nodes, weights = np.polynomial.legendre.leggauss(_LEAST_NODES + math.ceil(2.0 * length))
    return nodes, weights / 2.0
