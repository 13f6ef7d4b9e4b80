# SPDX-License-Identifier: Apache-2.0
"""Many objects in a large frame: simulate their detections, track them, and count errors."""

from collections.abc import Iterator
from dataclasses import dataclass
from dataclasses import replace
import time

from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_common.core.records import Estimate
from lowsnr_detect.detectors.sdt import SDT
from lowsnr_detect.parts.cell_detector import resolution_of
from lowsnr_track.pda_mmpf import PdaMmpf
from lowsnr_track.tracks import TrackerOutput
import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from track.scenes import observed

GATE_M = 1.5


@dataclass(frozen=True)
class Figures:
    """What a run gives: times of its frames [s], and counts over its scored frames."""

    seconds: np.ndarray
    tracks: np.ndarray  # kept in a frame, tentative ones included
    hit: float  # frames of objects with a track of their own within GATE_M
    false: float  # confirmed tracks a frame that are of no object
    changes: float  # changes of the id at an object, for each object and 100 frames
    rmse: float  # of the position of hit objects [m]


def scene(
    objects: int, side: int, false: float, frames: int, motion: MotionModes,
    rng: np.random.Generator,
) -> Iterator[tuple[np.ndarray, list[Estimate]]]:
    """Yield positions (objects, 2) and detections of each frame; objects turn back at the edge."""
    state, modes = np.empty((objects, 4)), rng.integers(motion.count, size=objects)
    state[:, POS] = rng.uniform(0.0, side - 1.0, (objects, 2))
    state[:, VEL] = motion.draw_velocity((objects,), rng)
    for _ in range(frames):
        modes = motion.switch(modes, 1.0, rng)
        state = motion.move(state, modes, 1.0, rng)
        beyond = (state[:, POS] < 0.0) | (state[:, POS] > side - 1.0)
        state[:, VEL] *= np.where(beyond, -1.0, 1.0)
        state[:, POS] = np.clip(state[:, POS], 0.0, side - 1.0)
        yield state[:, POS].copy(), observed(state[:, POS], (side, side), rng, false)


def measure(
    tracker: PdaMmpf, objects: int, false: float, frames: int, settled: int, seed: int,
) -> Figures:
    """Track a scene; time and score the frames after the first ``settled``."""
    rng, state = np.random.default_rng([seed, 1]), tracker.init()
    scenes = scene(
        objects, tracker.rows, false, frames, tracker.motion, np.random.default_rng([seed, 0]))
    frames_of: list[tuple[float, int, np.ndarray, int, np.ndarray]] = []
    for k, (truth, detections) in enumerate(scenes):
        start = time.thread_time()
        state, output = tracker.step(state, detections, float(k), rng)
        seconds = time.thread_time() - start
        ids, error = matched(truth, output)
        false_tracks = len(output.confirmed) - int(np.sum(ids >= 0))
        frames_of.append((seconds, len(state.tracks), ids, false_tracks, error))
    times, tracks, matches, false_counts, errors = (
        np.array(part) for part in zip(*frames_of[settled:]))
    return Figures(
        times, tracks, float(np.mean(matches >= 0)), float(np.mean(false_counts)),
        100.0 * id_changes(matches) / matches.size, float(np.sqrt(np.nanmean(errors**2))))


def matched(truth: np.ndarray, output: TrackerOutput) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the confirmed track that the best assignment gives each object.

    Returns
    -------
    (objects,) ndarray of int
        Id of the track; -1 for none within GATE_M.
    (objects,) ndarray
        Error of its position [m]; NaN for none.

    """
    found, error = np.full(len(truth), -1), np.full(len(truth), np.nan)
    if output.confirmed:
        away = cdist(truth, [item.state[POS] for item in output.confirmed])
        rows, cols = linear_sum_assignment(np.minimum(away, GATE_M))
        near = away[rows, cols] < GATE_M
        found[rows[near]] = [int(output.confirmed[n].id) for n in cols[near]]
        error[rows[near]] = away[rows, cols][near]
    return found, error


def id_changes(ids: np.ndarray) -> int:
    """Count the frames (K, objects) in which an object has another id than it had last."""
    changes = 0
    for of_object in ids.T:
        known = of_object[of_object >= 0]
        changes += int(np.sum(known[1:] != known[:-1]))
    return changes


def sized(tracker: PdaMmpf, side: int, particles: int, objects: int) -> PdaMmpf:
    """Return the tracker behind SDT for a frame of ``side`` squared with so many objects."""
    return replace(
        tracker, rows=side, cols=side, particles=particles,
        detection=replace(tracker.detection, resolution=resolution_of(SDT())),
        life=replace(tracker.life, max_tracks=4 * objects + 100))
