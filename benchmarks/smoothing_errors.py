# SPDX-License-Identifier: Apache-2.0
"""
Measure the errors of published and of smoothed paths of tracks, over simulated runs.

Each run is one of a scenario, detected and tracked by the library with its defaults, scored as
the evaluator scores a run, and smoothed as ``evaluate.py --smooth`` does.  Errors are root mean
squares over the frames of all runs in which a track has an object within 1.5 cells.
"""

import argparse
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from functools import partial
import os
from pathlib import Path
import sys
from tempfile import TemporaryDirectory
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'scripts'))

import _environment  # noqa: E402

KINDS = ('position', 'velocity')


def main() -> int:
    """Smooth, add up, print; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False)
    parser.add_argument('--scenario', default='random', help='(random)')
    parser.add_argument('--detector', nargs='+', default=['sdt', 'hmm'], help='(sdt hmm)')
    parser.add_argument('--snr', type=float, default=9.0, help='[dB] (9)')
    parser.add_argument('--runs', type=int, default=100, help='runs of each (100)')
    parser.add_argument('--seed', type=int, default=0, help='seed of the first run (0)')
    parser.add_argument('--processes', type=int, default=2, help='processes (2)')
    options = parser.parse_args()
    _environment.ensure()
    os.environ |= {'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'}
    seeds = range(options.seed, options.seed + options.runs)
    for detector in options.detector:
        with ProcessPoolExecutor(options.processes) as pool:
            found = list(pool.map(
                partial(errors_of, options.scenario, detector, options.snr), seeds))
        show(f'{options.scenario}, {detector}, {options.snr:g} dB, {options.runs} runs, '
             f'seed {options.seed}', [each for each in found if each['points']])
    return 0


def show(title: str, runs: list[dict[str, Any]]) -> None:
    """Print the errors over all runs, and the interval of their ratio by bootstrap over runs."""
    import numpy as np

    points = np.array([run['points'] for run in runs])
    nees = np.average([run['nees_position'] for run in runs], weights=points)
    print(f'{title}: {points.sum()} points, NEES of smoothed positions {nees:.2f}')
    draws = np.random.default_rng(0).integers(len(runs), size=(1000, len(runs)))
    for kind in KINDS:
        squares = [points * np.square([run[f'{path}_rmse_{kind}'] for run in runs])
                   for path in ('filtered', 'smoothed')]
        filtered, smoothed = (float(np.sqrt(each.sum() / points.sum())) for each in squares)
        low, high = np.quantile(np.sqrt(
            squares[1][draws].sum(axis=1) / squares[0][draws].sum(axis=1)), [0.025, 0.975])
        print(f'  {kind}: filtered {filtered:.3f}, smoothed {smoothed:.3f}, '
              f'ratio {smoothed / filtered:.2f} [{low:.2f}, {high:.2f}]', flush=True)


def errors_of(scenario: str, detector: str, snr_db: float, seed: int) -> dict[str, Any]:
    """Return the errors of the paths of one run."""
    import lowsnr
    from lowsnr_bringup.run.results_folder import Account
    from lowsnr_common.settings.node_settings import Evaluation
    from lowsnr_common.settings.node_settings import RunSettings
    from lowsnr_eval.scoring.final_summary import summarize
    from lowsnr_eval.scoring.run_scoring import RunScorer
    from lowsnr_eval.smoothing.smoothed_table import write_smoothed

    simulation = lowsnr.simulate(scenario, snr_db=snr_db, seed=seed)
    found = lowsnr.track(simulation.frames, detector, snr_db, seed=seed, progress=False)
    with TemporaryDirectory() as place:
        folder = Path(place)
        run = RunSettings(results=place, scenario=scenario, detectors=(detector,))
        with closing(RunScorer(run, Evaluation(), lambda *_: None)) as scorer:
            for topic, table in (
                    ('ground_truth', simulation.truth), ('detections', found.detections),
                    ('tracks', found.tracks)):
                for k in range(len(simulation.frames)):
                    add(scorer, topic, (k + 1) * 1_000_000_000, table[table.frame == k])
            scorer.score(float('inf'))
        summary = summarize(folder, run, Evaluation(), seed, Account())
        return write_smoothed(folder, summary, {})[detector]


def add(scorer: Any, topic: str, stamp: int, rows: Iterable[Any]) -> None:
    """Give the rows of a frame to a scorer, as the messages of a topic."""
    from lowsnr_common.core.records import Estimate
    import numpy as np

    items = []
    for row in rows:
        known = 'sd_x' in row.dtype.names
        deviations = [row.sd_x, row.sd_v_x, row.sd_y, row.sd_v_y] if known else [0.0] * 4
        items.append(Estimate(
            np.array([row.x, row.v_x, row.y, row.v_y]), np.diag(np.square(deviations)),
            float(row.score) if known else 1.0, str(row.id) if 'id' in row.dtype.names else ''))
    for item in items:
        scorer.add_state(topic, stamp, item)
    scorer.add_array(topic, stamp, items, 0.0)


if __name__ == '__main__':
    sys.exit(main())
