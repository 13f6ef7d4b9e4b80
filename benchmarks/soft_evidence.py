# SPDX-License-Identifier: Apache-2.0
"""
Table of tracks of several faint objects: from posteriors as such, and from posteriors as hits.

Five objects move at random as in config/scenarios/random.yaml, in frames of 256 x 256 cells.  The
same declarations of ``bernoulli`` are scored as they are, tracked as hits (without what the
detector predicted), and tracked by what is new in each frame.  GOSPA (cutoff 4 cells) is the mean
of frames 10 to 35; hits are objects with a declaration of their own within the gate in these
frames, and false all other declarations of all frames.  ``calibration`` is the mean difference of
stated and true existence over tenths of the stated one, tentative tracks included, ``nees`` the
normalised squared error of the position of hits, 2 if the covariance is true.  Intervals are
95 %, by bootstrap over whole runs.
"""

import argparse
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
import sys
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'scripts'))

import _environment  # noqa: E402
from detector_runs import bootstrap  # noqa: E402

SIDE, OBJECTS, CUTOFF = 256, 5, 4.0
FRAMES, SCORED = range(40), range(9, 35)
SOURCES = ('detector', 'hits', 'posteriors')


def main() -> int:
    """Compute and print the table; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False,
        epilog='example: python benchmarks/soft_evidence.py --snr 9 --runs 20')
    parser.add_argument('--runs', type=int, default=20, help='runs (20)')
    parser.add_argument('--seed', type=int, default=7, help='root seed (7)')
    parser.add_argument('--snr', type=float, nargs='+', default=(9.0, 6.0), metavar='DB')
    parser.add_argument('--order', type=int, default=1, help='order of the detector (1)')
    parser.add_argument(
        '--threshold', type=float, nargs='+', default=(1.5, 0.0), metavar='NAT',
        help='thresholds of the detector (1.5 0)')
    parser.add_argument(
        '--confirm', type=float, default=0.95, help='existence that confirms a track (0.95)')
    options = parser.parse_args()
    _environment.ensure()
    for snr_db in options.snr:
        for threshold in options.threshold:
            for line in table(snr_db, threshold, options):
                print(line, flush=True)
    return 0


def table(snr_db: float, threshold: float, options: argparse.Namespace) -> Iterator[str]:
    """Yield a line for every source."""
    import numpy as np

    rows: dict[str, list[Any]] = {source: [] for source in SOURCES}
    stated: dict[str, list[Any]] = {source: [] for source in SOURCES}
    for run in range(options.runs):
        entries = simulated(snr_db, threshold, options, run)
        for source, frames in entries.items():
            scores = [frame_scores(k, truth, found) for k, (truth, found, _) in enumerate(frames)]
            rows[source].append(np.nansum(scores, axis=0))
            stated[source] += [
                pair for truth, _, everything in frames for pair in existence(truth, everything)]
    for source in SOURCES:
        gospa, hits, present, false, nees = np.array(rows[source]).T
        low, high = bootstrap(gospa / len(SCORED), options.seed)
        hit_low, hit_high = bootstrap(hits / present, options.seed)
        yield (
            f'{snr_db:g} dB  threshold {threshold:g}  {source:>10}  '
            f'GOSPA {gospa.mean() / len(SCORED):.2f} [{low:.2f}, {high:.2f}]  '
            f'hit {hits.sum() / present.sum():.3f} [{hit_low:.3f}, {hit_high:.3f}]  '
            f'false {false.mean() / len(FRAMES):.3f}  '
            f'calibration {miscalibration(stated[source]):.3f}  '
            f'nees {nees.sum() / hits.sum():.2f}')


def simulated(
    snr_db: float, threshold: float, options: argparse.Namespace, run: int,
) -> dict[str, list[tuple[Any, list[Any], list[Any]]]]:
    """Return truth, declared and all entries of every frame, by source."""
    from lowsnr_common.core.measurement import SensorModel
    from lowsnr_sensor.simulator import simulate_frames
    import numpy as np

    scene, motion = scenario()
    sensor, rng = SensorModel(snr_db=snr_db), np.random.default_rng([options.seed, run])
    detector, tracker = chain(sensor, motion, threshold, options)
    truth = scene.truth(1.0, 1.0, rng)
    frames = simulate_frames(truth, sensor, scene.shape, rng)
    memory, tracks = detector.init(scene.shape), {
        source: (tracker.init(), np.random.default_rng([options.seed, run, 1]))
        for source in SOURCES[1:]}
    answers = defaultdict(list)
    for k, (present, frame) in enumerate(zip(truth, frames)):
        places = np.array([item.state for item in present]).reshape(-1, 4)
        memory, declared = detector.step(memory, frame.astype(float), rng)
        found = declared.estimates()
        answers['detector'].append((places, found, found))
        for source, (state, own) in tracks.items():
            given = [item if source == 'posteriors' else replace(item, predicted=None)
                     for item in found]
            state, output = tracker.step(state, given, k + 1.0, own)
            tracks[source] = state, own
            answers[source].append(
                (places, output.confirmed, output.confirmed + output.tentative))
    return answers


def scenario() -> tuple[Any, Any]:
    """Return the scenario and the motion of its objects."""
    from lowsnr_sensor.scenario import load_scenario

    base = load_scenario(ROOT / 'config' / 'scenarios' / 'random.yaml')
    (one,) = base.objects
    objects = tuple(replace(one, id=str(number)) for number in range(OBJECTS))
    return replace(base, rows=SIDE, cols=SIDE, objects=objects), one.random


def chain(
    sensor: Any, motion: Any, threshold: float, options: argparse.Namespace,
) -> tuple[Any, Any]:
    """Return detector and tracker, with the motion and the birth rate of the objects."""
    from lowsnr_detect.detectors.bernoulli import Bernoulli
    from lowsnr_track.pda_mmpf import PdaMmpf
    from lowsnr_track.track_management import TrackLife

    detector = Bernoulli(
        sensor=sensor, motion=motion, order=options.order, threshold=threshold,
        max_detections=200, birth_prob=OBJECTS / (len(FRAMES) * SIDE**2))
    return detector, PdaMmpf(
        sensor=sensor, motion=motion, rows=SIDE, cols=SIDE,
        frames_per_detection=detector.frames_per_declaration,
        life=TrackLife(confirm_probability=options.confirm))


def frame_scores(k: int, truth: Any, found: list[Any]) -> tuple[float, ...]:
    """Return GOSPA, hits, objects, false declarations and squared errors of a frame."""
    from lowsnr_common.settings.node_settings import Evaluation
    from lowsnr_eval.scoring import metrics
    import numpy as np

    states = np.array([item.state for item in found]).reshape(-1, 4)
    distance = metrics.distances(truth[:, ::2], states[:, ::2])
    rows, cols = metrics.match_within_gate(distance, Evaluation().gate_m)
    false = len(found) - len(rows)
    if k not in SCORED:
        return 0.0, 0, 0, false, 0.0
    away = [states[col, ::2] - truth[row, ::2] for row, col in zip(rows, cols)]
    nees = sum(
        float(offset @ np.linalg.solve(found[col].cov[::2, ::2], offset))
        for offset, col in zip(away, cols))
    return metrics.gospa(distance, CUTOFF), len(rows), len(truth), false, nees


def existence(truth: Any, entries: list[Any]) -> Iterator[tuple[float, bool]]:
    """Yield the stated existence of every entry, and whether it is the only one at an object."""
    from lowsnr_common.settings.node_settings import Evaluation
    from lowsnr_eval.scoring import metrics
    import numpy as np

    states = np.array([item.state for item in entries]).reshape(-1, 4)
    _, cols = metrics.match_within_gate(
        metrics.distances(truth[:, ::2], states[:, ::2]), Evaluation().gate_m)
    for number, item in enumerate(entries):
        yield item.score, number in cols


def miscalibration(pairs: list[tuple[float, bool]]) -> float:
    """Return the mean difference of stated and true existence, over tenths of the stated one."""
    import numpy as np

    stated, true = np.array(pairs, dtype=float).T
    tenth = np.minimum((10.0 * stated).astype(int), 9)
    error = [abs(np.sum((stated - true)[tenth == number])) for number in range(10)]
    return float(sum(error) / len(stated))


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
