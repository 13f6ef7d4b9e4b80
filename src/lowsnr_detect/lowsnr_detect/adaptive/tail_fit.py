# SPDX-License-Identifier: Apache-2.0
"""
The tail of a statistic by region: white noise, unless the data say otherwise.

Level and scale of the maxima of the frame are shrunk towards those of white noise, and those of
each region towards those of the frame, by firm shrinkage (Gao and Bruce 1997): what lies less
than some standard errors away is not different, and what lies clearly further away is not shrunk.
What agrees with white noise therefore is white noise, exactly, and what is clear follows from the
number of independent maxima.

The rarity of an excess is -ln of its probability in white noise, exponential with mean 1 there.
How many excesses there are, and the mean of their rarity, are learned from the whole frame.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

from lowsnr_detect.adaptive.region_maps import bin_quantile
from lowsnr_detect.adaptive.region_maps import pooled
from lowsnr_detect.adaptive.tail_memory import TailMemory
from lowsnr_detect.adaptive.white_tail import LEVEL
from lowsnr_detect.adaptive.white_tail import WhiteTail
import numpy as np

# Squared standard errors, of level and scale together and of one number, up to which these are
# those of white noise (chi-squared exceeds them with 5 %), and the factor from which on they are
# those of the data.
_PAIR, _SINGLE, _FIRM = 6.0, 4.0, 1.5
# Bins of a region, in steps of arsinh((x - level) / scale) of white noise.
_LOWEST, _HIGHEST, BINS = -4.0, 9.0, 160
# Maxima from which on a single object, which counts as three of them in its first frame, moves
# none of the quantiles; where fewer were seen, maxima of white noise make up for the rest.
_FEW = 40.0
# Bins of the rarity, and their width [nat].
RARITIES, RARITY_STEP = 60, 0.25
# Rarities count as at most that many bins, so that objects do not make the tail.
_CENSORED = 24
# A pooled excess counts as so many, by the weights of regions, times the efficiency of the median
# ln(2)^2; the scale counts as known from at least so many, and no threshold is raised further.
_POOLED, _LEAST_KNOWN, _MOST = 0.86, 3.0, 4.0
# Frames of white noise that the number of maxima in a frame begins with.
_COUNTED = 2.0


@dataclass(frozen=True)
class Levels:
    """
    Level and scale [nat] of each region, (P, R, C), and how well the scale is known.

    The latter is a number of independent excesses: a scale that is known from n of them makes of
    exp(-y) the probability ``(1 + y / n)^-n``.
    """

    level: np.ndarray
    scale: np.ndarray
    known: np.ndarray


def bins_of(value: np.ndarray, white: WhiteTail) -> np.ndarray:
    """Return the bin of each value."""
    step = np.arcsinh((value - white.level) / white.scale) - _LOWEST
    return np.asarray(np.clip(step * (BINS / (_HIGHEST - _LOWEST)), 0, BINS - 1).astype(np.intp))


def frame_quantile(counts: np.ndarray, part: float, white: WhiteTail) -> np.ndarray:
    """Return a quantile of histograms (..., BINS)."""
    step = _LOWEST + bin_quantile(counts, part) * ((_HIGHEST - _LOWEST) / BINS)
    return np.asarray(white.level + white.scale * np.sinh(step))


def made_up(counts: np.ndarray, white: WhiteTail) -> np.ndarray:
    """Return histograms (P, R, C, BINS), those of few maxima with maxima of white noise added."""
    regions = counts.shape[1] * counts.shape[2]
    missing = np.maximum(_FEW - counts.sum(axis=(1, 2, 3), keepdims=True), 0.0) / regions
    if not missing.any():
        return counts
    edges = _LOWEST + np.arange(1, BINS) * ((_HIGHEST - _LOWEST) / BINS)
    below = white.below(white.level + white.scale * np.sinh(edges))
    return np.asarray(counts + missing * np.diff(below, prepend=0.0, append=1.0))


def levels(counts: np.ndarray, white: WhiteTail, correlated: int) -> Levels:
    """
    Return level and scale of each region.

    Parameters
    ----------
    counts : (P, R, C, BINS) ndarray
        Numbers of maxima.
    white
        The tail in white noise.
    correlated
        Frames over which maxima depend on each other.

    """
    counts = made_up(counts, white)
    whole = counts.sum(axis=(1, 2), keepdims=True)
    start = (np.full((1, 1, 1), white.level), np.full((1, 1, 1), white.scale))
    level, scale, frame = _shrunk(whole, start, white, correlated)
    level, scale, region = _shrunk(pooled(counts), (level, scale), white, correlated)
    known = 1.0 / np.clip(np.maximum(frame, region), 1e-9, 1.0 / _LEAST_KNOWN)
    return Levels(level, scale, known)


def _shrunk(
    counts: np.ndarray, towards: tuple[np.ndarray, np.ndarray], white: WhiteTail, correlated: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return level, scale and its uncertainty of histograms, shrunk towards others."""
    level, scale = towards
    low, high = (frame_quantile(counts, part, white) for part in (LEVEL, (1.0 + LEVEL) / 2.0))
    found = np.maximum((high - low) / math.log(2.0), 1e-3 * white.scale)
    tail = counts.sum(axis=-1) / correlated * (1.0 - LEVEL)
    # Quantiles of an exponential tail: their spacings are independent (Renyi 1953).
    z2 = ((low - level) / scale)**2 * tail / LEVEL
    z2 += (np.log(found / scale) * math.log(2.0))**2 * tail
    keep = _kept(z2, _PAIR)
    uncertain = keep / np.maximum(_POOLED * tail, 1e-3)
    return level + keep * (low - level), scale * (found / scale)**keep, uncertain


