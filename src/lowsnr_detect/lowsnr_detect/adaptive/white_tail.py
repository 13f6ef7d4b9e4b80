# SPDX-License-Identifier: Apache-2.0
"""
The local maxima of a statistic in white noise: what adaptive thresholds begin with.

Quantiles of the excesses beyond ``START`` are those of the sample; of the rarest part of it, they
are those of a generalised Pareto distribution (Pickands 1975), which is fitted by
probability-weighted moments (Hosking and Wallis 1987).
"""

from __future__ import annotations

from dataclasses import dataclass
import math

from lowsnr_common.core.streams import stream
from lowsnr_detect.adaptive.local_maxima import local_maxima
from lowsnr_detect.parts.cell_detector import CellDetector
import numpy as np

# The level is this quantile of the maxima, and the scale the median excess over it, divided by
# ln 2: the mean of an exponential tail.
LEVEL = 0.8
# Quantiles that tell whether noise is white, even where many maxima are of objects.
MIDDLE = (0.25, 0.5)
# Excesses, in units of the scale, below which they are not part of the tail.
START = 1.0
# Maxima that the tail can be read from, at least.
_LEAST_MAXIMA = 2_000
# Part of the maxima that the distribution is fitted to.
_RAREST = 0.015
# Logs of the probabilities for which the excess is known; between them it is interpolated.
_LOG_PROB = -0.25 * np.arange(101)
# Simulated noise: cells of all runs, and frames until the statistic has settled.
_CELLS, _SETTLING = 32_768, 15


@dataclass(frozen=True)
class WhiteTail:
    """
    The tail of the local maxima of a statistic in white noise.

    ``middle``, quantiles ``MIDDLE``, ``level`` and ``scale`` [nat], maxima ``per_cell``, the
    ``share`` of them whose excess is beyond ``START``, and the ``excesses`` that one of these
    exceeds with probability 1 and further ones, each ``e^(1/4)`` times smaller.
    """

    middle: tuple[float, ...]
    level: float
    scale: float
    per_cell: float
    share: float
    excesses: tuple[float, ...]

    @classmethod
    def of(cls, maxima: np.ndarray, per_cell: float) -> WhiteTail:
        """Return the tail of a sample (n,)."""
        *middle, low, high = np.quantile(maxima, (*MIDDLE, LEVEL, (1.0 + LEVEL) / 2.0)).tolist()
        scale = (high - low) / math.log(2.0)
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
        return cls(
            tuple(middle), low, scale, per_cell, share, tuple(found.tolist()))

    @classmethod
    def bound(cls, reach: int) -> WhiteTail:
        """
        Return the tail of a statistic that is too rare in white noise to have a sample.

        A log-likelihood ratio exceeds x with a probability of at most ``exp(-x)`` (Wald 1947): at
        most one in every neighbourhood, with an exponential tail.
        """
        low, median = -np.log1p(-np.array(MIDDLE))
        rare = -math.log1p(-LEVEL)
        return cls(
            (float(low), float(median)), rare, 1.0, 1.0 / (2 * reach + 1)**2,
            (1.0 - LEVEL) * math.exp(-START), tuple((START - _LOG_PROB).tolist()))

    def rarity(self, excess: np.ndarray) -> np.ndarray:
        """Return -ln of the probability that one beyond ``START`` exceeds each excess [nat]."""
        return np.asarray(np.interp(excess, self.excesses, -_LOG_PROB))

    def excess(self, rarity: np.ndarray) -> np.ndarray:
        """Return the excess of each rarity [nat]; beyond the rarest known one, exponential."""
        slope = (self.excesses[-1] - self.excesses[-2]) / (_LOG_PROB[-2] - _LOG_PROB[-1])
        beyond = np.maximum(rarity + _LOG_PROB[-1], 0.0)
        return np.asarray(np.interp(rarity, -_LOG_PROB, self.excesses) + slope * beyond)

    def below(self, value: np.ndarray) -> np.ndarray:
        """Return the share of the maxima below each value [nat], between the quantiles known."""
        beyond = self.level + self.scale * np.array([math.log(2.0), *self.excesses])
        rare = [(1.0 - LEVEL) / 2.0, *(self.share * np.exp(_LOG_PROB))]
        known = np.maximum.accumulate(np.array([*self.middle, self.level, *beyond]))
        lowest = 2.0 * known[0] - known[1]
        return np.asarray(np.interp(
            value, [lowest, *known], [0.0, *MIDDLE, LEVEL, *(1.0 - np.array(rare))]))

    def threshold(self, cells: int, prob: float) -> float:
        """Return the value that a maximum exceeds in a share ``prob`` of frames of white noise."""
        wanted = -math.log1p(-prob) / (self.per_cell * cells * self.share)
        return self.level + self.scale * float(self.excess(np.maximum(-np.log(wanted), 0.0)))


def simulated_tail(detector: CellDetector, rows: int, cols: int, frames: int) -> WhiteTail:
    """Return the tail in simulated white noise, of runs of a number of frames of a size."""
    rng, shape = stream(0, 'calibration'), (_CELLS // (rows * cols), rows, cols)
    state, values = detector.init(shape), []
    for number in range(_SETTLING + frames):
        noise = detector.sensor.draw_noise(shape, rng)
        state, planes = detector.statistic(state, noise)
        if number >= _SETTLING:
            values += [
                local_maxima(np.ascontiguousarray(plane, np.float32), detector.peak_reach)[2]
                for plane in planes]
    maxima = np.concatenate(values).astype(float)
    if len(maxima) < _LEAST_MAXIMA:
        return WhiteTail.bound(detector.peak_reach)
    return WhiteTail.of(maxima, len(maxima) / (frames * math.prod(shape)))
