# SPDX-License-Identifier: Apache-2.0
"""
Table of the gain and the cost of SDT with two cells a frame (radius: 2) in example 5.

The object of config/scenarios/example5.yaml moves 1.4 cells a frame up to frame 15 and from frame
29 on, and at most one in frames 17 to 28.  P_D is the fraction of frames of these stretches with a
declaration within the gate, after the first s_m frames with the object; every variant is
calibrated to the same fraction of empty frames with any declaration.  Intervals are 95 %,
by bootstrap over whole runs.  Time is that of a step, radius 1 and 2 in turn on the same frames,
the median over frames, as a ratio to radius 1, for the 20 x 20 cells of the example and 256 x 256.
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
from detector_runs import declared  # noqa: E402
from detector_runs import empty_alarms  # noqa: E402
from detector_runs import matched  # noqa: E402
from detector_runs import within_gate  # noqa: E402
from detector_runs import write_rows  # noqa: E402

SNRS_DB = (3.0, 6.0, 9.0, 12.0)
DEPTHS = (3, 5, 8)
FIRST = 5
SLOW = range(17, 29)
FIELDS = (
    'max_iterations', 'radius', 'snr_db', 'fast', 'fast_low', 'fast_high', 'slow', 'slow_low',
    'slow_high', 'empty_rate', 'threshold', 'threshold_low', 'threshold_high', 'time_ratio',
    'time_ratio_256', 'runs', 'seed')


def main() -> int:
    """Compute, print and write the table; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False,
        epilog='example: python benchmarks/radius_table.py --runs 500')
    parser.add_argument('--runs', type=int, default=500, help='runs with the object (500)')
    parser.add_argument('--seed', type=int, default=0, help='root seed (0)')
    parser.add_argument('--snr', type=float, nargs='+', default=SNRS_DB, metavar='DB')
    parser.add_argument('--out', type=Path, default=ROOT / 'results' / 'radius_table.csv')
    options = parser.parse_args()
    _environment.ensure()
    write_rows(options.out, FIELDS, rows(options), line)
    return 0


def rows(options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield a row for both radii at every number of frames and SNR."""
    for depth in DEPTHS:
        ratio = time_ratio(depth, 20, 1000, options.seed)
        ratio_256 = time_ratio(depth, 256, 40, options.seed)
        for snr_db in options.snr:
            for radius in (1, 2):
                yield measure(depth, radius, snr_db, options) | {
                    'time_ratio': ratio if radius == 2 else 1.0,
                    'time_ratio_256': ratio_256 if radius == 2 else 1.0}


def line(row: dict[str, Any]) -> str:
    """Return a row as it is printed."""
    return (
        's_m={max_iterations} radius={radius} {snr_db:4g} dB  '
        'fast {fast:.3f} [{fast_low:.3f}, {fast_high:.3f}]  '
        'slow {slow:.3f} [{slow_low:.3f}, {slow_high:.3f}]  empty {empty_rate:.4f}  '
        'time {time_ratio:.2f}, {time_ratio_256:.2f}'.format(**row))


def measure(
    depth: int, radius: int, snr_db: float, options: argparse.Namespace,
) -> dict[str, Any]:
    """Calibrate SDT, run it on frames with and without the object, and score it."""
    from lowsnr_common.core.measurement import SensorModel
    from lowsnr_detect.detectors.sdt import SDT
    from lowsnr_sensor.scenario import load_scenario

    scenario = load_scenario(ROOT / 'config' / 'scenarios' / 'example5.yaml')
    sensor = SensorModel(snr_db=snr_db)
    detector, found = matched(
        SDT(sensor=sensor, max_iterations=depth, radius=radius), scenario.shape)
    places = declared(detector, scenario, sensor, options.runs, options.seed)[:2]
    hits = within_gate(*places).any(axis=-1)
    slow = hits[:, [k - 1 for k in SLOW]].mean(axis=1)
    last = scenario.objects[0].last_frame
    fast = hits[:, [k - 1 for k in range(FIRST + depth, last + 1) if k not in SLOW]].mean(axis=1)
    empty = empty_alarms(detector, scenario, options.runs, options.seed)
    return dict(zip(FIELDS, (
        depth, radius, snr_db, fast.mean(), *bootstrap(fast, options.seed), slow.mean(),
        *bootstrap(slow, options.seed), empty.mean(), found.threshold,
        *found.interval, None, None, options.runs, options.seed)))


def time_ratio(depth: int, side: int, frames: int, seed: int) -> float:
    """Return the time of a step with radius 2 over that with radius 1."""
    from lowsnr_detect.detectors.sdt import SDT
    import numpy as np

    rng = np.random.default_rng(seed)
    detectors = [SDT(max_iterations=depth, radius=radius, threshold=30.0) for radius in (1, 2)]
    memories = [detector.init((side, side)) for detector in detectors]
    spent = np.empty((frames, 2))
    for k in range(frames):
        frame = rng.standard_normal((side, side))
        for n, detector in enumerate(detectors):
            start = time.perf_counter()
            memories[n], _ = detector.step(memories[n], frame, rng)
            spent[k, n] = time.perf_counter() - start
    one, two = np.median(spent, axis=0)
    return float(two / one)


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