def _kept(square: np.ndarray, white: float) -> np.ndarray:
    """Return the part that is kept of what differs by so many squared standard errors."""
    return np.asarray(np.clip((square / white - 1.0) / (_FIRM - 1.0), 0.0, 1.0))


def limits(
    memory: TailMemory, found: Levels, white: WhiteTail, cells: int, prob: float, correlated: int,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the thresholds that a frame exceeds with a probability, and their units.

    Parameters
    ----------
    memory
        What was seen in earlier frames.
    found
        Level and scale of each region.
    white
        The tail in white noise.
    cells
        Cells of a frame.
    prob
        Share of frames with a maximum above the threshold.
    correlated
        Frames over which maxima depend on each other.

    Returns
    -------
    threshold : (P, R, C) ndarray
        The thresholds [nat], none of them below that in white noise.
    unit : (P, R, C) ndarray
        By how much a value rises for the log of its probability to fall by 1.

    """
    share, mean = _learned(memory, white, correlated)
    number = memory.maxima.sum(axis=(1, 2, 3))
    a_frame = (number + _COUNTED * white.per_cell * cells) / (memory.weight + _COUNTED)
    wanted = -np.log(np.minimum(-math.log1p(-prob) / (a_frame * share), 0.9))
    stretched = np.minimum((mean * wanted)[:, None, None] / found.known, _MOST)
    rarity = found.known * np.expm1(stretched)
    excess, below = white.excess(rarity), white.excess(np.maximum(rarity - 1.0, 0.0))
    unit = found.scale * (excess - below) * mean[:, None, None] * np.exp(stretched)
    least = white.threshold(cells, prob)
    return np.maximum(found.level + found.scale * excess, least), unit


def _learned(
    memory: TailMemory, white: WhiteTail, correlated: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of the maxima that are beyond ``START``, and the mean of their rarity."""
    tail = memory.rarities.sum(axis=-1)
    middle = RARITY_STEP * (np.arange(_CENSORED) + 0.5)
    whole = memory.rarities[:, :_CENSORED]
    beyond = RARITY_STEP * _CENSORED * memory.rarities[:, _CENSORED:].sum(axis=-1)
    # The mean of an exponential variable that is known up to a value (Epstein and Sobel 1953).
    mean = (whole @ middle + beyond) / np.maximum(whole.sum(axis=-1), 1e-9)
    share = tail / np.maximum(memory.number, 1e-9) / white.share
    keep = []
    for log in (np.log(np.maximum(each, 1e-9)) for each in (share, mean)):
        away = log**2 * tail / correlated
        keep.append(np.exp(_kept(away, _SINGLE) * log))
    return white.share * keep[0], keep[1]
