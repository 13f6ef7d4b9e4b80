# SPDX-License-Identifier: Apache-2.0
"""
The imaging sensor, eqs. (2) to (4): the signal of an object and the likelihood of a frame.

The paper's cell (i, j) is column i, row j of a frame.  Pixel centres lie at integer
coordinates from 0, so the cell of a position is the nearest integer to
``position / cell_size_m``.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
import functools
import math

from lowsnr_common.core.motion import POS
from lowsnr_common.noise.intensity import amplitudes
from lowsnr_common.noise.intensity import FLUCTUATIONS
from lowsnr_common.noise.models import NoiseModel
from lowsnr_common.noise.ratio import matched_ratio
from lowsnr_common.noise.ratio import moments_without_object
from lowsnr_common.noise.ratio import separable
from lowsnr_common.noise.ratio import summed_ratio
from lowsnr_common.noise.settings import Noise
from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import setting
import numpy as np

# Beyond so many blur widths the point spread is below exp(-5^2 / 2) = 4e-6 of its peak.
_REACH = 5.0
# Tables of other log ratios than the linear one grow with the intensity.
_MOST_TABLED_DB = 30.0


@dataclass(frozen=True, kw_only=True)
class SensorModel:
    """Noise, blur and sampling of the sensor, and the SNR that detectors are designed for."""

    snr_db: float = setting(
        6.0, 'object SNR per frame, 10 log10(I^2/sigma^2) of its cell, or with blur of the energy '
        'in all its cells [dB]', ge=-30.0, le=80.0, live=True)
    noise_std: float = setting(1.0, 'standard deviation sigma of the noise in a cell', gt=0.0)
    blur_m: float = setting(
        0.0, 'width Sigma of the point spread of eq. (2), 0 for none as in eq. (3) [m]',
        ge=0.0)
    cell_size_m: float = setting(1.0, 'side of a cell [m]', gt=0.0)
    frame_period_s: float = setting(1.0, 'time T from a frame to the next [s]', gt=0.0)

    noise: Noise = field(default_factory=Noise)
    fluctuation: str = setting(
        'constant', 'how the intensity varies: swerling1 and 3 from object to object, swerling2 '
        'and 4 from frame to frame, unknown within spread_db', choices=FLUCTUATIONS)
    spread_db: float = setting(
        6.0, 'range of an unknown SNR on each side of snr_db [dB]', gt=0.0, le=20.0)

    def __post_init__(self) -> None:
        check_settings(self)
        if self.snr_db > _MOST_TABLED_DB and not self.is_normal:
            raise ValueError(
                f'SensorModel.snr_db = {self.snr_db:g}, must be at most {_MOST_TABLED_DB:g} where '
                f'noise.model is {self.noise.model} and fluctuation {self.fluctuation}')

    @property
    def intensity(self) -> float:
        """
        Object intensity I of eqs. (2) and (3), in units of the frame.

        Without blur it is ``sigma 10^(SNR / 20)``.  With blur it is such that the energy in all
        cells, ``sum h^2``, is ``sigma^2 10^(SNR / 10)`` in the mean over the position of the
        object in its cell.
        """
        amplitude = float(self.noise_std * 10.0 ** (self.snr_db / 20.0))
        return amplitude * self._spread_root if self.blur_m > 0.0 else amplitude

    @property
    def peak_snr_db(self) -> float:
        """SNR of the brightest cell of an object in the middle of it [dB]."""
        return 20.0 * math.log10(self._peak / self.noise_std)

    @property
    def is_normal(self) -> bool:
        """Whether the noise is Gaussian and the intensity known."""
        return self.noise.model == 'gaussian' and self.fluctuation == 'constant'

    @property
    def is_linear(self) -> bool:
        """Whether the log-likelihood ratio of a cell is the one below eq. (4)."""
        return self.blur_m == 0.0 and self.is_normal

    @functools.cached_property
    def noise_model(self) -> NoiseModel:
        """Return the density of a cell, and its sampling."""
        return self.noise.of_std(self.noise_std)

    def cells(self, states: np.ndarray) -> np.ndarray:
        """
        Return the cell that holds each state.

        Parameters
        ----------
        states : (..., 4) ndarray
            States [m, m/s].

        Returns
        -------
        (..., 2) ndarray of int
            Row and column; may lie outside a frame.

        """
        pixel = states[..., POS[::-1]] / self.cell_size_m
        cells: np.ndarray = np.floor(pixel + 0.5).astype(np.intp)
        return cells

    def signal(self, state: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        """
        Return h_k(x_k) of eq. (2), or of eq. (3) without blur, for one object.

        Parameters
        ----------
        state : (4,) ndarray
            Object state [m, m/s].
        shape
            Rows and columns of the frame.

        Returns
        -------
        (rows, cols) ndarray
            Noise-free intensities; all zero for an object outside the frame.

        """
        frame = np.zeros(shape)
        if self.blur_m == 0.0:
            row, col = self.cells(state)
            if 0 <= row < shape[0] and 0 <= col < shape[1]:
                frame[row, col] = self.intensity
            return frame
        size = self.cell_size_m
        dx = np.arange(shape[1]) * size - state[POS[0]]
        dy = np.arange(shape[0])[:, None] * size - state[POS[1]]
        spread: np.ndarray = np.exp(-(dx**2 + dy**2) / (2 * self.blur_m**2))
        return self._peak * spread

    def log_likelihood_ratio(
        self, frame: np.ndarray, offset: tuple[float, float] = (0.0, 0.0),
    ) -> np.ndarray:
        """
        Return the log-likelihood ratio of "object in this cell" to "noise only".

        In normal noise without blur it is the ratio below eq. (4),
        ``I (2 z - I) / (2 sigma^2)``; with blur it is the sum of ``h (2 z - h) / (2 sigma^2)``
        over the cells that the point spread reaches.  For other noise, and an intensity that is
        not known, see :mod:`lowsnr_common.noise.ratio`.

        Parameters
        ----------
        frame : (..., rows, cols) ndarray
            Cell intensities z; leading axes are Monte Carlo runs.
        offset
            Position of the object from the centre of its cell in rows and columns, which matters
            with blur [cells].

        Returns
        -------
        (..., rows, cols) ndarray
            Log ratio per cell [nat].

        """
        if self.is_linear:
            intensity = self.intensity
            ratio: np.ndarray = np.multiply(frame, 2.0, dtype=float)
            ratio -= intensity
            ratio *= intensity / (2.0 * self.noise_std**2)
            return ratio
        frame, variance = np.asarray(frame, dtype=float), self.noise_std**2
        rows, cols = (self._spread(part) for part in offset)
        if self.noise.model != 'gaussian' or self.blur_m == 0.0:
            return summed_ratio(
                self.noise_model, self.noise_std, frame, self._peak * np.outer(rows, cols),
                self._amplitudes)
        matched = self._peak / variance * separable(frame, rows, cols)
        energy = self._peak**2 / variance * separable(
            np.ones(frame.shape[-2:]), rows**2, cols**2)
        return matched_ratio(matched, energy, self._amplitudes)

    def standardised(self, frame: np.ndarray) -> np.ndarray:
        """
        Return frames as statistics of mean 0 and variance 1 without an object, in their type.

        It is ``z / sigma`` in normal noise, and else the log ratio of every cell on its own for
        the brightest signal of an object, less its mean, over its standard deviation.
        """
        if self.noise.model == 'gaussian':
            return np.asarray(frame / frame.dtype.type(self.noise_std))
        model, std, peak = self.noise_model, self.noise_std, self._peak
        mean, spread = moments_without_object(model, std, peak)
        ratio = summed_ratio(model, std, frame, np.array([[peak]]), (np.ones(1), np.zeros(1)))
        return np.asarray((ratio - mean) / spread, frame.dtype)

    def draw_noise(self, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
        """Return frames of a shape without objects."""
        return self.noise_model.draw(np.zeros(shape), rng)

    @property
    def blur_reach(self) -> int:
        """Largest distance from an object's cell that its point spread reaches [cells]."""
        return 0 if self.blur_m == 0.0 else math.ceil(_REACH * self.blur_m / self.cell_size_m)

    @property
    def _spread_root(self) -> float:
        """Factor of I over the root of the mean energy of eq. (2), ``I^2 / (4 pi width^2)``."""
        return 2.0 * math.sqrt(math.pi) * self.blur_m / self.cell_size_m

    @property
    def _peak(self) -> float:
        """Signal of an object in the centre of its cell: the factor of eq. (2), or I."""
        if self.blur_m == 0.0:
            return self.intensity
        return self.intensity * self.cell_size_m**2 / (2.0 * math.pi * self.blur_m**2)

    @property
    def _amplitudes(self) -> tuple[np.ndarray, np.ndarray]:
        """Amplitudes that an object may have, relative to I, and their log probabilities."""
        return amplitudes(self.fluctuation, self.spread_db, 10.0 ** (self.snr_db / 20.0))

    def _spread(self, offset: float) -> np.ndarray:
        """Return one axis of the point spread around a cell, of peak one, (2 reach + 1,)."""
        if self.blur_m == 0.0:
            return np.ones(1)
        offsets = np.arange(-self.blur_reach, self.blur_reach + 1) - offset
        spread: np.ndarray = np.exp(-(offsets * self.cell_size_m)**2 / (2.0 * self.blur_m**2))
        return spread
