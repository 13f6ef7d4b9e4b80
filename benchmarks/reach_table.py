# SPDX-License-Identifier: Apache-2.0
"""
Table of how near the grid filters come to the exact filter, and of several faint objects.

- ``score``: mean of ln P(E_k), of what a filter says of existence in each frame, where an object
  is born, moves and dies as the filter assumes (6 dB, 20 x 20 cells).  No filter has a larger one
  than the exact one, which finer and finer grids approach.  Differences are on the same frames.
- ``many``: five objects in 256 x 256 cells, as in soft_evidence.py: GOSPA (cutoff 4 cells) and
  hits of ``bernoulli`` at the lowest threshold with at most so many false declarations a frame.
  The threshold is chosen on the same runs, and the intervals take it as given.
- ``near``: share of two objects of 9 dB that move side by side for 25 frames with a declaration
  of their own within the gate, from the seventh frame on, and other declarations a frame, with
  the threshold by default and with that for 1 % of the empty frames.
- ``time``: CPU time of a frame of ``pmf`` in 20 x 20 cells and of ``bernoulli`` in 1024 x 1024.

Intervals are 95 %, by bootstrap over whole runs.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
import sys
import time
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'scripts'))

import _environment  # noqa: E402
from detector_runs import bootstrap  # noqa: E402
import soft_evidence  # noqa: E402

SHAPE, FRAMES, BLOCK = (20, 20), 40, 20
GRIDS = ((1, 16, 1), (2, 24, 2), (3, 32, 3), (4, 40, 4))  # resolution, headings, speeds
THRESHOLDS = [number / 4.0 for number in range(-12, 17)]
APART, NEAR_SHAPE = (3, 5), (30, 30)


def main() -> int:
    """Compute and print what is asked for; return the exit code."""
    parts = {'score': scores, 'many': many, 'near': near, 'time': times}
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False,
        epilog='example: python benchmarks/reach_table.py --only near --runs 100')
    parser.add_argument('--runs', type=int, default=100, help='runs (100)')
    parser.add_argument('--seed', type=int, default=0, help='root seed (0)')
    parser.add_argument('--only', nargs='+', default=list(parts), choices=list(parts))
    parser.add_argument(
        '--grids', type=int, default=3, help=f'grids of pmf, of {len(GRIDS)} (3)')
    options = parser.parse_args()
    if options.runs < 1 or not 1 <= options.grids <= len(GRIDS):
        parser.error(f'--runs must be at least 1, and --grids from 1 to {len(GRIDS)}')
    _environment.ensure()
    for part in options.only:
        for line in parts[part](options):
            print(line, flush=True)
    return 0


def scores(options: argparse.Namespace) -> Iterator[str]:
    """Yield the log score of each filter, and its difference to the one before it."""
    import numpy as np

    before = None
    for label, detector in filters(options.grids).items():
        own = np.concatenate([
            log_scores(detector, options.seed, first, min(BLOCK, options.runs - first))
            for first in range(0, options.runs, BLOCK)])
        low, high = bootstrap(own, options.seed)
        line = f'score  {label:>20}  {own.mean():.4f} [{low:.4f}, {high:.4f}]'
        if before is not None:
            low, high = bootstrap(own - before, options.seed)
            line += f'  change {np.mean(own - before):+.4f} [{low:+.4f}, {high:+.4f}]'
        yield line
        before = own


def filters(grids: int) -> dict[str, Any]:
    """Return the filters, from coarse to fine."""
    from lowsnr_common.core.measurement import SensorModel
    from lowsnr_detect.detectors.hmm import HMM
    from lowsnr_detect.detectors.pmf import PMF

    _, motion = soft_evidence.scenario()
    same: dict[str, Any] = {'sensor': SensorModel(snr_db=6.0), 'motion': motion}
    found: dict[str, Any] = {f'hmm order {order}': HMM(order=order, **same) for order in (1, 2)}
    for resolution, headings, speeds in GRIDS[:grids]:
        found[f'pmf {resolution} x {headings} x {speeds}'] = PMF(
            resolution=resolution, headings=headings, speeds=speeds, **same)
    return found


def log_scores(detector: Any, seed: int, first: int, count: int) -> Any:
    """Return the mean log score of existence of each run of a block, (count,)."""
    from lowsnr_sensor.simulator import simulate_frames
    import numpy as np

    objects, frames = [], []
    for run in range(first, first + count):
        rng = np.random.default_rng([seed, run])
        objects.append(lives(detector, rng))
        frames.append(simulate_frames(objects[-1], detector.sensor, SHAPE, rng))
    there = np.array([[bool(present) for present in each] for each in objects])
    state, odds = detector.init((count, *SHAPE)), []
    for frame in np.stack(frames, axis=1).astype(float):
        state, _ = detector.step(state, frame, None)
        odds.append(state[-1].log_odds)
    log_odds = np.stack(odds, axis=1)
    return -np.logaddexp(0.0, np.where(there, -log_odds, log_odds)).mean(axis=1)


def lives(detector: Any, rng: Any) -> list[list[Any]]:
    """Return the object of each frame, if there is one, as a filter assumes it."""
    from lowsnr_common.core.records import Truth
    import numpy as np

    chain, sensor, motion = detector.existence, detector.sensor, detector.motion
    found: list[list[Any]] = []
    state = mode = None
    for number in range(FRAMES):
        if state is not None:
            mode = motion.switch(mode, 1.0, rng)
            state = motion.move(state, mode, 1.0, rng)
            inside = np.all((sensor.cells(state) >= 0) & (sensor.cells(state) < SHAPE))
            if rng.random() < chain.death_prob or not inside:
                state = None
        elif rng.random() < (chain.birth_prob if number else chain.initial_prob):
            state, mode = np.zeros((1, 4)), rng.integers(motion.count, size=1)
            state[:, ::2] = rng.uniform(-0.5, np.array(SHAPE[::-1]) - 0.5)
            state[:, 1::2] = motion.draw_velocity((1,), rng)
        found.append([] if state is None else [Truth('1', state[0], 0.0)])
    return found


def many(options: argparse.Namespace) -> Iterator[str]:
    """Yield GOSPA and hits of several objects at a rate of false declarations."""
    import numpy as np

    for snr_db, most in ((9.0, 0.2), (6.0, 0.5)):
        for order in (1, 2):
            given = argparse.Namespace(order=order, confirm=0.95, seed=options.seed)
            runs = np.array([many_run(snr_db, given, run) for run in range(options.runs)])
            # (runs, thresholds, figures): GOSPA, hits, objects and false declarations of a run
            false = runs[..., 3].mean(axis=0) / len(soft_evidence.FRAMES)
            allowed = np.flatnonzero(false <= most)
            if not len(allowed):
                yield f'many  {snr_db:g} dB  order {order}: more false at every threshold'
                continue
            at = allowed[0]
            gospa = runs[:, at, 0] / len(soft_evidence.SCORED)
            hits = runs[:, at, 1] / runs[:, at, 2]
            yield (f'many  {snr_db:g} dB  order {order}  threshold {THRESHOLDS[at]:g}  '
                   f'false {false[at]:.3f}  ' + '  '.join(
                       '{} {:.3f} [{:.3f}, {:.3f}]'.format(
                           name, value.mean(), *bootstrap(value, options.seed))
                       for name, value in (('GOSPA', gospa), ('hit', hits))))


def many_run(snr_db: float, given: argparse.Namespace, run: int) -> Any:
    """Return the figures of a run, (thresholds, figures)."""
    from lowsnr_common.core.measurement import SensorModel
    from lowsnr_sensor.simulator import simulate_frames
    import numpy as np
    from scipy.special import logit

    scene, motion = soft_evidence.scenario()
    sensor, rng = SensorModel(snr_db=snr_db), np.random.default_rng([given.seed, run])
    detector, _ = soft_evidence.chain(sensor, motion, THRESHOLDS[0], given)
    truth = scene.truth(1.0, 1.0, rng)
    memory, total = detector.init(scene.shape), np.zeros((len(THRESHOLDS), 4))
    for k, frame in enumerate(simulate_frames(truth, sensor, scene.shape, rng)):
        places = np.array([item.state for item in truth[k]]).reshape(-1, 4)
        memory, declared = detector.step(memory, frame.astype(float), rng)
        found = declared.estimates()
        for number, threshold in enumerate(THRESHOLDS):
            kept = [item for item in found if logit(item.score) > threshold]
            total[number] += soft_evidence.frame_scores(k, places, kept)[:4]
    return total


def near(options: argparse.Namespace) -> Iterator[str]:
    """Yield the share of neighbours that are declared, and other declarations a frame."""
    from dataclasses import replace

    from lowsnr_common.core.measurement import SensorModel
    from lowsnr_detect.calibration.operating_point import calibrated
    from lowsnr_detect.detectors.bernoulli import Bernoulli
    import numpy as np

    for order in (1, 2):
        plain = Bernoulli(sensor=SensorModel(snr_db=9.0), order=order)
        matched = calibrated(plain, 0.01, NEAR_SHAPE, runs=300).threshold
        for threshold in (plain.threshold, matched):
            for apart in APART:
                hits, false = near_runs(replace(plain, threshold=threshold), apart, options)
                low, high = bootstrap(hits, options.seed)
                yield (f'near  order {order}  threshold {threshold:.2f}  {apart} cells apart  '
                       f'{hits.mean():.3f} [{low:.3f}, {high:.3f}]  false {np.mean(false):.3f}')


def near_runs(detector: Any, apart: int, options: argparse.Namespace) -> tuple[Any, Any]:
    """Return the share of neighbours that are hit, and other declarations a frame, (runs,)."""
    from lowsnr_common.settings.node_settings import Evaluation
    from lowsnr_eval.scoring import metrics
    import numpy as np

    rng, found = np.random.default_rng([options.seed, apart]), []
    state = detector.init((options.runs, *NEAR_SHAPE))
    for k in range(25):
        x = 14.5 + 0.4 * (k - 12)
        states = np.array([[x, 0.4, 14.5 + apart * (n - 0.5), 0.0] for n in (0, 1)])
        signal = sum(detector.sensor.signal(each, NEAR_SHAPE) for each in states)
        state, declared = detector.step(
            state, signal + rng.standard_normal((options.runs, *NEAR_SHAPE)), rng)
        places = [own[np.isfinite(own[:, 0])] for own in declared.state[..., ::2]]
        hits = [len(metrics.match_within_gate(
            metrics.distances(states[:, ::2], own), Evaluation().gate_m)[0]) for own in places]
        found.append([(hit / 2.0, len(own) - hit) for hit, own in zip(hits, places)])
    hit, false = np.array(found)[6:].mean(axis=0).T
    return hit, false


def times(options: argparse.Namespace) -> Iterator[str]:
    """Yield the time of a frame."""
    from lowsnr_detect.detectors.bernoulli import Bernoulli
    from lowsnr_detect.detectors.pmf import PMF
    import numpy as np

    rng = np.random.default_rng(options.seed)
    for detector, side in ((PMF(), 20), (Bernoulli(regions=2), 1024)):
        state, spent = detector.init((side, side)), []
        for _ in range(12):
            frame = rng.standard_normal((side, side))
            start = time.perf_counter()
            state, _ = detector.step(state, frame, rng)
            spent.append(time.perf_counter() - start)
        yield (f'time  {type(detector).__name__.lower()}  {side} x {side}  '
               f'{1e3 * np.median(spent[2:]):.2f} ms, the least {1e3 * min(spent[2:]):.2f} ms')


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
