"""
The tail of a statistic by region: white noise, unless the data say otherwise.

Level and scale of the maxima of the frame are shrunk towards those of white noise, and those of
each region towards those of the frame, by the positive-part rule of James and Stein (1961): an
estimate that lies z standard errors away keeps the part ``max(0, 1 - c / z^2)`` of the way.  What
agrees with white noise is white noise, exactly; what clearly differs is hardly shrunk, and what
is clear follows from the number of independent maxima.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

from lowsnr_detect.adaptive.region_maps import bin_quantile
from lowsnr_detect.adaptive.region_maps import pooled
from lowsnr_detect.adaptive.white_tail import LEVEL
from lowsnr_detect.adaptive.white_tail import START
from lowsnr_detect.adaptive.white_tail import WhiteTail
import numpy as np

# c for level and scale together, and for one number.  Maxima depend on each other, and quantiles
# of few are not normal: c is twice what chi-squared exceeds with 5 %.
_PAIR, _SINGLE = 12.0, 7.6
# Excesses count as at most that, so that the few largest maxima do not make the tail.
_LARGEST = 5.0
_STEPS = np.linspace(START, _LARGEST, 9)
# Bins of a region, in steps of arsinh((x - level) / scale) of white noise.
_LOWEST, _HIGHEST, BINS = -4.0, 9.0, 160
# The scale of clutter varies within a region, and from frame to frame, as the mean of so many
# excesses does (compound clutter: Ward 1981).
_TEXTURE = 14.0
# A pooled excess counts as so many, by the weights of regions, times the efficiency of the median
# ln(2)^2; the scale counts as known from at least so many, and no threshold is raised further.
_POOLED, _LEAST_KNOWN, _MOST = 0.86, 3.0, 4.0
# Frames of white noise that the number of maxima in a frame begins with.
_COUNTED = 2.0


@dataclass(frozen=True)
class TailFit:
    """
    The tail of P planes by region.

    ``level`` and ``scale`` [nat] are (P, R, C); ``excess``, the threshold in units of the scale,
    and ``slope``, the decrease of the log probability there, are (P, 1, 1).
    """

    level: np.ndarray
    scale: np.ndarray
    excess: np.ndarray
    slope: np.ndarray


def bins_of(value: np.ndarray, white: WhiteTail) -> np.ndarray:
    """Return the bin of each value."""
    step = np.arcsinh((value - white.level) / white.scale) - _LOWEST
    return np.asarray(np.clip(step * (BINS / (_HIGHEST - _LOWEST)), 0, BINS - 1).astype(np.intp))


def fitted(
    counts: np.ndarray, frames: float, white: WhiteTail, cells: int, prob: float, correlated: int,
) -> TailFit:
    """
    Return the tail, and the threshold that a frame exceeds with a probability.

    Parameters
    ----------
    counts : (P, R, C, BINS) ndarray
        Faded numbers of maxima.
    frames
        Faded number of frames they are from.
    white
        The tail in white noise.
    cells
        Cells of a frame.
    prob
        Share of frames with a maximum above the threshold.
    correlated
        Frames over which maxima depend on each other.

    """
    level, scale, known = levels(counts, white, correlated)
    number = counts.sum(axis=(1, 2, 3))[:, None, None]
    share, stretch = _stretch(counts, (level, scale), white, correlated)
    a_frame = (number + _COUNTED * white.per_cell * cells) / (frames + _COUNTED)
    wanted = np.minimum(-math.log1p(-prob) / (a_frame * share), 0.9)
    excess = white.excess(wanted)
    over = START + stretch * (excess - START)
    return TailFit(
        level, scale, known * np.expm1(np.minimum(over / known, _MOST)),
        white.decay(excess) / stretch)


def levels(
    counts: np.ndarray, white: WhiteTail, correlated: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return level and scale of each region (P, R, C), and how well the scale is known.

    The latter is a number of independent excesses: a scale that is known from n of them, or that
    varies like the mean of n of them, makes of exp(-e) the probability (1 + e / n)^-n.
    """
    whole = counts.sum(axis=(1, 2), keepdims=True)
    start = (np.full((1, 1, 1), white.level), np.full((1, 1, 1), white.scale))
    level, scale, frame = _shrunk(whole, start, white, correlated)
    level, scale, region = _shrunk(pooled(counts), (level, scale), white, correlated)
    return level, scale, 1.0 / np.clip(np.maximum(frame, region), 1e-9, 1.0 / _LEAST_KNOWN)


