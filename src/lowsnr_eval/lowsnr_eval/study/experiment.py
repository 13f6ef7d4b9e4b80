# SPDX-License-Identifier: Apache-2.0
"""
Monte Carlo experiments: runs of a scenario through detectors and trackers, without ROS.

All chains of a block get the same frames, so that they compare in pairs.  Every run has its
own random streams: run 0 is the run that the node graph makes with the same seed, and the
results do not depend on how runs are divided into blocks and processes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import pickle
import time

from lowsnr_bringup.plan.empty_tracks import of_run
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.streams import stream
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_detect.parts.detector import Declarations
from lowsnr_eval.study.offline_chain import Chain
from lowsnr_eval.study.offline_chain import detect
from lowsnr_eval.study.offline_chain import group_by_statistic
from lowsnr_eval.study.offline_chain import padded
from lowsnr_eval.study.offline_chain import track
from lowsnr_eval.study.run_scores import RunScores
from lowsnr_eval.study.run_scores import score_runs
from lowsnr_sensor.scenario import Scenario
from lowsnr_sensor.simulator import fluctuating
from lowsnr_sensor.simulator import simulate_frames
from lowsnr_track.pda_mmpf import PdaMmpf
import numpy as np

# The tracker follows a chain that declares more than this in a frame in a few runs only:
# dozens of tracks on noise cost a hundred times one track, and a few runs show them well enough.
CROWDED = 5.0
# Tracks of a run and the time they took [s], by tracker, run and detections.  Chains whose
# detections in a run are equal, often because there are none, share them.
_Tracked = dict[tuple[PdaMmpf, int, bytes], tuple[list[list[Estimate]], float]]


@dataclass(frozen=True)
class Block:
    """
    Some runs of a study, one task: the runs ``first`` to below ``first + count``.

    Parameters
    ----------
    scenario
        At most one object at a time.
    sensor
        The sensor that makes the frames.
    evaluation
        Gate and cutoff.
    chains
        The chains that get the frames.
    seed
        Root seed of the study.
    first, count
        The first run, and the number of runs.
    crowded_runs
        The tracker follows chains that declare dozens of objects in this many runs only, the
        first ones of the study.

    """

    scenario: Scenario
    sensor: SensorModel
    evaluation: Evaluation
    chains: tuple[Chain, ...]
    seed: int
    first: int
    count: int
    crowded_runs: int


@dataclass(frozen=True)
class ChainResult:
    """
    The scores of a chain in the runs of a block.

    ``tracking`` is None without a tracker.  ``detector_s`` and ``tracker_s`` are CPU times of
    one frame of one run [s]; the detector works on all runs of the block at once.
    """

    detection: RunScores
    tracking: RunScores | None
    detector_s: float
    tracker_s: float


# By label and operating point.
BlockResults = dict[tuple[str, str], ChainResult]


def run_block(block: Block) -> BlockResults:
    """
    Run all chains of a block that take part in its runs.

    Raises
    ------
    ValueError
        If the scenario has more than one object at a time.

    """
    runs = range(block.first, block.first + block.count)
    truth, frames = map(np.stack, zip(*(
        simulate_run(block.scenario, block.sensor, block.seed, run) for run in runs)))
    results = {}
    tracked: _Tracked = {}
    for chains in group_by_statistic(block.chains):
        count = min(block.count, chains[0].runs - block.first)
        if count < 1:
            continue
        start = time.process_time()
        answers = detect(
            [chain.detector for chain in chains], frames[:count], block.seed, block.first)
        spent_s = (time.process_time() - start) / (count * frames.shape[1])
        for chain, answer in zip(chains, answers):
            results[chain.label, chain.point] = _score(
                block, chain, truth, answer, spent_s, tracked)
    return results


def simulate_run(
    scenario: Scenario, sensor: SensorModel, seed: int, run: int,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Simulate one run.

    Returns
    -------
    (K, 4) ndarray
        State of the object [m, m/s], NaN in frames without one.
    (K, rows, cols) ndarray
        Frames.

    Raises
    ------
    ValueError
        If there is more than one object at a time.

    """
    drawn = stream(seed, 'truth', run)
    objects = fluctuating(
        scenario.truth(sensor.frame_period_s, sensor.cell_size_m, drawn), sensor, drawn)
    truth = np.full((len(objects), 4), np.nan)
    for k, present in enumerate(objects):
        if len(present) > 1:
            raise ValueError(f'frame {k + 1} has {len(present)} objects, must have at most one')
        if present:
            truth[k] = present[0].state
    frames = simulate_frames(objects, sensor, scenario.shape, stream(seed, 'noise', run))
    return truth, frames.astype(float)


def _score(
    block: Block, chain: Chain, truth: np.ndarray, answers: Sequence[Declarations],
    detector_s: float, tracked: _Tracked,
) -> ChainResult:
    states = np.stack([declared.state for declared in answers], axis=1)
    detection = score_runs(truth[:len(states)], states, block.evaluation)
    if chain.tracker is None:
        return ChainResult(detection, None, detector_s, 0.0)
    runs = len(states)
    if detection.declared.mean() > CROWDED:
        runs = max(0, min(runs, block.crowded_runs - block.first))
    tracks, times_s = [], [0.0]
    for run in range(runs):
        detections = [of_run(declared, run) for declared in answers]
        found, spent_s = _track(block, chain.tracker, block.first + run, detections, tracked)
        tracks.append(found)
        times_s.append(spent_s)
    tracking = score_runs(truth[:runs], padded(tracks, len(answers)), block.evaluation)
    return ChainResult(
        detection, tracking, detector_s, sum(times_s) / max(1, runs * len(answers)))


def _track(
    block: Block, tracker: PdaMmpf, run: int, detections: list[list[Estimate]],
    tracked: _Tracked,
) -> tuple[list[list[Estimate]], float]:
    key = tracker, run, pickle.dumps(detections)
    if key not in tracked:
        start = time.process_time()
        tracks = track(
            tracker, detections, block.sensor.frame_period_s, stream(block.seed, 'tracker', run))
        tracked[key] = tracks, time.process_time() - start
    return tracked[key]
