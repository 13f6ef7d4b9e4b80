# SPDX-License-Identifier: Apache-2.0
"""
The search for the thresholds of a curve in the statistic of a detector.

Where a declaration acts on the memory of the detector (``feedback``), the statistic itself
depends on the threshold t, and the threshold for p solves ``Q(p; t) = t``.  The detector is then
simulated with several thresholds on the same random numbers, between which Q is interpolated
linearly.  Thresholds are added where Q differs by more than 0.1 nat between neighbours.
"""

from __future__ import annotations

from dataclasses import replace

from lowsnr_detect.calibration.curve import log_odds
from lowsnr_detect.calibration.empty_frames import empty_frame_peaks
from lowsnr_detect.calibration.empty_frames import Progress
from lowsnr_detect.calibration.empty_frames import Simulation
from lowsnr_detect.calibration.tail_quantile import upper_quantile
from lowsnr_detect.calibration.tail_quantile import upper_quantiles
from lowsnr_detect.parts.detector import Detector
import numpy as np
import scipy

# A threshold out of reach of noise, with which the search begins [nat].
_START = 50.0
_TOLERANCE = 0.01
_MOST_ROUNDS = 8
# Change of a quantile between neighbouring thresholds that linear interpolation bridges [nat].
_NEIGHBOURS = 0.1
_MOST_SIMULATIONS = 16
# Thresholds are added for quantiles that the sample shows, of probabilities that are of use.
_LEAST_ALARMS, _MOST_PROB = 10, 0.9
# Half of the 95 % interval of the rate of alarms, relative to it, that is narrow enough.
_PRECISION = 0.15
# 200 draws give the limits of a 95 % interval to a tenth of its width.
_BOOTSTRAPS = 200


