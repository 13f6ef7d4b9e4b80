# SPDX-License-Identifier: Apache-2.0
"""
Measure the errors of published and of smoothed paths of tracks, over simulated runs.

Each run is one of a scenario, detected and tracked by the library with its defaults, scored as
the evaluator scores a run, and smoothed as ``evaluate.py --smooth`` does.  Errors are root mean
squares over the frames of all runs in which a track has an object within 1.5 cells.
"""

from collections.abc import Iterable
from contextlib import closing
from pathlib import Path
import sys
from tempfile import TemporaryDirectory
from typing import Any

import tracked_runs

KINDS = ('position', 'velocity')


def main() -> int:
    """Smooth, add up, print; return the exit code."""
    options = tracked_runs.parser(__doc__, 'random', ['sdt', 'hmm'], 9.0, 100).parse_args()
    for title, found in tracked_runs.measured(errors_of, options):
        show(title, [each for each in found if each['points']])
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
