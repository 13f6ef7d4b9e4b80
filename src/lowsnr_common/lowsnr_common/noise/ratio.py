# SPDX-License-Identifier: Apache-2.0
"""
Log-likelihood ratios of frames for objects of known or unknown amplitude, in any noise.

With w_i the weights of the amplitudes a_i, and h the signal of an object of amplitude 1 ::

    ln L = ln sum_i w_i prod_c p(z_c | a_i h_c) / p(z_c | 0)

over the cells c that the object reaches.  In normal noise the product is
``exp(a_i m - a_i^2 e / 2)`` with the matched filter ``m = sum h z / sigma^2`` and the energy
``e = sum h^2 / sigma^2``.
"""

from __future__ import annotations

from collections.abc import Callable
import functools
import math

from lowsnr_common.noise.models import NoiseModel
from lowsnr_common.noise.ratio_kernels import spread_ratio
import numpy as np
import scipy

# Range of a table [standard deviations; below, above, and above in signals], its step, and the
# signal from which the step is in proportion to it [standard deviations].
_BELOW, _ABOVE, _SIGNALS, _STEP, _LARGE = 12.0, 25.0, 2.5, 0.02, 8.0
# Step of the signals between which the ratio is linear, where an object reaches several cells.
_SIGNAL_STEP = 0.05
# Cells with less of the signal say next to nothing [standard deviations].
_LEAST_SIGNAL = 0.005
# Cells that moments are estimated from, to a few thousandths of a standard deviation.
_SAMPLES = 200_000

Amplitudes = tuple[np.ndarray, np.ndarray]


def separable(frame: np.ndarray, rows: np.ndarray, cols: np.ndarray) -> np.ndarray:
    """Correlate the last two axes of a frame with two kernels; the frame is zero outside."""
    for axis, kernel in ((frame.ndim - 2, rows), (frame.ndim - 1, cols)):
        frame = scipy.ndimage.correlate1d(frame, kernel, axis=axis, mode='constant')
    return frame


def matched_ratio(matched: np.ndarray, energy: np.ndarray, amplitudes: Amplitudes) -> np.ndarray:
    """
    Return ln L in normal noise.

    Parameters
    ----------
    matched, energy : (..., rows, cols) ndarray
        m and e above.
    amplitudes
        a_i and ln w_i.

    """
    return _mean(amplitudes, lambda amplitude: amplitude * (matched - amplitude * energy / 2.0))


def summed_ratio(
    model: NoiseModel, std: float, frame: np.ndarray, signal: np.ndarray, amplitudes: Amplitudes,
) -> np.ndarray:
    """
    Return ln L of an object at every cell, in any noise.

    Parameters
    ----------
    model, std
        Noise, and its standard deviation.
    frame : (..., rows, cols) ndarray
        Cell intensities.
    signal : (n, n) ndarray
        Signal h in the cells around that of the object; n is odd.
    amplitudes
        a_i and ln w_i.

    """
    if signal.size == 1:
        own = tuple((signal.item() * amplitudes[0]).tolist())
        return _looked_up(model, std, frame, own, tuple(amplitudes[1].tolist()))
    largest = float(amplitudes[0].max() * signal.max())
    values, first, step, signal_step = _surface(model, std, float(f'{1.001 * largest:.3g}'))
    reached = np.argwhere(amplitudes[0].max() * signal >= _LEAST_SIGNAL * std)
    signals = np.outer(signal[tuple(reached.T)], amplitudes[0]) / signal_step
    frames = np.ascontiguousarray(frame).reshape(-1, *frame.shape[-2:])
    return np.asarray(spread_ratio(
        frames, values, first, step, signal_step, reached - len(signal) // 2, signals,
        amplitudes[1],
    )).reshape(frame.shape)


@functools.lru_cache(maxsize=64)
def moments_without_object(model: NoiseModel, std: float, signal: float) -> tuple[float, float]:
    """Return mean and standard deviation of the log ratio of a cell without an object [nat]."""
    cells = model.draw(np.zeros(_SAMPLES), np.random.default_rng(0))
    ratio = _looked_up(model, std, cells, (signal,), (0.0,))
    return float(ratio.mean()), float(ratio.std())


def _looked_up(
    model: NoiseModel, std: float, frame: np.ndarray, signals: tuple[float, ...],
    log_weights: tuple[float, ...],
) -> np.ndarray:
    return np.asarray(np.interp(frame, *_table(model, std, signals, log_weights)))


@functools.lru_cache(maxsize=4096)
def _table(
    model: NoiseModel, std: float, signals: tuple[float, ...], log_weights: tuple[float, ...],
) -> tuple[np.ndarray, np.ndarray]:
    """Return values of a cell and their log ratio for the mean over some signals."""
    largest = max(signals) / std
    step = _STEP * max(1.0, largest / _LARGE)
    grid = std * np.arange(-_BELOW, _ABOVE + _SIGNALS * largest, step)
    with_object = _mean((np.array(signals), np.array(log_weights)),
                        lambda signal: model.log_density(grid, signal))
    return grid, with_object - model.log_density(grid, 0.0)


@functools.lru_cache(maxsize=64)
def _surface(
    model: NoiseModel, std: float, largest: float,
) -> tuple[np.ndarray, float, float, float]:
    """
    Return the log ratio of a cell for signals from 0 to the largest one, (signals, values).

    The values are those of the cell less its signal, with which the density of spiky noise moves.
    The others are the first value, the step of the values and that of the signals.
    """
    coarser = max(1.0, largest / std / _LARGE)
    step, signal_step = 2.0 * _STEP * coarser * std, _SIGNAL_STEP * coarser * std
    grid = np.arange(-_BELOW * std - largest, _ABOVE * std + _SIGNALS * largest, step)
    signals = signal_step * np.arange(math.ceil(largest / signal_step) + 2)
    ratios = [model.log_density(grid + signal, float(signal))
              - model.log_density(grid + signal, 0.0) for signal in signals]
    return np.stack(ratios), float(grid[0]), step, signal_step


def _mean(amplitudes: Amplitudes, log_value: Callable[[float], np.ndarray]) -> np.ndarray:
    """Return the logarithm of the mean of a value over the amplitudes."""
    total: np.ndarray | None = None
    for amplitude, log_weight in zip(*amplitudes, strict=True):
        term = log_value(float(amplitude)) + log_weight
        total = term if total is None else np.logaddexp(total, term)
    assert total is not None
    return total
