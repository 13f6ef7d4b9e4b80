"""
A threshold from the tail of the statistic in the earlier frames of the same sequence.

Real frames are not white noise: the level and the scale of their noise differ from sequence to
sequence and from region to region, by more than the shape of its tail.  What noise and clutter
reach is learned, causally, from the local maxima of the statistic in earlier frames:

1. In each region, level and scale: the 80 % quantile q of the maxima, and the median excess over
   it divided by ln 2 (the mean, for an exponential tail), which single objects hardly move.
2. The tail of the excesses ``e = (x - q) / scale`` of all regions together has the shape of that
   in white noise, stretched to the mean that was seen.

All are shrunk towards white noise (:mod:`lowsnr_detect.adaptive.tail_fit`).  Every region has the
same share of the false alarms.  The maxima below the threshold of the frame itself, which objects
hardly move, correct level and scale where they have clearly changed.  A maximum that is above the
threshold waits for the next frame: if one is near it there, it is an object's and left out, unless
the other maxima around have risen too: that is clutter which is not learned yet.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
import math

from lowsnr_detect.adaptive.local_maxima import local_maxima
from lowsnr_detect.adaptive.region_maps import at_cells
from lowsnr_detect.adaptive.region_maps import log_odds
from lowsnr_detect.adaptive.region_maps import pooled
from lowsnr_detect.adaptive.tail_fit import BINS
from lowsnr_detect.adaptive.tail_fit import bins_of
from lowsnr_detect.adaptive.tail_fit import fitted
from lowsnr_detect.adaptive.tail_fit import levels
from lowsnr_detect.adaptive.tail_memory import TailMemory
from lowsnr_detect.adaptive.tail_memory import Thresholds
from lowsnr_detect.adaptive.white_tail import LEVEL
from lowsnr_detect.adaptive.white_tail import WhiteTail
import numpy as np

# Side of a region [cells], and frames over which the tail is forgotten.
_REGION, _MEMORY_FRAMES = 24, 25
# Frames with maxima before the first answer.
LEARNING_FRAMES = 4
# Share of the maxima around, without those above the threshold, that is below the level at least
# where these are objects; four fifths are expected, and added as so many maxima.
_LEAST_CALM, _CALM_PRIOR = 0.5, 3.0
# Cells within which an object's maximum stays from a frame to the next.
_FOLLOWED = 6

Maxima = tuple[np.ndarray, np.ndarray, np.ndarray]


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

    @property
    def start(self) -> float:
        """Return the threshold in white noise [nat]."""
        fit = fitted(
            np.zeros((1, *self.grid, BINS)), 0.0, self.white, math.prod(self.shape), self.prob,
            self.correlated)
        return float((fit.level + fit.scale * fit.excess).max())

    def init(self, planes: int = 1) -> TailMemory:
        """Return the memory before the first frame."""
        return TailMemory(
            np.zeros((planes, *self.grid, BINS)), np.zeros(planes), 0.0, 0.0, 0,
            np.zeros((planes, *self.shape), dtype=bool))

    def measured(self, memory: TailMemory) -> np.ndarray:
        """Return the share of frames with a crossing that is near none of the frame before."""
        return np.asarray(memory.alarms / max(memory.answered, 1.0))

    def thresholds(self, memory: TailMemory) -> Thresholds:
        """Return the thresholds for the next frame."""
        fit = fitted(
            memory.maxima, memory.weight, self.white, math.prod(self.shape), self.prob,
            self.correlated)
        return Thresholds(*(each.astype(np.float32) for each in (
            fit.level + fit.scale * fit.excess, fit.scale / fit.slope, fit.level, fit.scale)))

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
        found = [local_maxima(np.ascontiguousarray(plane), max(self.reach, 1)) for plane in planes]
        if not any(value.size for _, _, value in found):
            return memory, np.full_like(planes, -np.inf)
        limits = self._adjusted(limits, found)
        answers = memory.frames >= LEARNING_FRAMES
        memory = self._learned(memory, found, limits, answers)
        if not answers:
            return memory, np.full_like(planes, -np.inf)
        return memory, np.stack([log_odds(*each) for each in zip(
            planes, limits.threshold, limits.scale, strict=True)])

    def _adjusted(self, limits: Thresholds, found: list[Maxima]) -> Thresholds:
        """Return the thresholds for a frame whose maxima as a whole are higher than before."""
        white, counts = self.white, np.zeros((len(found), *self.grid, BINS))
        for n, maxima in enumerate(found):
            above, calm = self._crossings(limits, n, maxima)
            row, col, value = (each[~(above & calm)] for each in maxima)
            level, scale = (
                at_cells(each[n], row, col, self.shape) for each in (limits.level, limits.tail))
            excess = (value - level) / scale
            np.add.at(counts[n], (*self._region(row, col), bins_of(
                white.level + white.scale * excess, white)), 1.0)
        level, scale, _ = levels(counts, white, 1)
        level, scale = np.maximum(level, white.level), np.maximum(scale, white.scale)
        if np.all(level == white.level) and np.all(scale == white.scale):
            return limits
        by = limits.tail * (level - white.level) / white.scale
        scale = scale / white.scale
        return Thresholds(*(each.astype(np.float32) for each in (
            limits.level + by + scale * (limits.threshold - limits.level), limits.scale * scale,
            limits.level + by, limits.tail * scale)))

    def _learned(
        self, memory: TailMemory, found: list[Maxima], limits: Thresholds, answers: bool,
    ) -> TailMemory:
        """Return the memory with the maxima of a frame, those of objects left out."""
        kept = 1.0 - 1.0 / _MEMORY_FRAMES
        maxima, alarms = kept * memory.maxima, kept * memory.alarms
        crossed, held = np.zeros_like(memory.crossed), []
        for n, (row, col, value) in enumerate(found):
            above, calm = self._crossings(limits, n, found[n])
            seen = np.stack([row, col, value])
            for i, j in zip(row[above], col[above]):
                crossed[n, max(i - _FOLLOWED, 0):i + _FOLLOWED + 1,
                        max(j - _FOLLOWED, 0):j + _FOLLOWED + 1] = True
            waits, beside = above & calm, crossed[n, row, col] & calm
            before = memory.held[n] if memory.held else seen[:, :0]
            alone = ~crossed[n, before[0].astype(np.intp), before[1].astype(np.intp)]
            for noise in (seen[:, ~beside], before[:, alone]):
                region = self._region(*noise[:2].astype(np.intp))
                np.add.at(maxima[n], (*region, bins_of(noise[2], self.white)), 1.0)
            alarms[n] += answers and bool(np.any(above & ~memory.crossed[n, row, col]))
            held.append(seen[:, waits])
        return TailMemory(
            maxima, alarms, kept * memory.weight + 1.0, kept * memory.answered + answers,
            memory.frames + 1, crossed, tuple(held))

    def _region(self, row: np.ndarray, col: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the region of each cell."""
        return (row * self.grid[0] // self.shape[0], col * self.grid[1] // self.shape[1])

    def _crossings(
        self, limits: Thresholds, n: int, maxima: Maxima,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return which maxima are above the threshold, and where the others are as before."""
        row, col, value = maxima
        region, counts = self._region(row, col), np.zeros((3, *self.grid))
        threshold, level = (
            at_cells(each[n], row, col, self.shape) for each in (limits.threshold, limits.level))
        above = value > threshold
        np.add.at(counts[0], region, value < level)
        np.add.at(counts[1], region, ~above)
        np.add.at(counts[2], region, above)
        low, every, high = pooled(counts[..., None])[..., 0]
        calm = low + LEVEL * _CALM_PRIOR >= _LEAST_CALM * (every + _CALM_PRIOR)
        calm &= high <= low + _CALM_PRIOR
        return above, np.asarray(calm[region])
