"""
The local maxima of a statistic in white noise: what adaptive thresholds begin with.

Quantiles of the excesses beyond ``START`` are those of the sample; of the rarest part of it, they
are those of a generalised Pareto distribution (Pickands 1975), which is fitted by
probability-weighted moments (Hosking and Wallis 1987).
"""

from __future__ import annotations

from dataclasses import dataclass
import functools
import math

from lowsnr_common.core.streams import stream
from lowsnr_detect.adaptive.local_maxima import local_maxima
from lowsnr_detect.parts.cell_detector import CellDetector
import numpy as np

# The level is this quantile of the maxima, and the scale the median excess over it, divided by
# ln 2: the mean of an exponential tail.
LEVEL = 0.8
# Excesses, in units of the scale, below which they are not part of the tail.
START = 1.0
# Part of the maxima that the distribution is fitted to.
_RAREST = 0.015
# Logs of the probabilities for which the excess is known; between them it is interpolated.
_LOG_PROB = -0.25 * np.arange(101)
# Simulated noise, after the statistic has settled: rows and columns at least and at most, because
# maxima are lower at the edges of small frames, and cells of all runs.
_LEAST, _SIDE, _CELLS, _SETTLING, _FRAMES = 16, 64, 32_768, 15, 250


@dataclass(frozen=True)
class WhiteTail:
    """
    The tail of the local maxima of a statistic in white noise.

    ``level`` and ``scale`` [nat], maxima ``per_cell``, the ``share`` of them whose excess is
    beyond ``START``, and the ``excesses`` that one of these exceeds with probability 1 and
    further ones, each ``e^(1/4)`` times smaller.
    """

    level: float
    scale: float
    per_cell: float
    share: float
    excesses: tuple[float, ...]

    @classmethod
    def of(cls, maxima: np.ndarray, per_cell: float) -> WhiteTail:
        """Return the tail of a sample (n,)."""
        low, high = np.quantile(maxima, (LEVEL, (1.0 + LEVEL) / 2.0))
        scale = float(high - low) / math.log(2.0)
        excess = np.sort((maxima - low) / scale)
        share = float(np.mean(excess > START))
        found = np.quantile(excess, 1.0 - share * np.exp(_LOG_PROB))
        count = max(int(_RAREST * len(excess)), 2)
        bound, beyond = excess[-count - 1], excess[-count:] - excess[-count - 1]
        first = float(beyond.mean())
        second = float(np.mean((count - np.arange(count) - 0.5) / count * beyond))
        slope, shape = (
            2.0 * first * second / (first - 2.0 * second), 2.0 - first / (first - 2.0 * second))
        rarer = _LOG_PROB + math.log(share / _RAREST)
        fitted = bound + slope * np.expm1(-shape * rarer) / shape
        found = np.where(rarer < 0.0, fitted, found)
        return cls(float(low), scale, per_cell, share, tuple(found.tolist()))

    def excess(self, prob: np.ndarray) -> np.ndarray:
        """Return the excess that one beyond ``START`` exceeds with each probability."""
        return np.asarray(np.interp(-np.log(prob), -_LOG_PROB, self.excesses))

    def survival(self, excess: np.ndarray) -> np.ndarray:
        """Return the probability that one beyond ``START`` exceeds each excess."""
        return np.asarray(np.exp(np.interp(excess, self.excesses, _LOG_PROB)))

    def decay(self, excess: np.ndarray) -> np.ndarray:
        """Return the decrease of the log of the survival at each excess, per unit of it."""
        return np.asarray(np.log(self.survival(excess - 0.5) / self.survival(excess + 0.5)))


@functools.lru_cache(maxsize=32)
def white_tail(detector: CellDetector, rows: int = _SIDE, cols: int = _SIDE) -> WhiteTail:
    """Return the tail of the local maxima of a statistic in white noise, in frames of a size."""
    rows, cols = (min(max(size, _LEAST), _SIDE) for size in (rows, cols))
    rng, shape = stream(0, 'calibration'), (_CELLS // (rows * cols), rows, cols)
    state, values = detector.init(shape), []
    for number in range(_SETTLING + _FRAMES):
        noise = detector.sensor.noise_std * rng.standard_normal(shape)
        state, planes = detector.statistic(state, noise)
        if number >= _SETTLING:
            values += [
                local_maxima(np.ascontiguousarray(plane, np.float32), detector.peak_reach)[2]
                for plane in planes]
    maxima = np.concatenate(values).astype(float)
    return WhiteTail.of(maxima, len(maxima) / (_FRAMES * math.prod(shape)))