def _shrunk(
    counts: np.ndarray, towards: tuple[np.ndarray, np.ndarray], white: WhiteTail, correlated: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return level, scale and its uncertainty of histograms, shrunk towards others."""
    level, scale = towards
    low, high = (_value(bin_quantile(counts, part), white) for part in (LEVEL, (1 + LEVEL) / 2))
    found = np.maximum((high - low) / math.log(2.0), 1e-3 * white.scale)
    tail = counts.sum(axis=-1) / correlated * (1.0 - LEVEL)
    # Quantiles of an exponential tail: their spacings are independent (Renyi 1953).
    z2 = ((low - level) / scale)**2 * tail / LEVEL
    z2 += (np.log(found / scale) * math.log(2.0))**2 * tail
    keep = np.maximum(1.0 - _PAIR / np.maximum(z2, _PAIR), 0.0)
    uncertain = keep * (1.0 / np.maximum(_POOLED * tail, 1e-3) + 1.0 / _TEXTURE)
    return level + keep * (low - level), scale * (found / scale)**keep, uncertain


def _value(place: np.ndarray, white: WhiteTail) -> np.ndarray:
    """Return the value at a place in bins from the first edge."""
    step = _LOWEST + place * ((_HIGHEST - _LOWEST) / BINS)
    return np.asarray(white.level + white.scale * np.sinh(step))


def _stretch(
    counts: np.ndarray, tail: tuple[np.ndarray, np.ndarray], white: WhiteTail, correlated: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of maxima beyond ``START``, and their mean, that of white noise being 1."""
    level, scale = (each[..., None] for each in tail)
    above = _above(counts, level + scale * _STEPS, white).sum(axis=(1, 2), keepdims=True)
    every = np.maximum(counts.sum(axis=(1, 2, 3), keepdims=True)[..., 0], 1e-9)
    beyond = np.maximum(above[..., 0], 1e-9)
    number = above[..., 0] / correlated
    share = np.log(beyond / every / white.share)
    mean = np.log(_mean(above / beyond[..., None]) / _mean(white.survival(_STEPS)))
    keep = [np.maximum(1.0 - _SINGLE / np.maximum(each**2 * number, _SINGLE), 0.0)
            for each in (share, mean)]
    return white.share * np.exp(keep[0] * share), np.exp(keep[1] * mean)


def _mean(survival: np.ndarray) -> np.ndarray:
    """Return the mean of an exponential excess that is known up to the largest step."""
    area = np.sum(survival[..., 1:] + survival[..., :-1], axis=-1) * (_STEPS[1] - _STEPS[0]) / 2
    return np.asarray(np.maximum(area / np.maximum(1.0 - survival[..., -1], 1e-3), 1e-3))


def _above(counts: np.ndarray, values: np.ndarray, white: WhiteTail) -> np.ndarray:
    """Return how many of the counts (P, R, C, BINS) are above values (P, R, C, n)."""
    place = (np.arcsinh((values - white.level) / white.scale) - _LOWEST) * (
        BINS / (_HIGHEST - _LOWEST))
    place = np.clip(place, 0.0, BINS - 1e-6)
    rest = np.cumsum(counts[..., ::-1], axis=-1)[..., ::-1]
    number = place.astype(np.intp)
    inside = np.take_along_axis(counts, number, -1)
    return np.asarray(np.take_along_axis(rest, number, -1) - (place - number) * inside)
