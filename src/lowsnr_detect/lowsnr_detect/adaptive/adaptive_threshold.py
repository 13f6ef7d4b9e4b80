# SPDX-License-Identifier: Apache-2.0
"""
A threshold from the tail of the statistic in the frames of the same sequence.

Real frames are not white noise: the level and the scale of their noise differ from sequence to
sequence, from region to region, and in time.  What noise and clutter reach is learned, causally,
from the local maxima of the statistic:

1. In each region, level and scale of the earlier frames and of this one: the 80 % quantile q of
   the maxima, and the median excess over it divided by ln 2 (the mean, for an exponential tail),
   which single objects hardly move.
2. The tail of the excesses ``e = (x - q) / scale`` of all regions together has the shape of that
   in white noise, stretched to the number and to the mean that were seen.

All are shrunk towards white noise (:mod:`lowsnr_detect.adaptive.tail_fit`), and no threshold is
below that in white noise.  Every region has the same share of the false alarms.  A maximum that is
above the threshold waits for the next frame: if one is near it there, it is an object's and left
out, unless the other maxima around have risen too: that is clutter which is not learned yet.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
import math

from lowsnr_detect.adaptive.local_maxima import local_maxima
from lowsnr_detect.adaptive.region_maps import at_cells
from lowsnr_detect.adaptive.region_maps import counted
from lowsnr_detect.adaptive.region_maps import log_odds
from lowsnr_detect.adaptive.region_maps import pooled
from lowsnr_detect.adaptive.tail_fit import BINS
from lowsnr_detect.adaptive.tail_fit import bins_of
from lowsnr_detect.adaptive.tail_fit import frame_quantile
from lowsnr_detect.adaptive.tail_fit import levels
from lowsnr_detect.adaptive.tail_fit import limits
from lowsnr_detect.adaptive.tail_fit import made_up
from lowsnr_detect.adaptive.tail_fit import RARITIES
from lowsnr_detect.adaptive.tail_fit import RARITY_STEP
from lowsnr_detect.adaptive.tail_memory import TailMemory
from lowsnr_detect.adaptive.white_tail import LEVEL
from lowsnr_detect.adaptive.white_tail import MIDDLE
from lowsnr_detect.adaptive.white_tail import START
from lowsnr_detect.adaptive.white_tail import WhiteTail
import numpy as np

# Side of a region [cells], and frames over which the tail is forgotten.
_REGION, _MEMORY_FRAMES = 24, 25
# Frames with maxima before the first answer.
LEARNING_FRAMES = 4
# The frame itself counts as so many for its level and scale: clutter changes faster than it is
# forgotten.
_THIS_FRAME = 3.0
# Share of the maxima around, without those above the threshold, that is below the level at least
# where these are objects; four fifths are expected, and added as so many maxima.
_LEAST_CALM, _CALM_PRIOR = 0.5, 3.0
# Cells within which an object's maximum stays from a frame to the next.
_FOLLOWED = 6
# Scales by which the quantiles ``MIDDLE`` of the maxima may differ from those in white noise for a
# statistic that needs it.  In 20 x 20 cells their standard deviation is 0.3 after four frames.
_NOT_WHITE = 1.0


@dataclass(frozen=True)
class Thresholds:
    """
    Thresholds of P planes by region, (P, R, C) of float32 [nat], and what they are made of.

    ``unit`` is by how much a value rises for its log odds to rise by 1.
    """

    threshold: np.ndarray
    unit: np.ndarray
    level: np.ndarray
    scale: np.ndarray


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
    only_white
        Whether nothing is declared where the noise is clearly not white.

    """

    prob: float
    white: WhiteTail
    shape: tuple[int, int]
    reach: int = 1
    correlated: int = 1
    only_white: bool = False
    grid: tuple[int, int] = field(init=False)

    def __post_init__(self) -> None:
        rows, cols = (max(1, round(size / _REGION)) for size in self.shape)
        object.__setattr__(self, 'grid', (rows, cols))

    @property
    def start(self) -> float:
        """Return the threshold in white noise [nat]."""
        return self.white.threshold(math.prod(self.shape), self.prob)

    def init(self, planes: int = 1) -> TailMemory:
        """Return the memory before the first frame."""
        return TailMemory(
            np.zeros((planes, *self.grid, BINS)), np.zeros((planes, RARITIES)), np.zeros(planes),
            np.zeros(planes), np.zeros(planes), 0.0, 0,
            np.zeros((planes, *self.shape), dtype=bool), np.zeros((5, 0)))

    def measured(self, memory: TailMemory) -> np.ndarray:
        """Return the share of frames with a crossing that is near none of the frame before."""
        return np.asarray(memory.alarms / np.maximum(memory.answered, 1.0))

    def thresholds(self, memory: TailMemory, maxima: np.ndarray | None = None) -> Thresholds:
        """Return the thresholds; ``maxima`` (P, R, C, bins) are those of the frame itself."""
        counts = memory.maxima
        if self.only_white:
            memory = self.init(len(counts))
            counts = memory.maxima
        elif maxima is not None:
            counts = counts + _THIS_FRAME * maxima
        found = levels(counts, self.white, self.correlated)
        threshold, unit = limits(
            memory, found, self.white, math.prod(self.shape), self.prob, self.correlated)
        shape = (len(counts), *self.grid)
        return Thresholds(*(np.broadcast_to(each, shape).astype(np.float32) for each in (
            threshold, unit, found.level, found.scale)))

    def step(
        self, memory: TailMemory, planes: np.ndarray,
    ) -> tuple[TailMemory, np.ndarray]:
        """
        Compare planes with the thresholds, and learn from them.

        Parameters
        ----------
        memory
            Memory after the frame before.
        planes : (P, rows, cols) ndarray of float32
            Statistic of independent runs.

        Returns
        -------
        TailMemory
            Memory after this frame.
        (P, rows, cols) ndarray of float32
            Log odds of each cell with respect to the threshold, which is at 0; -inf in frames
            without a local maximum and in the first ones, from which nothing is known yet.

        """
        each = [local_maxima(np.ascontiguousarray(plane), self.reach) for plane in planes]
        found = np.concatenate([
            np.stack([np.full(len(row), n), row, col, value])
            for n, (row, col, value) in enumerate(each)], axis=1)
        silent = np.full(planes.shape, -np.inf, np.float32)
        if not found.size:
            return memory, silent
        place = found[:3].astype(np.intp)
        maxima = self._histogram(found[:, ~memory.crossed[tuple(place)]], len(planes))
        at, answers = self.thresholds(memory, maxima), memory.frames >= LEARNING_FRAMES
        heard = self._white(memory.maxima + maxima) & answers
        for n in np.flatnonzero(heard):
            silent[n] = log_odds(planes[n], at.threshold[n], at.unit[n])
        return self._learned(memory, found, at, heard), silent

    def _white(self, maxima: np.ndarray) -> np.ndarray:
        """Return whether the noise of each plane is as the statistic needs it."""
        if not self.only_white:
            return np.ones(len(maxima), dtype=bool)
        counts = made_up(maxima, self.white).sum(axis=(1, 2))
        away = [np.abs(frame_quantile(counts, part, self.white) - value)
                for part, value in zip(MIDDLE, self.white.middle, strict=True)]
        return np.asarray(np.max(away, axis=0) <= _NOT_WHITE * self.white.scale)

    def _histogram(self, maxima: np.ndarray, planes: int) -> np.ndarray:
        """Return the numbers of maxima (plane, row, column, value, ...) by region and value."""
        place = *self._region(maxima), bins_of(maxima[3], self.white)
        return counted(place, (planes, *self.grid, BINS))

    def _learned(
        self, memory: TailMemory, found: np.ndarray, at: Thresholds, heard: np.ndarray,
    ) -> TailMemory:
        """Return the memory with the maxima of a frame, those of objects left out."""
        planes, kept = len(memory.number), 1.0 - 1.0 / _MEMORY_FRAMES
        threshold, level, scale = (
            self._at(each, found) for each in (at.threshold, at.level, at.scale))
        seen = np.concatenate([found, ((found[3] - level) / scale)[None]])
        place, above = tuple(found[:3].astype(np.intp)), found[3] > threshold
        calm = self._calm(found, above, found[3] < level, planes)
        crossed = self._near(found[:, above], planes)
        alone = ~crossed[tuple(memory.held[:3].astype(np.intp))]
        noise = np.concatenate(
            [seen[:, ~(crossed[place] & calm)], memory.held[:, alone]], axis=1)
        tail, run = noise[:, noise[4] > START], noise[0].astype(np.intp)
        rarities = kept * memory.rarities
        rarity = (self.white.rarity(tail[4]) / RARITY_STEP).astype(np.intp)
        np.add.at(rarities, (tail[0].astype(np.intp), np.minimum(rarity, RARITIES - 1)), 1.0)
        new = np.bincount(place[0][above & ~memory.crossed[place]], minlength=planes) > 0
        return TailMemory(
            kept * memory.maxima + self._histogram(noise, planes), rarities,
            kept * memory.number + np.bincount(run, minlength=planes),
            kept * memory.alarms + (new & heard), kept * memory.answered + heard,
            kept * memory.weight + 1.0, memory.frames + 1, crossed, seen[:, above & calm])

    def _at(self, values: np.ndarray, maxima: np.ndarray) -> np.ndarray:
        """Return values (P, R, C) of regions at the places of maxima."""
        plane, row, col = maxima[:3].astype(np.intp)
        return at_cells(values, plane, row, col, self.shape)

    def _region(self, maxima: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return plane, row and column of the region of each maximum."""
        plane, row, col = maxima[:3].astype(np.intp)
        return (plane, row * self.grid[0] // self.shape[0], col * self.grid[1] // self.shape[1])

    def _near(self, maxima: np.ndarray, planes: int) -> np.ndarray:
        """Return which cells (P, rows, cols) are near maxima."""
        near = np.zeros((planes, *self.shape), dtype=bool)
        for n, i, j in maxima[:3].astype(np.intp).T:
            near[n, max(i - _FOLLOWED, 0):i + _FOLLOWED + 1,
                 max(j - _FOLLOWED, 0):j + _FOLLOWED + 1] = True
        return near

    def _calm(
        self, found: np.ndarray, above: np.ndarray, low: np.ndarray, planes: int,
    ) -> np.ndarray:
        """Return where the maxima that are not above the threshold are as before."""
        region = self._region(found)
        few, every, high = (
            pooled(counted(region, (planes, *self.grid), which)[..., None])[..., 0]
            for which in (low & ~above, ~above, above))
        calm = few + LEVEL * _CALM_PRIOR >= _LEAST_CALM * (every + _CALM_PRIOR)
        calm &= high <= few + _CALM_PRIOR
        return np.asarray(calm[region])
