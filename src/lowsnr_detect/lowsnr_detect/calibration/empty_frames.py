"""The test statistic of a detector in simulated frames of noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math

from lowsnr_common.core.streams import stream
from lowsnr_detect.parts.detector import Detector
import numpy as np

# Cells that are stepped together: their planes stay in the cache of a processor (64 KiB each).
_BATCH_CELLS = 8_000

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Simulation:
    """
    Size and seed of a simulation.

    Parameters
    ----------
    runs, frames
        Independent runs, each from a fresh start, and frames in each.
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
    detector: Detector, simulation: Simulation, progress: Progress | None = None,
) -> np.ndarray:
    """
    Run a detector on frames of noise and return its largest statistic in each.

    Parameters
    ----------
    detector
        Detector, with the threshold it is to run with.
    simulation
        Size and seed.
    progress
        Called after every frame with the fraction that is done, in (0, 1].

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
