# SPDX-License-Identifier: Apache-2.0
"""
Count how often the tracks of crossing objects change their objects, over simulated runs.

Each run is one of a scenario, detected and tracked by the library with its defaults; or tracked
alone, with the detector ``separate``: each object is then detected with probability .95 and a
variance of .1 m^2 along each axis, and there are no other detections.  A run has a
swap where a track goes over to another object, and its identities are kept where each object is
followed by one track alone and no track changes its object.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
import sys
from typing import Any

import tracked_runs

ROOT = Path(__file__).resolve().parents[1]


def main() -> int:
    """Track, count, print; return the exit code."""
    parser = tracked_runs.parser(__doc__, 'three_crossing', ['sdt', 'separate'], 12.0, 200)
    parser.add_argument(
        '--resolution', type=float, help="the tracker's detection.resolution [cells] (as the "
        'detector has it); 0 gives a detection to one track at most')
    options = parser.parse_args()
    measure = partial(metrics_of, resolution=options.resolution)
    for title, found in tracked_runs.measured(measure, options):
        show(title, found)
    return 0


def show(title: str, found: list[dict[str, Any]]) -> None:
    """Print the shares of runs with a swap and with all identities, and means over the runs."""
    from lowsnr_eval.scoring.metrics import wilson_interval
    import numpy as np

    swapped = sum(each['identity_swaps'] > 0 for each in found)
    kept = sum(each['identity_swaps'] + each['identity_switches'] == 0 for each in found)
    print(title)
    for what, count in (('with a swap', swapped), ('all identities kept', kept)):
        low, high = wilson_interval(count, len(found)) or (0.0, 1.0)
        print(f'  {what:<20} {count / len(found):.3f} [{low:.3f}, {high:.3f}]')
    for what in ('identity_switches', 'identity_swaps', 'track_purity', 'ospa2_m'):
        print(f'  {what:<20} {np.mean([each[what] for each in found]):.3f} a run')
    for what in ('completeness', 'ambiguity', 'spuriousness'):
        values = [each['siap'][what] for each in found if each['siap'][what] is not None]
        print(f'  {what:<20} {np.mean(values):.3f}', flush=True)


def metrics_of(
    scenario: str, detector: str, snr_db: float, seed: int, resolution: float | None = None,
) -> dict[str, Any]:
    """Return the metrics of the tracks of one run."""
    from lowsnr_common.settings.node_settings import Evaluation
    from lowsnr_eval.track_metrics.chain_metrics import ChainMetrics

    metrics = ChainMetrics(Evaluation())
    for frame in frames_of(scenario, detector, snr_db, seed, resolution):
        metrics.add(frame)
    return metrics.figures() or {}


def frames_of(
    scenario: str, detector: str, snr_db: float, seed: int, resolution: float | None = None,
) -> Iterator[Any]:
    """Yield what the metrics take of each frame of a run."""
    import lowsnr
    from lowsnr_eval.track_metrics.track_frame import TrackFrame
    import numpy as np

    if detector == 'separate':
        yield from separate_frames_of(scenario, seed)
        return
    simulation = lowsnr.simulate(scenario, snr_db=snr_db, seed=seed)
    settings = {} if resolution is None else {'tracker.detection.resolution': resolution}
    tracks = lowsnr.track(
        simulation.frames, detector, snr_db, seed=seed, settings=settings, progress=False).tracks
    for k in range(len(simulation.frames)):
        here, there = simulation.truth[simulation.truth.frame == k], tracks[tracks.frame == k]
        places = [np.stack([table.x, table.y], axis=-1) for table in (here, there)]
        yield TrackFrame(
            float(k), [str(name) for name in here.id], places[0],
            [str(name) for name in there.id], places[1], np.asarray(there.score))


def separate_frames_of(scenario: str, seed: int) -> Iterator[Any]:
    """Yield the frames of a run in which each object is detected by itself."""
    from lowsnr_common.core.motion import POS
    from lowsnr_common.core.records import Estimate
    from lowsnr_eval.track_metrics.track_frame import TrackFrame
    from lowsnr_sensor.scenario import load_scenario
    from lowsnr_track.detection_model import DetectionModel
    from lowsnr_track.pda_mmpf import PdaMmpf
    import numpy as np

    rng = np.random.default_rng([seed, 1])
    loaded = load_scenario(ROOT / 'config' / 'scenarios' / f'{scenario}.yaml')
    tracker = PdaMmpf(rows=loaded.rows, cols=loaded.cols, detection=DetectionModel(
        probability=0.95, use_scores=False))
    state = tracker.init()
    for k, objects in enumerate(loaded.truth(1.0, 1.0, rng), start=1):
        found = []
        for item in objects:
            seen = np.array(item.state)
            seen[POS] += np.sqrt(0.1) * rng.standard_normal(2)
            if rng.random() < 0.95:
                found.append(Estimate(seen, 0.1 * np.eye(4), 0.9))
        state, output = tracker.step(state, found, float(k), rng)
        places = [np.reshape([each.state[POS] for each in some], (-1, 2))
                  for some in (objects, output.confirmed)]
        yield TrackFrame(
            float(k), [each.id for each in objects], places[0],
            [each.id for each in output.confirmed], places[1],
            np.array([each.score for each in output.confirmed]))


if __name__ == '__main__':
    sys.exit(main())
