"""A chain, from frames to declarations to tracks, over a batch of runs and without ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import replace
from typing import Any

from lowsnr_common.core.records import Estimate
from lowsnr_common.core.streams import stream
from lowsnr_detect.parts.detector import Declarations
from lowsnr_eval.study.run_streams import RunStreams
from lowsnr_track.pda_mmpf import PdaMmpf
import numpy as np


@dataclass(frozen=True)
class Chain:
    """
    A detector at an operating point, with the tracker that follows it.

    Parameters
    ----------
    label
        What it is called in the results.
    point
        Name of the operating point.
    detector
        Detector with the thresholds of that point.
    tracker
        Tracker; None for detections only.
    runs
        It takes part in the first so many runs of a study.

    """

    label: str
    point: str
    detector: Any
    tracker: PdaMmpf | None
    runs: int


def detect(
    detectors: Sequence[Any], frames: np.ndarray, seed: int, first_run: int,
) -> list[list[Declarations]]:
    """
    Run detectors that differ in their threshold alone.

    A detector whose statistic is the posterior of the one object (neither ``feedback`` nor
    ``local``) is run once, with the lowest threshold: the others declare a part of that.

    Parameters
    ----------
    detectors
        The same detector with one or more thresholds.
    frames : (runs, K, rows, cols) ndarray
        Frames.
    seed, first_run
        What the random streams follow from.

    Returns
    -------
    list of list of Declarations
        For each detector those of every frame, with leading axis (runs,).

    """
    lowest = min(detectors, key=lambda detector: detector.threshold)
    if not _shares_statistic(lowest):
        return [_detect(detector, frames, seed, first_run) for detector in detectors]
    answers = _detect(lowest, frames, seed, first_run)
    return [[_above(answer, detector.threshold) for answer in answers] for detector in detectors]


def sharing(chains: Sequence[Chain]) -> list[list[Chain]]:
    """Group the chains that one call of :func:`detect` serves."""
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
    memory, answers = tracker.init(), []
    for k, found in enumerate(detections, start=1):
        memory, output = tracker.step(memory, found, k * period_s, rng)
        answers.append(output.confirmed)
    return answers


def of_run(declared: Declarations, run: int) -> list[Estimate]:
    """Return the declarations of one run of a batch."""
    return Declarations(
        declared.peak[run], declared.score[run], declared.state[run], declared.cov[run],
    ).estimates()


def padded(tracks: Sequence[Sequence[Sequence[Estimate]]], frames: int) -> np.ndarray:
    """Return the states of all tracks, (runs, frames, most tracks, 4), NaN where none."""
    most = max((len(found) for run in tracks for found in run), default=0)
    states = np.full((len(tracks), frames, most, 4), np.nan)
    for r, run in enumerate(tracks):
        for k, found in enumerate(run):
            for n, item in enumerate(found):
                states[r, k, n] = item.state
    return states


def _shares_statistic(detector: Any) -> bool:
    """Return whether one run of a detector serves all thresholds, scores included."""
    return not (detector.feedback or detector.local)


def _detect(
    detector: Any, frames: np.ndarray, seed: int, first_run: int,
) -> list[Declarations]:
    rng = RunStreams([stream(seed, 'detector', first_run + run) for run in range(len(frames))])
    memory, answers = detector.init(frames[:, 0].shape), []
    for k in range(frames.shape[1]):
        memory, declared = detector.step(memory, frames[:, k], rng)
        answers.append(declared)
    return answers


def _above(declared: Declarations, threshold: float) -> Declarations:
    found = declared.peak > threshold
    return Declarations(
        declared.peak, np.where(found[:, None], declared.score, 0.0),
        np.where(found[:, None, None], declared.state, np.nan),
        np.where(found[:, None, None, None], declared.cov, np.nan))
