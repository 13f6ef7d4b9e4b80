# SPDX-License-Identifier: Apache-2.0
"""
Table of the gain in P_D from a right destination of the objects, and of the loss from a wrong one.

Objects move at random as in config/scenarios/random.yaml, but with gentle turns, and end in frame
35 at the destination, with its standard deviation.  Every detector has the motion of the objects.
Its destination is none, the right one, a place 5 cells away, or the opposite corner, each with a
probability of 0.9.  Detectors that know several are also told that it is the right one or the
opposite corner, 0.45 each, and that the object arrives in any frame from 33 to 37.
P_D is the fraction of frames 10 to 35 with a declaration within the gate; every variant is
calibrated to the same fraction of empty frames with any declaration.  Intervals are 95 %, by
bootstrap over whole runs; a gain is P_D minus that without a destination on the same frames.
"""

import argparse
from collections.abc import Iterator
from dataclasses import fields
from dataclasses import replace
from pathlib import Path
import sys
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'scripts'))

import _environment  # noqa: E402
from detector_runs import bootstrap  # noqa: E402
from detector_runs import build  # noqa: E402
from detector_runs import declared  # noqa: E402
from detector_runs import empty_alarms  # noqa: E402
from detector_runs import matched  # noqa: E402
from detector_runs import Method  # noqa: E402
from detector_runs import within_gate  # noqa: E402
from detector_runs import write_rows  # noqa: E402
from detector_table import FRAMES  # noqa: E402

SNRS_DB = (3.0, 6.0, 9.0)
ARRIVAL = 35
# The destination and its standard deviation [m], and its probability in the detectors.
PLACE = (15.0, 14.0)
STD = 1.0
PROBABILITY = 0.9
OPPOSITE = (1.0, 1.0)
DESTINATIONS = {'none': None, 'right': PLACE, '5 cells off': (11.0, 11.0), 'opposite': OPPOSITE}
EITHER, ARRIVALS = 'either of two', (33, 37)
METHODS = (
    Method('sdt s_m=8 prior', 'sdt', {'max_iterations': 8, 'move_prior': True}),
    Method('mmtbd2', 'mmtbd2'),
    Method('hmm order 1', 'hmm', {'order': 1}),
    Method('tbd2', 'tbd2'),
    Method('pmf', 'pmf'),
)
FIELDS = (
    'method', 'snr_db', 'destination', 'pd', 'pd_low', 'pd_high', 'gain', 'gain_low', 'gain_high',
    'empty_rate', 'threshold', 'threshold_low', 'threshold_high', 'turn_deg_s', 'runs',
    'calibration_runs', 'seed')


