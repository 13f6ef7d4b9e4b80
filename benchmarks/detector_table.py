# SPDX-License-Identifier: Apache-2.0
"""
Table of P_D against SNR for all detectors at the same false-alarm probability.

Objects move at random as in config/scenarios/random.yaml, and detectors with a motion model have
that motion.  P_D is the fraction of frames 10 to 35, in which the object is there for at least
five, with a declaration within the gate; every detector is calibrated to the same fraction of
empty frames with any declaration.  Intervals are 95 %, by bootstrap over whole runs.

P_D does not show everything: ``beside`` are the declarations outside the gate, a frame with the
object, ``ghosts`` the share of the five frames after its end with a declaration, ``delay`` the
frames from its appearance to the first hit (those to its end where there is none), ``gospa`` the
mean GOSPA metric of all frames, with the gate as its cutoff, and ``frame_ms`` CPU time.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from statistics import NormalDist
import sys
from typing import Any
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lowsnr_detect.calibration.curve import Calibration
    from lowsnr_detect.parts.detector import Detector

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

FRAMES = slice(9, 35)
PRESENT, AFTER = slice(4, 35), slice(35, 40)
SNRS_DB = (1.0, 3.0, 6.0, 7.6, 9.0, 12.0, 15.0)
WANTED = 0.9
FIELDS = (
    'method', 'snr_db', 'pd', 'pd_low', 'pd_high', 'empty_rate', 'empty_low', 'empty_high',
    'threshold', 'threshold_low', 'threshold_high', 'beside', 'ghosts', 'delay', 'gospa',
    'frame_ms', 'runs', 'calibration_runs', 'seed')
FIGURES = ('pd', 'beside', 'ghosts', 'delay', 'gospa')
METHODS = (
    Method('cdt', 'cdt'),
    *(Method(f'sdt s_m={most}', 'sdt', {'max_iterations': most}) for most in (3, 5, 8)),
    Method('sdt s_m=8 prior', 'sdt', {'max_iterations': 8, 'move_prior': True}),
    Method('cusum', 'cusum'),
    Method('tbd1', 'tbd1'),
    Method('mmtbd1', 'mmtbd1'),
    Method('tbd2', 'tbd2'),
    Method('mmtbd2', 'mmtbd2'),
    *(Method(f'hmm order {order}', 'hmm', {'order': order}) for order in (0, 1, 2)),
    *(Method(f'hmm lag {lag}', 'hmm', {'lag': lag}) for lag in (3, 10)),
    Method('pmf', 'pmf'),
    *(Method(f'pmf lag {lag}', 'pmf', {'lag': lag}) for lag in (3, 10)),
    *(Method(f'bernoulli order {order}', 'bernoulli', {'order': order}) for order in (1, 2)),
    *(Method(f'bernoulli lag {lag}', 'bernoulli', {'lag': lag}) for lag in (3, 10)),
)


def main() -> int:
    """Compute, print and write the table; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False,
        epilog='example: python benchmarks/detector_table.py --runs 500')
    parser.add_argument('--runs', type=int, default=500, help='runs with an object (500)')
    parser.add_argument(
        '--calibration-runs', type=int, default=1000, help='empty runs a threshold (1000)')
    parser.add_argument('--seed', type=int, default=0, help='root seed (0)')
    parser.add_argument('--snr', type=float, nargs='+', default=SNRS_DB, metavar='DB')
    parser.add_argument(
        '--method', nargs='+', default=[m.label for m in METHODS], metavar='LABEL',
        choices=[m.label for m in METHODS], help='rows of the table (all)')
    parser.add_argument('--processes', type=int, default=2, help='processes (2)')
    parser.add_argument('--out', type=Path, default=ROOT / 'results' / 'detector_table.csv')
    options = parser.parse_args()
    _environment.ensure()
    chosen = [method for method in METHODS if method.label in options.method]
    tasks = [(m, snr, options.runs, options.seed, options.calibration_runs)
             for snr in options.snr for m in chosen]
    with ProcessPoolExecutor(options.processes) as pool:
        rows = write_rows(options.out, FIELDS, pool.map(measure, *zip(*tasks)), line)
    print_table(rows, chosen, options.snr)
    return 0


def line(row: dict[str, Any]) -> str:
    """Return a row as it is printed."""
    return (
        '{method:>16} {snr_db:5g} dB  P_D {pd:.3f} [{pd_low:.3f}, {pd_high:.3f}]  '
        'empty {empty_rate:.4f} [{empty_low:.4f}, {empty_high:.4f}]  '
        'threshold {threshold:.2f}  beside {beside:.3f}  ghosts {ghosts:.2f}  '
        'delay {delay:.1f}  gospa {gospa:.3f}  {frame_ms:.2f} ms'.format(**row))