class ThresholdSearch:
    """The search for the points of a curve; it keeps the statistic of every simulation."""

    def __init__(
        self, detector: Detector, simulation: Simulation, progress: Progress | None, *,
        early: bool,
    ) -> None:
        self.detector, self.simulation, self.progress = detector, simulation, progress
        # Whether the first simulation ends when it is precise; later ones have as many runs.
        self.early = early
        # (runs, frames) by the threshold of the detector.
        self.peaks: dict[float, np.ndarray] = {}

    def points(
        self, prob: float, odds: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return threshold, interval and measured probability at each of the log odds."""
        probs = scipy.special.expit(odds)
        design, design_peaks = self._design_threshold(prob)
        found = upper_quantiles(design_peaks.ravel(), probs)
        low, high = (bound - found for bound in self._interval(design_peaks, probs))
        threshold = self._reproduced(probs, float(found[-1])) if self.detector.feedback else found
        # The point of the design probability stays as it was found; none is out of order.
        threshold[odds == log_odds(prob)] = design
        threshold = np.where(odds < log_odds(prob), np.maximum(threshold, design), threshold)
        threshold = np.where(odds > log_odds(prob), np.minimum(threshold, design), threshold)
        threshold = np.maximum.accumulate(threshold[::-1])[::-1]
        if self.progress:
            self.progress(1.0)
        return (threshold, np.minimum(threshold + low, threshold),
                np.maximum(threshold + high, threshold), self._measured(threshold))

    def _simulated(self, threshold: float, prob: float | None = None) -> np.ndarray:
        """
        Return the statistic (runs, frames) of the detector with a threshold.

        With a probability, runs beyond those that its quantile needs are left out.
        """
        if threshold not in self.peaks:
            # How many simulations feedback takes is not known: each counts as half of the rest.
            left = 0.5**len(self.peaks)
            part = left / 2.0 if self.detector.feedback else 1.0

            def progress(done: float) -> None:
                if self.progress:
                    self.progress(1.0 - left + done * part)

            self.peaks[threshold] = empty_frame_peaks(
                replace(self.detector, threshold=threshold), self.simulation, progress,
                None if prob is None else lambda peaks: is_precise(peaks, prob))
        return self.peaks[threshold]

    def _design_threshold(self, prob: float) -> tuple[float, np.ndarray]:
        """
        Find the threshold for the design probability, and the statistic that it comes from.

        With feedback it is the quantile of the statistic that it leads to itself: a fixed
        point, found by Aitken's method.
        """
        tried, history = _START, []
        if self.early:
            peaks = self._simulated(tried, prob)
            self.simulation = replace(self.simulation, runs=len(peaks))
        for _ in range(_MOST_ROUNDS):
            peaks = self._simulated(tried)
            found = upper_quantile(peaks.ravel(), prob)
            if not self.detector.feedback or abs(found - tried) <= _TOLERANCE:
                break
            history.append((tried, found))
            tried = found
            if len(history) > 1:
                (before, first), (last, second) = history[-2:]
                slope = np.clip((second - first) / (last - before), -1.0, 0.9)
                tried = float(last + (found - last) / (1.0 - slope))
        return found, peaks

    def _reproduced(self, probs: np.ndarray, lowest: float) -> np.ndarray:
        """Return the thresholds that solve ``Q(p; t) = t``; none is expected below ``lowest``."""
        alarms = probs * self.simulation.runs * self.simulation.frames
        counted = (alarms >= _LEAST_ALARMS) & (probs <= _MOST_PROB)
        self._simulated(lowest)
        while True:
            tried = np.array(sorted(self.peaks))
            quantiles = np.stack([
                upper_quantiles(self.peaks[each].ravel(), probs) for each in tried.tolist()])
            solved = _solved(tried, quantiles)
            between = np.searchsorted(tried, solved).clip(1, len(tried) - 1)
            change = abs(np.diff(quantiles, axis=0))[between - 1, np.arange(len(probs))]
            change = np.where(counted, change, 0.0)
            # The middle of the interval with the largest change splits it.
            widest = counted & (between == between[change.argmax()])
            wanted = float(np.median(solved[widest])) if widest.any() else lowest
            if (change.max() <= _NEIGHBOURS or wanted in self.peaks
                    or len(self.peaks) >= _MOST_SIMULATIONS):
                return solved
            self._simulated(wanted)

    def _interval(
        self, peaks: np.ndarray, probs: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the 95 % interval of every quantile, by bootstrap over whole runs."""
        # Whole runs are drawn, because the frames of a run depend on each other.
        rng = np.random.default_rng(self.simulation.seed)
        draws = rng.integers(len(peaks), size=(_BOOTSTRAPS, len(peaks)))
        found = [upper_quantiles(peaks[draw].ravel(), probs) for draw in draws]
        low, high = np.quantile(found, (0.025, 0.975), axis=0)
        return low, high

    def _measured(self, threshold: np.ndarray) -> np.ndarray:
        """Return the fraction of frames above each threshold, where it was simulated nearest."""
        tried = np.array(list(self.peaks))
        nearest = abs(threshold[:, None] - tried).argmin(axis=1)
        return np.array([
            np.mean(self.peaks[float(tried[n])] > each) for n, each in zip(nearest, threshold)])


def is_precise(peaks: np.ndarray, prob: float) -> bool:
    """Return whether runs (n, frames) show the rate of alarms at a quantile precisely."""
    # Runs are independent, their frames are not.
    alarms = np.count_nonzero(peaks > upper_quantile(peaks.ravel(), prob), axis=1)
    error = 1.96 * np.std(alarms) / np.sqrt(len(alarms))
    # Without an alarm, at a quantile beyond the sample, there is no spread to know the error by.
    return bool(alarms.any() and error <= _PRECISION * prob * peaks.shape[1])


def _solved(tried: np.ndarray, quantiles: np.ndarray) -> np.ndarray:
    """
    Return where each interpolated quantile Q(p; t) equals t.

    Parameters
    ----------
    tried : (n,) ndarray
        Thresholds t that were simulated, ascending [nat].
    quantiles : (n, P) ndarray
        Q of each probability at these [nat].

    Returns
    -------
    (P,) ndarray
        The thresholds; beyond those that were simulated the quantile of the nearest.

    """
    gap = quantiles - tried[:, None]
    column = np.arange(quantiles.shape[1])
    after = np.where((gap <= 0.0).any(axis=0), (gap <= 0.0).argmax(axis=0), len(tried) - 1)
    before = np.maximum(after - 1, 0)
    above, below = gap[before, column], gap[after, column]
    crossed = (above > 0.0) & (below <= 0.0)
    weight = np.divide(above, above - below, out=np.zeros_like(above), where=crossed)
    inside = (1.0 - weight) * quantiles[before, column] + weight * quantiles[after, column]
    return np.where(crossed, inside, quantiles[after, column])
