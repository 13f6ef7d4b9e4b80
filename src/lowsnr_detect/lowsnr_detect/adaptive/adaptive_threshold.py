"""
A threshold from the tail of the statistic in the earlier frames of the same sequence.

Real frames are not white noise: their tails differ from sequence to sequence and from region to
region.  What noise and clutter reach is learned, causally, from the local maxima of the statistic
in earlier frames:

1. In each region, level and scale: the 80 % quantile q of the maxima, and the median excess over
   it divided by ln 2 (the mean, for an exponential tail), which single objects hardly move.
2. The tail of the normalised excesses ``e = (x - q) / scale``, beyond what was seen by averaged
   Pareto distributions (:mod:`lowsnr_detect.adaptive.pareto_tail`).

By the number of independent maxima, regions are shrunk towards the whole frame, and all towards
white noise.  Every region has the same share of the false alarms.  A maximum that is above
the threshold waits for the next frame: if one is near it there, it is an object's and left out,
unless more than a fifth of the maxima around are above the threshold: that is clutter which is not
learned yet.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
import math
from typing import Any

from lowsnr_detect.adaptive.local_maxima import local_maxima
from lowsnr_detect.adaptive.pareto_tail import EDGES
from lowsnr_detect.adaptive.pareto_tail import exceeded
from lowsnr_detect.adaptive.pareto_tail import START
from lowsnr_detect.adaptive.region_maps import at_cells
from lowsnr_detect.adaptive.region_maps import bin_quantile
from lowsnr_detect.adaptive.region_maps import pooled
from lowsnr_detect.adaptive.region_maps import to_cells
from lowsnr_detect.adaptive.tail_memory import TailMemory
from lowsnr_detect.adaptive.tail_memory import Thresholds
from lowsnr_detect.adaptive.tail_memory import WhiteTail
import numpy as np

# The level of a region is this quantile of its maxima.
LEVEL = 0.8
# Side of a region [cells], and frames over which the tail is forgotten.
_REGION, _MEMORY_FRAMES = 24, 50
# Frames with maxima before the first answer.
LEARNING_FRAMES = 4
# White noise counts as so many independent maxima above the level of a region, and as so many of
# the tail of the frame.
_LEVEL_PRIOR, _TAIL_PRIOR = 10.0, 60.0
# The frame counts as so many independent maxima of the tail of a region.
_REGION_PRIOR = 20.0
# Largest share of the maxima around that are taken for objects.
_MOST_OBJECTS = 0.2
# Cells within which an object's maximum stays from a frame to the next.
_FOLLOWED = 4
# Bins of a region, in steps of arsinh((x - level) / scale) of white noise.
_LOWEST, _HIGHEST, _BINS = -4.0, 9.0, 160


@dataclass(frozen=True)
class AdaptiveThreshold:
    """
    The threshold of a statistic, for a share of empty frames with a crossing.

    Parameters
    ----------
    prob
        The share that is asked for.
    white
        The tail in white noise.
    shape
        Rows and columns.
    reach
        Cells on each side within which a maximum is the largest.
    correlated
        Frames over which the statistic is correlated.

    """

    prob: float
    white: WhiteTail
    shape: tuple[int, int]
    reach: int = 1
    correlated: int = 1
    grid: tuple[int, int] = field(init=False)

    def __post_init__(self) -> None:
        rows, cols = (max(1, round(size / _REGION)) for size in self.shape)
        object.__setattr__(self, 'grid', (rows, cols))

    def init(self, planes: int = 1) -> TailMemory:
        """Return the memory before the first frame."""
        return TailMemory(
            np.zeros((planes, *self.grid, _BINS)),
            np.zeros((planes, *self.grid, len(EDGES) - 1)), np.zeros(planes), 0.0, 0.0, 0,
            np.zeros((planes, *self.shape), dtype=bool))

    def measured(self, memory: TailMemory) -> np.ndarray:
        """Return the share of frames with a crossing that is near none of the frame before."""
        return np.asarray(memory.alarms / max(memory.answered, 1.0))

    def thresholds(self, memory: TailMemory) -> Thresholds:
        """Return the thresholds for the next frame."""
        level, excess, scale, slope = (
            each.astype(np.float32) for each in self._regions(memory))
        threshold, scales = (
            np.stack([to_cells(each, self.shape) for each in maps])
            for maps in (level + scale * excess, scale / slope))
        return Thresholds(threshold, scales, excess, slope)

    def step(
        self, memory: TailMemory, planes: np.ndarray, limits: Thresholds,
    ) -> tuple[TailMemory, np.ndarray]:
        """
        Compare planes with the thresholds from earlier frames, and learn from them.

        Parameters
        ----------
        memory
            Memory after the frame before.
        planes : (P, rows, cols) ndarray of float32
            Statistic of independent runs.
        limits
            What :meth:`thresholds` returns for the memory.

        Returns
        -------
        TailMemory
            Memory after this frame.
        (P, rows, cols) ndarray of float32
            Log odds of each cell with respect to the threshold, which is at 0; -inf in frames
            without a local maximum and in the first ones, from which nothing is known yet.

        """
        odds = planes - limits.threshold
        odds /= limits.scale
        found = [local_maxima(np.ascontiguousarray(plane), max(self.reach, 1)) for plane in planes]
        if not any(value.size for _, _, value in found):
            return memory, np.full_like(planes, -np.inf)
        answers = memory.frames >= LEARNING_FRAMES
        memory = self._learned(memory, found, odds, limits, answers)
        return memory, odds if answers else np.full_like(planes, -np.inf)

    def _learned(
        self, memory: TailMemory, found: list[tuple[np.ndarray, np.ndarray, np.ndarray]],
        odds: np.ndarray, limits: Thresholds, answers: bool,
    ) -> TailMemory:
        """Return the memory with the maxima of a frame, those of objects left out."""
        kept = 1.0 - 1.0 / _MEMORY_FRAMES
        maxima, excesses = kept * memory.maxima, kept * memory.excesses
        alarms, crossed = kept * memory.alarms, np.zeros_like(memory.crossed)
        held = []
        for n, (row, col, value) in enumerate(found):
            above = odds[n, row, col] > 0.0
            seen = np.stack([row, col, value, self._excess(limits, odds, (n, row, col))])
            for i, j in zip(row[above], col[above]):
                crossed[n, max(i - _FOLLOWED, 0):i + _FOLLOWED + 1,
                        max(j - _FOLLOWED, 0):j + _FOLLOWED + 1] = True
            few = self._few(self._region(row, col), above)
            waits, beside = above & few, crossed[n, row, col] & few
            before = memory.held[n] if memory.held else seen[:, :0]
            alone = ~crossed[n, before[0].astype(np.intp), before[1].astype(np.intp)]
            self._count(
                np.concatenate([seen[:, ~beside], before[:, alone]], axis=1),
                maxima[n], excesses[n])
            alarms[n] += answers and bool(np.any(above & ~memory.crossed[n, row, col]))
            held.append(seen[:, waits])
        return TailMemory(
            maxima, excesses, alarms, kept * memory.weight + 1.0,
            kept * memory.answered + answers, memory.frames + 1, crossed, tuple(held))

    def _excess(
        self, limits: Thresholds, odds: np.ndarray, cells: tuple[Any, ...],
    ) -> np.ndarray:
        """Return the normalised excess of cells, with the limits of the regions around."""
        n, row, col = cells
        limit, slope = (
            at_cells(each[n], row, col, self.shape) for each in (limits.excess, limits.slope))
        return np.asarray(limit + odds[n, row, col] / slope)

    def _region(self, row: np.ndarray, col: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the region of each cell."""
        return (row * self.grid[0] // self.shape[0], col * self.grid[1] // self.shape[1])

    def _count(self, noise: np.ndarray, maxima: np.ndarray, excesses: np.ndarray) -> None:
        """Count maxima (row, column, value, excess) in the bins of their regions."""
        region, value, excess = self._region(*noise[:2].astype(np.intp)), noise[2], noise[3]
        np.add.at(maxima, (*region, self._bin(value)), 1.0)
        tail = excess > START
        part = np.searchsorted(EDGES, excess[tail]) - 1
        np.add.at(excesses, (region[0][tail], region[1][tail], part), 1.0)

    def _few(self, region: tuple[np.ndarray, ...], above: np.ndarray) -> np.ndarray:
        """Return whether few of the maxima around each are above the threshold."""
        counts = np.zeros((2, *self.grid))
        np.add.at(counts[0], region, above)
        np.add.at(counts[1], region, 1.0)
        crossing, every = pooled(counts[..., None])[..., 0]
        return np.asarray((crossing <= _MOST_OBJECTS * every)[region])

    def _bin(self, value: np.ndarray) -> np.ndarray:
        """Return the bin of values."""
        step = np.arcsinh((value - self.white.level) / self.white.scale) - _LOWEST
        return np.asarray(
            np.clip(step * (_BINS / (_HIGHEST - _LOWEST)), 0, _BINS - 1).astype(np.intp))

    def _levels(self, maxima: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return level and scale of each region and its neighbours, (P, R, C)."""
        counts, white = pooled(maxima), self.white
        step = (_HIGHEST - _LOWEST) / _BINS
        low, high = (
            white.level + white.scale * np.sinh(_LOWEST + step * bin_quantile(counts, part))
            for part in (LEVEL, (1.0 + LEVEL) / 2.0))
        number = counts.sum(axis=-1) * (1.0 - LEVEL) / self.correlated
        weight = number / (number + _LEVEL_PRIOR)
        return (
            weight * low + (1.0 - weight) * white.level,
            weight * (high - low) / math.log(2.0) + (1.0 - weight) * white.scale)

    def _regions(self, memory: TailMemory) -> tuple[np.ndarray, ...]:
        """Return level, limit of the excess, scale, and slope at the limit, each (P, R, C)."""
        white, area = self.white, pooled(np.ones((1, *self.grid, 1)))[..., 0]
        level, scale = self._levels(memory.maxima)
        # Maxima, and independent ones of the tail, of the frame and of each region.
        number = memory.maxima.sum(axis=-1)
        a_region = white.per_cell * math.prod(self.shape) / math.prod(self.grid)
        maxima = (pooled(number[..., None])[..., 0] / area + a_region) / (memory.weight + 1.0)
        prior = np.array(white.excesses) / sum(white.excesses)
        frame = memory.excesses.sum(axis=(1, 2)) / self.correlated + _TAIL_PRIOR * prior
        total = number.sum(axis=(1, 2)) / self.correlated + _TAIL_PRIOR / white.share
        share = (frame.sum(axis=-1) / total)[:, None, None]
        frame = (frame / frame.sum(axis=-1, keepdims=True))[:, None, None]
        counts = pooled(memory.excesses) / self.correlated + _REGION_PRIOR * frame
        within = pooled(number[..., None])[..., 0] / self.correlated + _REGION_PRIOR / share
        share = counts.sum(axis=-1) / within
        wanted = -math.log1p(-self.prob) / (math.prod(self.grid) * maxima * share)
        excess, slope = exceeded(counts, np.minimum(wanted, 0.5))
        return level, excess, scale, slope
