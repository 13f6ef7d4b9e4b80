# SPDX-License-Identifier: Apache-2.0
"""
The tracker on declarations of SDT, calibrated to a rate of empty frames with a track.

Objects move as in ``config/scenarios/random.yaml``.  The detector has a false alarm in one of ten
empty frames.  ``life.confirm_probability`` is set so that one of a hundred empty frames holds a
confirmed track, and verified on other noise.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from lowsnr_common.core.measurement import SensorModel
from lowsnr_detect.calibration.operating_point import calibrated
from lowsnr_detect.detectors.sdt import SDT
from lowsnr_detect.parts.cell_detector import resolution_of
from lowsnr_eval.study.experiment import simulate_run
from lowsnr_eval.study.offline_chain import detect
from lowsnr_sensor.scenario import load_scenario
from lowsnr_track.detection_model import DetectionModel
from lowsnr_track.pda_mmpf import PdaMmpf
import numpy as np
from scipy.special import expit
from scipy.special import logit
from tracker_scores import interval
from tracker_scores import quantile_interval
from tracker_scores import reliability
from tracker_scores import RunScore
from tracker_scores import score_run

SCENARIO = Path(__file__).resolve().parents[1] / 'config' / 'scenarios' / 'random.yaml'
SCORED = slice(9, 35)  # frames 10 to 35
AFTER = slice(35, 40)
DETECTOR_ALARMS = 0.1
TRACK_ALARMS = 0.01
BLOCK = 20
ODDS = np.linspace(-4.0, 20.0, 481)  # thresholds on the log odds of existence


def measure(
    pool: Executor, runs: int, empty_runs: int, seed: int, snr_db: float, iterations: int,
) -> dict[str, Any]:
    """Calibrate detector and tracker, and score tracks where there is an object."""
    scenario = load_scenario(SCENARIO)
    sensor = SensorModel(snr_db=snr_db)
    detector = SDT(sensor=sensor, max_iterations=iterations)
    found = calibrated(detector, DETECTOR_ALARMS, scenario.shape)
    detector = replace(detector, threshold=found.threshold)
    tracker = PdaMmpf(
        sensor=sensor, rows=scenario.rows, cols=scenario.cols,
        frames_per_detection=detector.frames_per_declaration,
        detection=DetectionModel(resolution=resolution_of(detector)))
    confirm = calibrate(pool, detector, tracker, empty_runs, seed)
    tracker = replace(tracker, life=replace(
        tracker.life, confirm_probability=confirm,
        release_probability=min(confirm, tracker.life.release_probability)))
    empty = scored(pool, detector, tracker, empty_runs, seed + 1, False)
    present = scored(pool, detector, tracker, runs, seed + 2, True)
    return {
        'snr_db': snr_db, 's_m': iterations, 'runs': runs, 'empty_runs': empty_runs,
        'detector_threshold': found.threshold,
        'confirm_probability': tracker.life.confirm_probability,
        **figures(present, empty, tracker.life.birth_density, seed)}


def figures(
    present: list[RunScore], empty: list[RunScore], birth_density: float, seed: int,
) -> dict[str, Any]:
    """Return the figures of runs with and without an object."""
    rng = np.random.default_rng([seed, 5])
    hit, nees, after = (
        np.array([getattr(run, name) for run in present]) for name in ('hit', 'nees', 'after'))
    first = np.array([run.first for run in present])
    false = np.array([run.false for run in present])
    frames, cells = hit.shape[1], load_scenario(SCENARIO).rows * load_scenario(SCENARIO).cols
    births = birth_density * cells * frames  # of a run, as the tracker expects them
    weights = [births / len(present)] * len(present) + [(1.0 - births) / len(empty)] * len(empty)
    runs = [run.existence for run in present + empty]
    return {
        'empty_frames_with_track': interval(
            np.array([np.mean(run.false > 0) for run in empty]), rng),
        'pd': interval(hit[:, SCORED].mean(axis=1), rng),
        'first': [quantile_interval(first, each, rng) for each in (0.5, 0.9)],
        'after': [interval(each, rng) for each in after.T],
        'false_tracks': interval(false[:, SCORED].mean(axis=1), rng),
        'false_after': interval(((false + hit)[:, AFTER] > 0).mean(axis=1), rng),
        'nees': interval(nees[:, SCORED], rng),
        'rmse_m': float(np.sqrt(np.nanmean([run.squared[SCORED] for run in present]))),
        'existence': reliability(runs[:len(present)], weights[:len(present)], rng),
        'existence_at_birth_density': reliability(runs, weights, rng)}


def calibrate(
    pool: Executor, detector: SDT, tracker: PdaMmpf, runs: int, seed: int,
) -> float:
    """
    Return the confirm_probability at which TRACK_ALARMS of the empty frames hold a track.

    Below ``release_probability`` both are the same.  Confirmation does not change a track, so that
    one pass serves all thresholds.
    """
    highest = replace(tracker.life, confirm_probability=1.0 - 1e-9)
    histories = in_blocks(
        pool, partial(existences, detector, replace(tracker, life=highest), seed), runs)
    log_release = logit(tracker.life.release_probability)
    for bound in ODDS:
        share = np.mean([alarmed(run, bound, min(bound, log_release)) for run in histories])
        if share <= TRACK_ALARMS:
            return float(expit(bound))
    raise ValueError('no confirm_probability reaches the rate of false tracks')


def alarmed(
    history: Sequence[dict[str, float]], confirm: float, release: float,
) -> list[bool]:
    """Return whether each frame has a confirmed track, from log odds of existence by id."""
    confirmed: set[str] = set()
    answers = []
    for odds in history:
        confirmed = {
            name for name, value in odds.items()
            if value >= (release if name in confirmed else confirm)}
        answers.append(bool(confirmed))
    return answers


def existences(
    detector: SDT, tracker: PdaMmpf, seed: int, first: int, count: int,
) -> list[list[dict[str, float]]]:
    """Return the log odds of existence of all tracks in each frame of empty runs."""
    return [
        [{item.id: float(logit(item.score))
          for item in output.confirmed + output.tentative} for output in outputs]
        for _, outputs in tracked(detector, tracker, seed, False, first, count)]


def scored(
    pool: Executor, detector: SDT, tracker: PdaMmpf, runs: int, seed: int, present: bool,
) -> list[RunScore]:
    """Return the scores of all runs."""
    return in_blocks(pool, partial(score_block, detector, tracker, seed, present), runs)


def score_block(
    detector: SDT, tracker: PdaMmpf, seed: int, present: bool, first: int, count: int,
) -> list[RunScore]:
    """Score a block of runs."""
    return [score_run(truth, outputs)
            for truth, outputs in tracked(detector, tracker, seed, present, first, count)]


def tracked(
    detector: SDT, tracker: PdaMmpf, seed: int, present: bool, first: int, count: int,
) -> list[tuple[np.ndarray, list[Any]]]:
    """Return truth (K, 4) and the tracker's outputs of each run of a block."""
    scenario = load_scenario(SCENARIO)
    if not present:
        scenario = replace(scenario, objects=())
    truth, frames = zip(*(
        simulate_run(scenario, detector.sensor, seed, run)
        for run in range(first, first + count)))
    (declared,) = detect([detector], np.stack(frames), seed, first)
    answers = []
    for n in range(count):
        rng = np.random.default_rng([seed, 6, first + n])
        memory, outputs = tracker.init(), []
        for k, frame in enumerate(declared):
            single = replace(
                frame, peak=frame.peak[n], score=frame.score[n], state=frame.state[n],
                cov=frame.cov[n])
            memory, output = tracker.step(memory, single.estimates(), k + 1.0, rng)
            outputs.append(output)
        answers.append((truth[n], outputs))
    return answers


def in_blocks(pool: Executor, work: Any, runs: int) -> list[Any]:
    """Return the results of ``work(first, count)`` for all runs."""
    firsts = range(0, runs, BLOCK)
    blocks = pool.map(work, firsts, [min(BLOCK, runs - first) for first in firsts])
    return [answer for block in blocks for answer in block]
