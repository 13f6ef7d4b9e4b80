# SPDX-License-Identifier: Apache-2.0
"""The test statistic of a detector in simulated frames of noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import replace
from itertools import islice
import math

from lowsnr_common.core.streams import stream
from lowsnr_detect.grid.fixed_lag import answers
from lowsnr_detect.grid.fixed_lag import lag_of
from lowsnr_detect.parts.detector import Detector
import numpy as np

# Cells that are stepped together: their planes stay in the cache of a processor (64 KiB each).
_BATCH_CELLS = 8_000
# Runs after which it is first asked whether they are enough, and the factor of the next time.
_FIRST_LOOK, _NEXT_LOOK = 100, 1.2

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
    enough: Callable[[np.ndarray], bool] | None = None,
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
    enough
        Called now and then with the statistic of the runs that are done, (n, frames); the
        simulation ends when it returns true.

    Returns
    -------
    (runs, frames) ndarray
        ``Declarations.peak``: above the threshold where something was declared [nat].  Of no
        more runs than were enough.

    """
    if hasattr(detector, 'max_detections'):  # only the largest statistic is looked at
        detector = replace(detector, max_detections=1)
    runs, frames, cells = simulation.runs, simulation.frames, math.prod(simulation.shape)
    batch = max(1, _BATCH_CELLS // cells)
    peaks, looked = np.empty((runs, frames)), _FIRST_LOOK
    for number, first in enumerate(range(0, runs, batch)):
        noise, own = stream(simulation.seed, 'calibration', number).spawn(2)
        part = peaks[first:first + batch]
        shape = (len(part), *simulation.shape)
        # An answer that is late rests on later frames: the last ones get theirs too.
        drawn = (detector.sensor.draw_noise(shape, noise)
                 for _ in range(frames + lag_of(detector)))
        for k, declared in enumerate(islice(answers(detector, drawn, own), frames)):
            part[:, k] = declared.peak
            if progress:
                progress((first + len(part) * (k + 1) / frames) / runs)
        done = first + len(part)
        if enough and done >= looked:
            if enough(peaks[:done]):
                return peaks[:done]
            looked = math.ceil(_NEXT_LOOK * done)
    return peaks
