"""
The test statistic in empty frames, and the threshold that gives a share of false alarms.

Empty frames are simulated as they are scored: runs of a stated number of frames from a fresh
start.  The threshold is the matching quantile of the statistic.  Where a declaration acts on
the detector's memory (``feedback``) the statistic itself depends on the threshold, and the one
sought reproduces itself: a fixed point, found on the same random numbers throughout.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import replace
import math
from typing import Any

from lowsnr_common.core.streams import stream
from lowsnr_detect.calibration.tail_quantile import upper_quantile
import numpy as np

_BATCH_CELLS = 8_000
_START = 50.0
_MOST_ROUNDS = 8
_TOLERANCE = 0.01
_BOOTSTRAPS = 200

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Simulation:
    """
    What is simulated.

    Parameters
    ----------
    runs, frames
        Runs, and frames in each.
    shape
        Rows and columns of a frame.
    seed
        Root seed of noise and detector.

    """

    runs: int
    frames: int
    shape: tuple[int, int]
    seed: int


def empty_frame_peaks(
    detector: Any, simulation: Simulation, progress: Progress | None = None,
) -> np.ndarray:
    """
    Run a detector on frames of noise and return its largest statistic in each.

    Parameters
    ----------
    detector
        Detector, with the threshold it is to run with.
    simulation
        What is simulated.
    progress
        Called after every frame with the share that is done, in (0, 1].

    Returns
    -------
    (runs, frames) ndarray
        ``Declarations.peak``: above the threshold where something was declared [nat].

    """
    runs, frames, cells = simulation.runs, simulation.frames, math.prod(simulation.shape)
    batch = max(1, _BATCH_CELLS // cells)
    peaks = np.empty((runs, frames))
    for number, first in enumerate(range(0, runs, batch)):
        noise, own = stream(simulation.seed, 'calibration', number).spawn(2)
        part = peaks[first:first + batch]
        shape = (len(part), *simulation.shape)
        memory = detector.init(shape)
        for k in range(frames):
            frame = detector.sensor.noise_std * noise.standard_normal(shape)
            memory, declared = detector.step(memory, frame, own)
            part[:, k] = declared.peak
            if progress:
                progress((first + len(part) * (k + 1) / frames) / runs)
    return peaks


def find_threshold(
    detector: Any, prob: float, simulation: Simulation, progress: Progress | None = None,
) -> tuple[float, tuple[float, float], float]:
    """
    Return the threshold for a share of false alarms, and how sure it is.

    Parameters
    ----------
    detector
        Detector; its own threshold does not matter.
    prob
        Wanted share of the simulated frames with any declaration, in (0, 1).
    simulation
        What is simulated.
    progress
        Called now and then with the share of the work that is done, in [0, 1].

    Returns
    -------
    float
        Threshold [nat].
    tuple of float
        Its 95 % interval, by bootstrap over whole runs [nat].
    float
        Share of the simulated frames that it declares in.

    """
    search = _quantile_reproduced if detector.feedback else _quantile
    threshold, peaks = search(detector, prob, simulation, progress or (lambda done: None))
    interval = _interval(peaks, prob, threshold, simulation.seed)
    return threshold, interval, float(np.mean(peaks > threshold))


def _quantile(
    detector: Any, prob: float, simulation: Simulation, progress: Progress,
) -> tuple[float, np.ndarray]:
    peaks = empty_frame_peaks(detector, simulation, progress)
    return upper_quantile(peaks.ravel(), prob), peaks


def _quantile_reproduced(
    detector: Any, prob: float, simulation: Simulation, progress: Progress,
) -> tuple[float, np.ndarray]:
    """Find the threshold that is the quantile of the peaks it leads to (Aitken's method)."""
    tried, history = _START, []
    for number in range(_MOST_ROUNDS):
        found, peaks = _quantile(
            replace(detector, threshold=tried), prob, simulation, _round(progress, number))
        if abs(found - tried) <= _TOLERANCE:
            break
        history.append((tried, found))
        tried = found
        if len(history) > 1:
            (before, first), (last, second) = history[-2:]
            slope = np.clip((second - first) / (last - before), -1.0, 0.9)
            tried = float(last + (found - last) / (1.0 - slope))
    progress(1.0)
    return found, peaks


def _round(progress: Progress, number: int) -> Progress:
    """Return the progress of one round; how many there will be is not known."""
    left = 0.5**number
    return lambda share: progress(1.0 - left + share * left / 2.0)


def _interval(
    peaks: np.ndarray, prob: float, threshold: float, seed: int,
) -> tuple[float, float]:
    # Whole runs are drawn, because the frames of a run depend on each other.
    rng = np.random.default_rng(seed)
    draws = rng.integers(len(peaks), size=(_BOOTSTRAPS, len(peaks)))
    found = [upper_quantile(peaks[draw].ravel(), prob) for draw in draws]
    low, high = np.quantile(found, (0.025, 0.975))
    return min(float(low), threshold), max(float(high), threshold)