def measure(
    method: Method, snr_db: float, runs: int, seed: int, calibration_runs: int,
) -> dict[str, Any]:
    """Return the row of a method."""
    scores, alarms, found, frame_ms = scored(method, snr_db, runs, seed, calibration_runs)
    pd, *others = scores.mean(axis=0)
    return dict(zip(FIELDS, (
        method.label, snr_db, pd, *bootstrap(scores[:, 0], seed), alarms.mean(),
        *bootstrap(alarms, seed), found.threshold, *found.interval, *others, frame_ms, runs,
        calibration_runs, seed)))


def scored(
    method: Method, snr_db: float, runs: int, seed: int, calibration_runs: int,
) -> tuple[Any, Any, 'Calibration', float]:
    """
    Calibrate a method, and run it on frames with and without an object.

    Returns the figures of each run (runs, figures), the share of empty frames with a declaration
    (runs,), the calibration, and the CPU time of a frame [ms].
    """
    from lowsnr_common.core.measurement import SensorModel
    from lowsnr_sensor.scenario import load_scenario

    scenario = load_scenario(ROOT / 'config' / 'scenarios' / 'random.yaml')
    sensor = SensorModel(snr_db=snr_db)
    detector, found = matched(
        build(method, sensor, scenario.objects[0].random), scenario.shape, calibration_runs)
    scores, spent_s = run_scores(detector, scenario, sensor, runs, seed)
    alarms = empty_alarms(detector, scenario, runs, seed)
    return scores, alarms, found, 1e3 * spent_s / (runs * scenario.frames)


def run_scores(
    detector: 'Detector', scenario: Any, sensor: Any, runs: int, seed: int,
) -> tuple[Any, float]:
    """Return the figures of each run (runs, figures), and the time of detection [s]."""
    truth, found, spent_s = declared(detector, scenario, sensor, runs, seed)
    return figures(truth, found), spent_s


def figures(truth: Any, found: Any) -> Any:
    """
    Return P_D, beside, ghosts, delay and GOSPA of each run, (runs, figures).

    The truth is (runs, K, 2), positions where there is an object and else NaN; the declarations
    are (runs, K, D, 2), NaN in slots that are not used.
    """
    from lowsnr_common.settings.node_settings import Evaluation
    from lowsnr_eval.scoring.metrics import distances
    from lowsnr_eval.scoring.metrics import gospa
    import numpy as np

    gate = Evaluation().gate_m
    used = np.isfinite(found[..., 0])
    near = within_gate(truth, found)
    hit = near.any(axis=-1)
    there = np.isfinite(truth[:, :, None, 0])
    beside = np.sum(used & there & ~near, axis=-1)[:, PRESENT].mean(axis=1)
    ghosts = used.any(axis=-1)[:, AFTER].mean(axis=1)
    while_there = hit[:, PRESENT]
    delay = np.where(
        while_there.any(axis=1), while_there.argmax(axis=1), while_there.shape[1])
    cost = [
        np.mean([gospa(distances(here[np.isfinite(here[:, 0])], there[present]), gate)
                 for here, there, present in zip(true[:, None], states, slots)])
        for true, states, slots in zip(truth, found, used)]
    return np.stack([hit[:, FRAMES].mean(axis=1), beside, ghosts, delay, cost], axis=1)


def print_table(rows: list[dict[str, Any]], methods: list[Method], snrs: list[float]) -> None:
    """Print P_D by method and SNR, and the SNR at which it reaches 0.9."""
    print(f'\n{"P_D":>16}' + ''.join(f'{snr:>7g}' for snr in snrs) + f'{"dB for 0.9":>12}')
    for method in methods:
        own = [row['pd'] for row in rows if row['method'] == method.label]
        needed = reaches(list(snrs), own)
        print(f'{method.label:>16}' + ''.join(f'{pd:7.3f}' for pd in own)
              + (f'{needed:12.1f}' if needed is not None else f'{"-":>12}'))


def reaches(snrs: list[float], probs: list[float]) -> float | None:
    """
    Interpolate the SNR at which P_D reaches 0.9; None where it does not.

    The normal quantile of P_D is nearly straight between two SNRs, P_D itself is not.
    """
    wanted, *own = (
        NormalDist().inv_cdf(min(max(prob, 1e-4), 1.0 - 1e-4)) for prob in (WANTED, *probs))
    for k in range(1, len(snrs)):
        if own[k - 1] < wanted <= own[k]:
            weight = (wanted - own[k - 1]) / (own[k] - own[k - 1])
            return snrs[k - 1] + weight * (snrs[k] - snrs[k - 1])
    return None


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
