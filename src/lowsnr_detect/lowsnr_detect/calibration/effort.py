# SPDX-License-Identifier: Apache-2.0
"""
How much a calibration simulates: which part of a frame, and how many runs.

The effort is counted in nominal seconds of one core, from the numbers of cells, states and
particles alone, because a measured time would make the threshold differ between computers.
"""

from __future__ import annotations

import math

from lowsnr_detect.grid.fixed_lag import FixedLag
from lowsnr_detect.parts.detector import Detector

# Largest part of a frame that is simulated; at 64 x 64 cells edges hold 6 % of the cells.
_MOST_CELLS = 64 * 64
# The same of a posterior on a grid of states.
_MOST_POSTERIOR_CELLS = 32 * 32
# Runs that show the design probability to 5 % if alarms are independent (400 of them).
FULL_RUNS = 1000
# Nominal seconds for frames of at most so many cells, and for larger ones.
_SMALL_CELLS, _SMALL_S, _LARGE_S = 20 * 20, 9.0, 20.0
# Simulations that the search for a threshold with feedback takes.
_FEEDBACK_ROUNDS = 3
# Nominal seconds of a cell, of a state of a cell, and of a particle in a frame.
_CELL_S, _STATE_S, _PARTICLE_S = 1.5e-7, 1.2e-8, 1.5e-7
# Runs without which no interval can be stated, and those without which a posterior is simulated
# in a part of the frame.
_LEAST_RUNS, _FEW_RUNS = 40, 400


def simulated_part(
    detector: Detector, shape: tuple[int, int], frames: int,
) -> tuple[int, int]:
    """Return the part (rows, cols) of a frame that is simulated in runs of so many frames."""
    if detector.local:
        return _part(shape, _MOST_CELLS)
    if isinstance(detector, FixedLag) and _affordable_runs(detector, shape, frames) < _FEW_RUNS:
        return _part(shape, _MOST_POSTERIOR_CELLS)
    return shape


def most_runs(detector: Detector, part: tuple[int, int], frames: int) -> int:
    """Return the number of runs that a simulation of a part takes at most."""
    return max(_LEAST_RUNS, min(FULL_RUNS, _affordable_runs(detector, part, frames)))


def frame_s(detector: Detector, shape: tuple[int, int]) -> float:
    """Return the nominal seconds that a frame takes a detector."""
    cell_s = _CELL_S
    if isinstance(detector, FixedLag):
        cell_s += _STATE_S * detector.state_planes * (detector.lag + 1)
    particles = getattr(detector, 'particles', 0) + getattr(detector, 'birth_particles', 0)
    return cell_s * math.prod(shape) + _PARTICLE_S * particles


def _affordable_runs(detector: Detector, shape: tuple[int, int], frames: int) -> int:
    seconds = _SMALL_S if math.prod(shape) <= _SMALL_CELLS else _LARGE_S
    rounds = _FEEDBACK_ROUNDS if detector.feedback else 1
    return int(seconds / (rounds * frames * frame_s(detector, shape)))


def _part(shape: tuple[int, int], most: int) -> tuple[int, int]:
    """Return a part of a frame of at most so many cells, as square as possible."""
    rows, cols = shape
    if rows * cols <= most:
        return shape
    short = min(rows, cols, math.isqrt(most))
    long = most // short
    return (short, long) if rows <= cols else (long, short)
