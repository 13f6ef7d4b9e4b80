# SPDX-License-Identifier: Apache-2.0
"""
A chain over a batch of runs, without ROS: frames to declarations to tracks.

Every run draws from random streams of its own, so that a batch of runs declares what each run
declares alone.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import replace
from typing import Any
from typing import cast

from lowsnr_common.core.records import Estimate
from lowsnr_common.core.streams import standard_normal
from lowsnr_common.core.streams import stream
from lowsnr_detect.grid.fixed_lag import answers
from lowsnr_detect.parts.detector import Declarations
from lowsnr_detect.parts.detector import Detector
from lowsnr_track.pda_mmpf import PdaMmpf
import numpy as np


@dataclass(frozen=True)
class Chain:
    """
    A detector at an operating point, with the tracker that follows it.

    Parameters
    ----------
    label
        Name of the method in the results.
    point
        Name of the operating point.
    detector
        Detector with the thresholds of that point.
    tracker
        Tracker; None for detections only.
    runs
        The chain takes part in this many runs of a study, the first ones.

    """

    label: str
    point: str
    detector: Detector
    tracker: PdaMmpf | None
    runs: int


class RunStreams:
    """
    The generators of many runs as one; the first axis of an array that it draws is the run.

    It has those methods of :class:`numpy.random.Generator` that detectors use.  Run r gets
    what its own generator gives for the shape without the first axis.
    """

    def __init__(self, generators: Sequence[np.random.Generator]) -> None:
        self._generators = tuple(generators)

    def random(self, size: Sequence[int]) -> np.ndarray:
        """Draw uniform numbers in [0, 1), (runs, ...)."""
        return self._draw(lambda own, shape: own.random(shape), size)

    def standard_normal(self, size: Sequence[int]) -> np.ndarray:
        """Draw normal numbers of mean 0 and variance 1, (runs, ...)."""
        return self._draw(lambda own, shape: standard_normal(shape, own), size)

    def uniform(self, low: Any, high: Any, size: Sequence[int]) -> np.ndarray:
        """Draw uniform numbers between bounds that are the same for every run, (runs, ...)."""
        return self._draw(lambda own, shape: own.uniform(low, high, shape), size)

    def integers(self, high: int, size: Sequence[int]) -> np.ndarray:
        """Draw integers from 0 to below ``high``, (runs, ...)."""
        return self._draw(lambda own, shape: own.integers(high, size=shape), size)

    def _draw(
        self, draw: Callable[[np.random.Generator, tuple[int, ...]], np.ndarray],
        size: Sequence[int],
    ) -> np.ndarray:
        runs, *shape = size
        if runs != len(self._generators):
            raise ValueError(f'size {tuple(size)} must start with {len(self._generators)} runs')
        return np.stack([draw(own, tuple(shape)) for own in self._generators])


def detect(
    detectors: Sequence[Detector], frames: np.ndarray, seed: int, first_run: int,
) -> list[list[Declarations]]:
    """
    Run detectors that differ in their threshold alone.

    A detector whose statistic is the posterior of the one object (neither ``feedback`` nor
    ``local``) runs once, with the lowest threshold: what the others declare is part of that.

    Parameters
    ----------
    detectors
        The same detector with one or more thresholds.
    frames : (runs, K, rows, cols) ndarray
        Frames.
    seed, first_run
        Root seed, and the number of the first run.

    Returns
    -------
    list of list of Declarations
        For each detector those of every frame, with leading axis (runs,).

    """
    lowest = min(detectors, key=lambda detector: detector.threshold)
    if not _shares_statistic(lowest):
        return [_detect(detector, frames, seed, first_run) for detector in detectors]
    all_of = _detect(lowest, frames, seed, first_run)
    return [[_above(answer, detector.threshold) for answer in all_of] for detector in detectors]


def group_by_statistic(chains: Sequence[Chain]) -> list[list[Chain]]:
    """Group the chains whose detectors one call of :func:`detect` runs."""
    groups: dict[Any, list[Chain]] = {}
    for number, chain in enumerate(chains):
        key = (chain.label, replace(chain.detector, threshold=0.0), chain.runs)
        groups.setdefault(
            key if _shares_statistic(chain.detector) else number, []).append(chain)
    return list(groups.values())


def track(
    tracker: PdaMmpf, detections: Sequence[Sequence[Estimate]], period_s: float,
    rng: np.random.Generator,
) -> list[list[Estimate]]:
    """
    Run the tracker on the detections of one run.

    Parameters
    ----------
    tracker
        Tracker.
    detections
        Those of frame k at index k - 1.
    period_s
        Time from a frame to the next [s].
    rng
        Source of randomness.

    Returns
    -------
    list of list of Estimate
        Confirmed tracks of every frame.

    """
    memory, confirmed = tracker.init(), []
    for k, found in enumerate(detections, start=1):
        memory, output = tracker.step(memory, found, k * period_s, rng)
        confirmed.append(output.confirmed)
    return confirmed


def padded(tracks: Sequence[Sequence[Sequence[Estimate]]], frames: int) -> np.ndarray:
    """Return the states of all tracks, (runs, frames, most tracks, 4), NaN where none."""
    most = max((len(found) for run in tracks for found in run), default=0)
    states = np.full((len(tracks), frames, most, 4), np.nan)
    for r, run in enumerate(tracks):
        for k, found in enumerate(run):
            for n, item in enumerate(found):
                states[r, k, n] = item.state
    return states


def _shares_statistic(detector: Detector) -> bool:
    """Return whether one run of a detector serves all thresholds, scores included."""
    return not (detector.feedback or detector.local)


def _detect(
    detector: Detector, frames: np.ndarray, seed: int, first_run: int,
) -> list[Declarations]:
    streams = [stream(seed, 'detector', first_run + run) for run in range(len(frames))]
    rng = cast(np.random.Generator, RunStreams(streams))
    return list(answers(detector, frames.swapaxes(0, 1), rng))


def _above(declared: Declarations, threshold: float) -> Declarations:
    found = declared.peak > threshold
    return Declarations(
        declared.peak, np.where(found[:, None], declared.score, 0.0),
        np.where(found[:, None, None], declared.state, np.nan),
        np.where(found[:, None, None, None], declared.cov, np.nan), declared.predicted)
