"""
The imaging sensor, eqs. (2) to (4): the signal of an object and the likelihood of a frame.

The paper's cell (i, j) is column i, row j of a frame.  Pixel centres lie at integer
coordinates from 0, so the cell of a position is the nearest integer to
``position / cell_size_m``.
"""

from __future__ import annotations

from dataclasses import dataclass
import functools
import math

from lowsnr_common.core.motion import POS
from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import setting
import numpy as np
import scipy

# Beyond so many blur widths the point spread is below exp(-5^2 / 2) = 4e-6 of its peak.
_REACH = 5.0


@dataclass(frozen=True, kw_only=True)
class SensorModel:
    """Noise, blur and sampling of the sensor, and the SNR that detectors are designed for."""

    snr_db: float = setting(
        6.0, 'object SNR per cell and frame, 10 log10(I^2/sigma^2) [dB]', ge=-30.0, le=80.0,
        live=True)
    noise_std: float = setting(1.0, 'standard deviation sigma of the noise in a cell', gt=0.0)
    blur_m: float = setting(
        0.0, 'width Sigma of the point spread of eq. (2), 0 for none as in eq. (3) [m]',
        ge=0.0)
    cell_size_m: float = setting(1.0, 'side of a cell [m]', gt=0.0)
    frame_period_s: float = setting(1.0, 'time T from a frame to the next [s]', gt=0.0)

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def intensity(self) -> float:
        """Object intensity I, ``sigma 10^(SNR / 20)``, in units of the frame."""
        return float(self.noise_std * 10.0 ** (self.snr_db / 20.0))

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

    def log_likelihood_ratio(self, frame: np.ndarray) -> np.ndarray:
        """
        Return the log-likelihood ratio of "object at the centre of this cell" to "noise only".

        Without blur it is the ratio below eq. (4), ``I (2 z - I) / (2 sigma^2)``; with blur it is
        the sum of ``h (2 z - h) / (2 sigma^2)`` over the cells that the point spread reaches.

        Parameters
        ----------
        frame : (..., rows, cols) ndarray
            Cell intensities z; leading axes are Monte Carlo runs.

        Returns
        -------
        (..., rows, cols) ndarray
            Log ratio per cell [nat].

        """
        if self.blur_m == 0.0:
            intensity = self.intensity
            ratio: np.ndarray = np.multiply(frame, 2.0, dtype=float)
            ratio -= intensity
            ratio *= intensity / (2.0 * self.noise_std**2)
            return ratio
        frame = np.asarray(frame, dtype=float)
        axes = (frame.ndim - 2, frame.ndim - 1)
        matched = _separable(frame, self._spread, axes)
        ones = np.ones(frame.shape[-2:])
        energy = self._peak * _separable(ones, self._spread**2, (0, 1))
        ratio = self._peak * (2.0 * matched - energy) / (2.0 * self.noise_std**2)
        return ratio

    @property
    def blur_reach(self) -> int:
        """Largest distance from an object's cell that its point spread reaches [cells]."""
        return 0 if self.blur_m == 0.0 else math.ceil(_REACH * self.blur_m / self.cell_size_m)

    @property
    def _peak(self) -> float:
        """Factor of eq. (2) before the exponential."""
        return self.intensity * self.cell_size_m**2 / (2.0 * math.pi * self.blur_m**2)

    @functools.cached_property
    def _spread(self) -> np.ndarray:
        """One axis of the point spread around a cell centre, peak one, (2 reach + 1,)."""
        offsets = np.arange(-self.blur_reach, self.blur_reach + 1) * self.cell_size_m
        spread: np.ndarray = np.exp(-offsets**2 / (2.0 * self.blur_m**2))
        return spread


def _separable(frame: np.ndarray, kernel: np.ndarray, axes: tuple[int, int]) -> np.ndarray:
    """Convolve two axes of a frame with a symmetric kernel; the frame is zero outside."""
    for axis in axes:
        frame = scipy.ndimage.correlate1d(frame, kernel, axis=axis, mode='constant')
    return frame
