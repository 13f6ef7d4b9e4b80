# SPDX-License-Identifier: Apache-2.0
"""
Six figures of one faint object, as Davey, Rutten and Cheung (2008) compare detectors by.

S. J. Davey, M. G. Rutten and B. Cheung, "A comparison of detection performance for several
track-before-detect algorithms", EURASIP Journal on Advances in Signal Processing 2008, 428036: one
blurred object with a peak SNR of 3, 6 or 12 dB, slow or fast, in frames of Gaussian noise.  The
figures are theirs by name:

- ``overall``: share of the objects that are hit in any frame;
- ``instantaneous``: share of the frames with the object in which it is hit;
- ``rms``: root mean square error of the position of hits [cells];
- ``false_tracks``: false tracks a run, that is, chains of declarations beside an object or without
  one, each within two gates of one in the frame before;
- ``false_length``: mean number of frames of a false track;
- ``frame_ms``: CPU time of a frame [ms].

Speeds, size and number of frames, point spread and the operating point are choices of this
benchmark: every detector has a declaration in 1 % of the empty frames.  Intervals are 95 %, by
bootstrap over runs.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
import math
from pathlib import Path
import sys
from typing import Any

from detector_runs import bootstrap
from detector_runs import build
from detector_runs import declared
from detector_runs import matched
from detector_runs import Method
from detector_runs import write_rows
from detector_table import METHODS

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'scripts'))

import _environment  # noqa: E402

PEAK_SNRS_DB = (3.0, 6.0, 12.0)
SPEEDS = {'slow': 0.25, 'fast': 1.0}  # [cells a frame]
BLUR_CELLS = 0.7
SHAPE, FRAMES, PRESENT = (20, 20), 30, (6, 20)
LABELS = (
    'cdt', 'sdt s_m=5', 'sdt s_m=8', 'cusum', 'tbd1', 'mmtbd1', 'tbd2', 'mmtbd2', 'hmm order 2',
    'hmm lag 3', 'pmf', 'bernoulli order 2')
FIELDS = (
    'method', 'peak_snr_db', 'speed', 'overall', 'overall_low', 'overall_high', 'instantaneous',
    'instantaneous_low', 'instantaneous_high', 'rms', 'false_tracks', 'false_length', 'frame_ms',
    'runs', 'calibration_runs', 'seed')


def main() -> int:
    """Compute, print and write the table; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False,
        epilog='example: python benchmarks/davey_table.py --runs 100')
    parser.add_argument('--runs', type=int, default=100, help='runs of each cell (100)')
    parser.add_argument(
        '--calibration-runs', type=int, default=1000, help='empty runs a threshold (1000)')
    parser.add_argument('--seed', type=int, default=0, help='root seed (0)')
    parser.add_argument(
        '--method', nargs='+', default=LABELS, metavar='LABEL',
        choices=[method.label for method in METHODS], help='rows of the table')
    parser.add_argument('--processes', type=int, default=2, help='processes (2)')
    parser.add_argument('--out', type=Path, default=ROOT / 'results' / 'davey_table.csv')
    options = parser.parse_args()
    _environment.ensure()
    chosen = [method for method in METHODS if method.label in options.method]
    tasks = [(method, peak_db, speed, options.runs, options.seed, options.calibration_runs)
             for peak_db in PEAK_SNRS_DB for speed in SPEEDS for method in chosen]
    with ProcessPoolExecutor(options.processes) as pool:
        write_rows(options.out, FIELDS, pool.map(measure, *zip(*tasks)), line)
    return 0


def line(row: dict[str, Any]) -> str:
    """Return a row as it is printed."""
    return (
        '{method:>17} {peak_snr_db:5g} dB {speed}  overall {overall:.2f} '
        '[{overall_low:.2f}, {overall_high:.2f}]  instantaneous {instantaneous:.3f} '
        '[{instantaneous_low:.3f}, {instantaneous_high:.3f}]  rms {rms:.2f}  '
        'false tracks {false_tracks:.2f} of {false_length:.1f} frames  '
        '{frame_ms:.2f} ms'.format(**row))


