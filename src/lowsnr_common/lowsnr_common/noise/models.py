# SPDX-License-Identifier: Apache-2.0
"""
Models of the noise in a cell: the density of a cell with and without an object, and sampling.

A cell without an object has mean 0 and standard deviation sigma in every model but ``empirical``,
whose quantiles are those of the frames as they are.  The signal h of an object, eqs. (2) and (3),
enters a cell as it does in the sensor that the model is of:

- ``gaussian``, ``student_t`` and ``empirical`` (:mod:`lowsnr_common.noise.empirical`) add it:
  ``z = h + w``.
- ``rayleigh`` and ``k`` are the envelope of a complex amplitude, as of radar and sonar, with a
  uniform phase phi and complex noise u of power ``E|u|^2 = sigma^2``:
  ``z = sigma (|h e^(j phi) + u| - m) / s``, with m and s the mean and the standard deviation of
  ``|u|``.  u is Gaussian; in ``k`` its power varies from cell to cell by a gamma distributed
  texture of mean 1.
- ``poisson`` counts photons: ``n ~ Poisson(b + h sqrt(b) / sigma)`` with the background b, and
  ``z = sigma (n - b) / sqrt(b)``.

The SNR ``10 log10(I^2 / sigma^2)`` is therefore that of the signal to the noise that it adds to:
before the envelope is taken, and to the fluctuation of the background counts.
"""

from __future__ import annotations

from dataclasses import dataclass
import functools
import math
from typing import Protocol

from lowsnr_common.core.streams import standard_normal
import numpy as np
import scipy

# Nodes of the integral over the texture, equally spaced in its logarithm from e^-9 on.
_TEXTURES, _LEAST_LOG_TEXTURE = 160, -9.0
# The densities of an envelope and of counts are zero below these.
_LEAST_ENVELOPE, _LEAST_COUNT = 1e-6, 0.0


class NoiseModel(Protocol):
    """The density of a cell, and samples of it."""

    def __hash__(self) -> int:
        """Return the key of its tables."""
        ...

    def log_density(self, z: np.ndarray, signal: float) -> np.ndarray:
        """Return ln p(z | signal) of every cell of any shape; without an object signal is 0."""
        ...

    def draw(self, signal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return cells with the given signals, of the same shape."""
        ...


@dataclass(frozen=True)
class Gaussian:
    """Normal noise of standard deviation ``std``."""

    std: float

    def log_density(self, z: np.ndarray, signal: float) -> np.ndarray:
        """Return ln p(z | signal)."""
        scaled = (np.asarray(z) - signal) / self.std
        return np.asarray(-scaled**2 / 2.0 - math.log(self.std * math.sqrt(2.0 * math.pi)))

    def draw(self, signal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return cells with the given signals."""
        noise = standard_normal(signal.shape, rng)
        noise *= self.std
        noise += signal
        return np.asarray(noise)


@dataclass(frozen=True)
class StudentT:
    """Noise with Student's t distribution, scaled to the standard deviation ``std``."""

    std: float
    degrees_of_freedom: float

    @property
    def _scale(self) -> float:
        """Return the factor of a variable with Student's t distribution."""
        return self.std * math.sqrt((self.degrees_of_freedom - 2.0) / self.degrees_of_freedom)

    def log_density(self, z: np.ndarray, signal: float) -> np.ndarray:
        """Return ln p(z | signal)."""
        nu = self.degrees_of_freedom
        square = ((np.asarray(z) - signal) / self._scale)**2
        constant = (math.lgamma((nu + 1.0) / 2.0) - math.lgamma(nu / 2.0)
                    - math.log(nu * math.pi) / 2.0 - math.log(self._scale))
        return np.asarray(constant - (nu + 1.0) / 2.0 * np.log1p(square / nu))

    def draw(self, signal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return cells with the given signals."""
        noise = rng.standard_t(self.degrees_of_freedom, signal.shape)
        return np.asarray(signal + self._scale * noise)


@dataclass(frozen=True)
class Envelope:
    """
    The envelope of a complex amplitude in complex noise, shifted and scaled.

    Without an object it has the Rayleigh distribution where ``shape`` is infinite, and else the K
    distribution of that shape.
    """

    std: float
    shape: float

    @functools.cached_property
    def _moments(self) -> tuple[float, float]:
        """Return mean and standard deviation of the envelope of noise of power 1."""
        root = 1.0 if math.isinf(self.shape) else math.exp(
            math.lgamma(self.shape + 0.5) - math.lgamma(self.shape)) / math.sqrt(self.shape)
        mean = root * math.sqrt(math.pi) / 2.0
        return mean, math.sqrt(1.0 - mean**2)

    @functools.cached_property
    def _textures(self) -> tuple[np.ndarray, np.ndarray]:
        """Return powers of the noise and the logarithms of their probabilities, (n,)."""
        if math.isinf(self.shape):
            return np.ones(1), np.zeros(1)
        largest = scipy.special.gammainccinv(self.shape, 1e-12) / self.shape
        edges = np.exp(np.linspace(_LEAST_LOG_TEXTURE, math.log(largest), _TEXTURES + 1))
        below = scipy.special.gammainc(self.shape, self.shape * edges)
        below[0], below[-1] = 0.0, 1.0
        return np.sqrt(edges[1:] * edges[:-1]), np.log(np.maximum(np.diff(below), 1e-300))

    def log_density(self, z: np.ndarray, signal: float) -> np.ndarray:
        """Return ln p(z | signal): the density of Rice, in the mean over the texture."""
        mean, spread = self._moments
        amplitude = signal / self.std
        a = np.maximum(mean + spread * np.asarray(z) / self.std, _LEAST_ENVELOPE)
        total = np.full(a.shape, -np.inf)
        for power, log_prob in zip(*self._textures, strict=True):
            rice = (np.log(2.0 * a / power) - (a - amplitude)**2 / power
                    + np.log(scipy.special.i0e(2.0 * amplitude / power * a)))
            total = np.logaddexp(total, log_prob + rice)
        return np.asarray(total + math.log(spread / self.std))

    def draw(self, signal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return cells with the given signals."""
        mean, spread = self._moments
        parts = standard_normal((2, *signal.shape), rng) / math.sqrt(2.0)
        if not math.isinf(self.shape):
            parts *= np.sqrt(rng.gamma(self.shape, 1.0 / self.shape, signal.shape))
        # The phase of the noise is uniform, so that the one of the object does not matter.
        envelope = np.hypot(parts[0] + signal / self.std, parts[1])
        return np.asarray(self.std * (envelope - mean) / spread)


@dataclass(frozen=True)
class Poisson:
    """Counts with the mean ``background`` without an object, shifted and scaled."""

    std: float
    background: float

    def log_density(self, z: np.ndarray, signal: float) -> np.ndarray:
        """Return the log probability of the counts, between whole ones by the gamma function."""
        root = math.sqrt(self.background)
        count = np.maximum(self.background + root * np.asarray(z) / self.std, _LEAST_COUNT)
        mean = self.background + root * signal / self.std
        return np.asarray(
            count * math.log(mean) - mean - scipy.special.gammaln(count + 1.0)
            + math.log(root / self.std))

    def draw(self, signal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return cells with the given signals."""
        root = math.sqrt(self.background)
        count = rng.poisson(self.background + root * signal / self.std)
        return np.asarray(self.std * (count - self.background) / root)
