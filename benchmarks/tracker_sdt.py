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
from lowsnr_common.core.motion import POS
from lowsnr_detect.calibration.operating_point import calibrated
from lowsnr_detect.detectors.sdt import SDT
from lowsnr_eval.study.experiment import simulate_run
from lowsnr_eval.study.offline_chain import detect
from lowsnr_sensor.scenario import load_scenario
from lowsnr_track.pda_mmpf import PdaMmpf
import numpy as np
from scipy.special import expit
from scipy.special import logit

SCENARIO = Path(__file__).resolve().parents[1] / 'config' / 'scenarios' / 'random.yaml'
SCORED = slice(9, 35)  # frames 10 to 35
AFTER = slice(35, 40)
GATE_M = 1.5
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
        frames_per_detection=detector.frames_per_declaration)
    tracker = replace(tracker, life=replace(
        tracker.life, confirm_probability=calibrate(pool, detector, tracker, empty_runs, seed)))
    empty = scored(pool, detector, tracker, empty_runs, seed + 1, False)
    object_runs = scored(pool, detector, tracker, runs, seed + 2, True)
    hit, false, squared = (np.array(part) for part in zip(*object_runs))
    any_false = np.array([alarms for _, alarms, _ in empty]) > 0
    rng = np.random.default_rng([seed, 5])
    return {
        'snr_db': snr_db, 's_m': iterations, 'runs': runs, 'empty_runs': empty_runs,
        'detector_threshold': found.threshold,
        'confirm_probability': tracker.life.confirm_probability,
        'empty_frames_with_track': interval(any_false.mean(axis=1), rng),
        'pd': interval(hit[:, SCORED].mean(axis=1), rng),
        'false_tracks': interval(false[:, SCORED].mean(axis=1), rng),
        'false_after': interval((false[:, AFTER] > 0).mean(axis=1), rng),
        'rmse_m': float(np.sqrt(np.nanmean(squared[:, SCORED])))}


def calibrate(
    pool: Executor, detector: SDT, tracker: PdaMmpf, runs: int, seed: int,
) -> float:
    """
    Return the confirm_probability at which TRACK_ALARMS of the empty frames hold a track.

    Confirmation does not change a track, so that one pass serves all thresholds.
    """
    highest = replace(tracker.life, confirm_probability=1.0 - 1e-9)
    histories = in_blocks(
        pool, partial(existences, detector, replace(tracker, life=highest), seed), runs)
    log_release = logit(tracker.life.release_probability)
    for bound in ODDS[log_release < ODDS]:
        share = np.mean([alarmed(run, bound, log_release) for run in histories])
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
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return hit, number of false tracks and squared error of each frame, for all runs."""
    return in_blocks(pool, partial(score_block, detector, tracker, seed, present), runs)


def score_block(
    detector: SDT, tracker: PdaMmpf, seed: int, present: bool, first: int, count: int,
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Score a block of runs."""
    answers = []
    for truth, outputs in tracked(detector, tracker, seed, present, first, count):
        away = [
            np.array([np.hypot(*(item.state[POS] - state[POS])) for item in output.confirmed])
            for state, output in zip(truth, outputs)]
        nearest = np.array([np.min(each, initial=np.inf) for each in away])
        hit = nearest <= GATE_M
        false = np.array([len(each) for each in away]) - hit
        answers.append((hit, false, np.where(hit, nearest, np.nan)**2))
    return answers


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


def interval(shares: np.ndarray, rng: np.random.Generator) -> tuple[float, float, float]:
    """Return the mean and its 95 % interval, by a bootstrap over runs."""
    draws = shares[rng.integers(len(shares), size=(1000, len(shares)))].mean(axis=1)
    low, high = np.quantile(draws, [0.025, 0.975])
    return float(shares.mean()), float(low), float(high)