def main() -> int:
    """Compute, print and write the table; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False,
        epilog='example: python benchmarks/destination_table.py --runs 200')
    parser.add_argument('--runs', type=int, default=200, help='runs with an object (200)')
    parser.add_argument(
        '--calibration-runs', type=int, default=1000, help='empty runs a threshold (1000)')
    parser.add_argument('--seed', type=int, default=0, help='root seed (0)')
    parser.add_argument('--snr', type=float, nargs='+', default=SNRS_DB, metavar='DB')
    parser.add_argument(
        '--turn', type=float, default=5.0, help='turn rate, to either side [deg/s] (5)')
    labels = [method.label for method in METHODS]
    parser.add_argument('--method', nargs='+', default=labels, metavar='LABEL', choices=labels)
    parser.add_argument('--out', type=Path, default=ROOT / 'results' / 'destination_table.csv')
    options = parser.parse_args()
    _environment.ensure()
    write_rows(options.out, FIELDS, (
        row for method in METHODS if method.label in options.method for snr_db in options.snr
        for row in measure(method, snr_db, options)), line)
    return 0


def line(row: dict[str, Any]) -> str:
    """Return a row as it is printed."""
    return (
        '{method:>16} {snr_db:5g} dB  {destination:>12}  P_D {pd:.3f} [{pd_low:.3f}, '
        '{pd_high:.3f}]  gain {gain:+.3f} [{gain_low:+.3f}, {gain_high:+.3f}]  '
        'empty {empty_rate:.4f}'.format(**row))


def measure(
    method: Method, snr_db: float, options: argparse.Namespace,
) -> Iterator[dict[str, Any]]:
    """Calibrate every variant of a method and score all on the same runs."""
    from lowsnr_common.core.measurement import SensorModel
    from lowsnr_sensor.scenario import load_scenario

    scenario = load_scenario(ROOT / 'config' / 'scenarios' / 'random.yaml')
    (item,) = scenario.objects
    assert item.random is not None
    motion = replace(item.random, turn_rates_deg_s=(0.0, options.turn, -options.turn))
    scenario = replace(scenario, objects=(replace(item, random=motion),))
    sensor = SensorModel(snr_db=snr_db)
    plain = None
    for destination, settings in told(method.detector).items():
        detector, found = matched(
            build(replace(method, settings=method.settings | settings), sensor, motion),
            scenario.shape, options.calibration_runs)
        places = declared(detector, scenario, sensor, options.runs, options.seed, simulate)[:2]
        hits = within_gate(*places).any(axis=-1)[:, FRAMES].mean(axis=1)
        plain = hits if plain is None else plain
        empty = empty_alarms(detector, scenario, options.runs, options.seed)
        yield dict(zip(FIELDS, (
            method.label, snr_db, destination, hits.mean(), *bootstrap(hits, options.seed),
            (hits - plain).mean(), *bootstrap(hits - plain, options.seed),
            empty.mean(), found.threshold, *found.interval,
            options.turn, options.runs, options.calibration_runs, options.seed)))


def told(name: str) -> dict[str, dict[str, Any]]:
    """Return the settings of a registered detector for every variant that it can be told."""
    from lowsnr_detect.parts.registry import detector_class

    known = {item.name for item in fields(detector_class(name))}
    found = {label: bound_for(place) for label, place in DESTINATIONS.items()
             if place is None or 'destination' in known}
    if 'destinations' in known:
        lists = {'probability': (PROBABILITY / 2.0,) * 2, 'x_m': (PLACE[0], OPPOSITE[0]),
                 'y_m': (PLACE[1], OPPOSITE[1]), 'std_m': (STD,) * 2,
                 'earliest_frame': ARRIVALS[:1] * 2, 'latest_frame': ARRIVALS[1:] * 2}
        found[EITHER] = {f'destinations.{key}': value for key, value in lists.items()}
    return found


def bound_for(place: tuple[float, float] | None) -> dict[str, Any]:
    """Return the settings of a detector for a destination."""
    if place is None:
        return {}
    values = {'probability': PROBABILITY, 'x_m': place[0], 'y_m': place[1], 'std_m': STD,
              'arrival_frame': ARRIVAL}
    return {f'destination.{key}': value for key, value in values.items()}


def simulate(scenario: Any, sensor: Any, seed: int, run: int) -> tuple[Any, Any]:
    """Return states (K, 4), NaN where there is no object, and frames of a run."""
    from lowsnr_common.core.records import Truth
    from lowsnr_common.core.streams import stream
    from lowsnr_sensor.simulator import simulate_frames
    import numpy as np

    (item,) = scenario.objects
    path = path_to(item, scenario.shape, stream(seed, 'truth', run))
    truth = np.full((scenario.frames, 4), np.nan)
    truth[item.first_frame - 1:item.last_frame] = path
    objects = [[] if np.isnan(state[0]) else [Truth(item.id, state, 0.0)] for state in truth]
    frames = simulate_frames(objects, sensor, scenario.shape, stream(seed, 'noise', run))
    return truth, frames.astype(float)


def path_to(item: Any, shape: tuple[int, int], rng: Any) -> Any:
    """
    Draw a path (frames, 4) that ends at the destination, in cells of a metre.

    The motion does not depend on the position, so that any path is shifted to its end.
    """
    from lowsnr_common.core.motion import POS
    from lowsnr_common.core.motion import VEL
    import numpy as np

    motion = item.random
    while True:
        state = np.zeros((1, 4))
        state[:, VEL] = motion.draw_velocity((1,), rng)
        mode, steps = rng.integers(motion.count, size=1), [state]
        while len(steps) <= item.last_frame - item.first_frame:
            mode = motion.switch(mode, 1.0, rng)
            steps.append(motion.move(steps[-1], mode, 1.0, rng))
        path = np.concatenate(steps)
        path[:, POS] += PLACE + STD * rng.standard_normal(2) - path[-1, POS]
        speed = np.linalg.norm(path[:, VEL], axis=1)
        if (np.all((path[:, POS] >= -0.5) & (path[:, POS] < np.array(shape[::-1]) - 0.5))
                and np.all((speed >= motion.min_speed_mps) & (speed <= motion.max_speed_mps))):
            return path


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