def measure(
    method: Method, peak_snr_db: float, speed: str, runs: int, seed: int,
    calibration_runs: int,
) -> dict[str, Any]:
    """Return the row of a method."""
    from lowsnr_common.core.measurement import SensorModel

    # Of the energy, whose ratio to that of the peak is pi b^2 for an object in mid-cell.
    snr_db = peak_snr_db + 10.0 * math.log10(math.pi * BLUR_CELLS**2)
    scenario, sensor = scene(snr_db, SPEEDS[speed]), SensorModel(
        snr_db=snr_db, blur_m=BLUR_CELLS)
    detector, _ = matched(
        build(method, sensor, scenario.objects[0].random), SHAPE, calibration_runs)
    truth, found, spent_s = declared(detector, scenario, sensor, runs, seed)
    scores = figures(truth, found)
    overall, instantaneous = scores['overall'], scores['instantaneous']
    return dict(zip(FIELDS, (
        method.label, peak_snr_db, speed, overall.mean(), *bootstrap(overall, seed),
        instantaneous.mean(), *bootstrap(instantaneous, seed), scores['rms'],
        scores['false_tracks'], scores['false_length'],
        1e3 * spent_s / (runs * scenario.frames), runs, calibration_runs, seed)))


def scene(snr_db: float, speed: float) -> Any:
    """Return a scenario of one object on a straight path."""
    from lowsnr_sensor.scenario import load_scenario

    scenario = load_scenario(ROOT / 'config' / 'scenarios' / 'random.yaml')
    (item,) = scenario.objects
    assert item.random is not None  # as the file has it
    motion = replace(
        item.random, turn_rates_deg_s=(0.0,), acceleration_density=1e-5,
        min_speed_mps=0.9 * speed, max_speed_mps=1.1 * speed)
    return replace(
        scenario, snr_db=snr_db, frames=FRAMES, rows=SHAPE[0], cols=SHAPE[1],
        objects=(replace(item, random=motion, first_frame=PRESENT[0], last_frame=PRESENT[1]),))


def figures(truth: Any, found: Any) -> dict[str, Any]:
    """
    Return the figures of runs; those that have intervals by run.

    The truth is (runs, K, 2), positions where there is an object and else NaN; the declarations
    are (runs, K, D, 2), NaN in slots that are not used.
    """
    from lowsnr_common.settings.node_settings import Evaluation
    import numpy as np

    gate = Evaluation().gate_m
    there = np.isfinite(truth[..., 0])
    away = np.linalg.norm(found - truth[:, :, None], axis=-1)
    nearest = np.min(np.where(np.isnan(away), np.inf, away), axis=-1)
    hit = nearest <= gate
    false = np.isfinite(found[..., 0]) & ~(away <= gate)
    lengths = [length for places, alarms in zip(found, false)
               for length in chain_lengths(places, alarms, 2.0 * gate)]
    return {
        'overall': hit.any(axis=1).astype(float),
        'instantaneous': hit.sum(axis=1) / there.sum(axis=1),
        'rms': float(np.sqrt(np.mean(nearest[hit]**2))) if hit.any() else math.nan,
        'false_tracks': len(lengths) / len(found),
        'false_length': float(np.mean(lengths)) if lengths else math.nan}


def chain_lengths(places: Any, alarms: Any, reach: float) -> list[int]:
    """
    Return the frames of each chain of false declarations of a run.

    A declaration continues the nearest chain that ended in the frame before within the reach;
    every chain is continued once.  The places are (K, D, 2), the alarms (K, D).
    """
    import numpy as np

    ended: list[int] = []
    open_chains: list[tuple[Any, int]] = []  # last place and number of frames
    for here, which in zip(places, alarms):
        going = []
        for place in here[which]:
            away = [np.linalg.norm(place - last) for last, _ in open_chains]
            if away and min(away) <= reach:
                _, length = open_chains.pop(int(np.argmin(away)))
                going.append((place, length + 1))
            else:
                going.append((place, 1))
        ended += [length for _, length in open_chains]
        open_chains = going
    return ended + [length for _, length in open_chains]


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
