# SPDX-License-Identifier: Apache-2.0
"""
The existence of false tracks: detector and tracker on simulated frames of noise.

Frames are simulated in runs of 200, each from a fresh start, until a hundred false tracks at the
asked rate are expected or the effort is spent.  The effort is counted in nominal seconds, because
a measured time would make the result differ between computers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import math
from typing import Any

from lowsnr_common.core.records import Estimate
from lowsnr_common.core.streams import stream
from lowsnr_detect.calibration.curve import log_odds
from lowsnr_detect.calibration.effort import frame_s
from lowsnr_detect.calibration.empty_frames import Progress
from lowsnr_detect.grid.fixed_lag import answers
from lowsnr_detect.parts.detector import Declarations
from lowsnr_track.pda_mmpf import PdaMmpf
from lowsnr_track.tracks import TrackerState
import numpy as np

RUN_FRAMES = 200
# The noise is other than that which the threshold of the detector was calibrated on.
FIRST_STREAM = 1_000_000
# Cells that are stepped together, runs without which no interval can be stated, and false tracks
# that show the rate to 20 % (95 % interval).
_BATCH_CELLS, _LEAST_RUNS, _ENOUGH = 8_000, 20, 100
# Nominal seconds of a simulation, of a frame with tracks, and of a particle in it.
_EFFORT_S, _BUSY_S, _PARTICLE_S = 15.0, 1e-3, 2e-7


def simulate(
    detector: Any, tracker: PdaMmpf, shape: tuple[int, int], rate: float, seed: int,
    progress: Progress | None = None,
) -> list[np.ndarray]:
    """Return the largest log odds of existence of every track, for each run of empty frames."""
    batch = max(1, _BATCH_CELLS // math.prod(shape))
    plain = getattr(detector, 'detector', detector)
    frames_s = batch * RUN_FRAMES * frame_s(plain, shape)
    runs: list[np.ndarray] = []
    spent, number = 0.0, FIRST_STREAM
    while (done := max(spent / _EFFORT_S, len(runs) * RUN_FRAMES * rate / _ENOUGH)) < 1.0 or (
            len(runs) < _LEAST_RUNS):
        noise, own, follow = stream(seed, 'calibration', number).spawn(3)
        drawn = (plain.sensor.draw_noise((batch, *shape), noise) for _ in range(RUN_FRAMES))
        declared = list(answers(detector, drawn, own))
        for run in range(batch):
            peaks, busy = largest_log_odds(
                tracker, [of_run(each, run) for each in declared], follow)
            runs.append(peaks)
            spent += busy
        spent, number = spent + frames_s, number + 1
        if progress:
            progress(min(done, 1.0))
    return runs


def largest_log_odds(
    tracker: PdaMmpf, detections: Sequence[Sequence[Estimate]], rng: np.random.Generator,
) -> tuple[np.ndarray, float]:
    """Return the largest log odds of existence of every track, and the nominal seconds."""
    state, largest, spent = tracker.init(), dict[str, float](), 0.0
    for k, found in enumerate(detections, start=1):
        if not found and not len(state.tracks):
            state = idle(tracker, state, float(k))
            continue
        state, output = tracker.step(state, found, float(k), rng)
        for item in (*output.confirmed, *output.tentative):
            largest[item.id] = max(item.score, largest.get(item.id, 0.0))
        spent += _BUSY_S + _PARTICLE_S * tracker.particles * len(state.tracks)
    return np.array([log_odds(prob) for prob in largest.values()]), spent


def idle(tracker: PdaMmpf, state: TrackerState, stamp_s: float) -> TrackerState:
    """Return what ``tracker.step`` does of a frame without tracks and detections, but faster."""
    density = tracker.detection.estimated_clutter(
        state.clutter_density, 0.0, tracker.rows * tracker.cols, state.frames)
    return replace(
        state, stamp_s=stamp_s, frames=state.frames + 1, clutter_density=density,
        first_s=stamp_s if state.first_s is None else state.first_s)


def of_run(declared: Declarations, run: int) -> list[Estimate]:
    """Return the declarations of one run of a batch."""
    if not np.any(declared.score[run] > 0.0):
        return []
    return replace(
        declared, peak=declared.peak[run], score=declared.score[run], state=declared.state[run],
        cov=declared.cov[run],
        predicted=None if declared.predicted is None else declared.predicted[run]).estimates()
