# SPDX-License-Identifier: Apache-2.0
"""
Table of what joint decision and estimation gains over existence and mean, on the same frames.

Objects move at random as in config/scenarios/random.yaml, and detectors have that motion.  Every
rule of every detector is calibrated to the same fraction of empty frames with any declaration.
The figures are those of detector_table.py; a change is the mean of a rule less that of existence
over the mean of existence, in per cent.  Intervals are 95 %, by bootstrap over whole runs, drawn
together for both.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
import sys
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'scripts'))

import _environment  # noqa: E402
from detector_runs import bootstrap  # noqa: E402
from detector_runs import BOOTSTRAPS  # noqa: E402
from detector_runs import Method  # noqa: E402
from detector_runs import write_rows  # noqa: E402
from detector_table import FIGURES  # noqa: E402
from detector_table import scored  # noqa: E402

SNRS_DB = (3.0, 6.0)
METHODS = (
    Method('hmm order 1', 'hmm', {'order': 1}),
    Method('hmm order 2', 'hmm'),
    Method('pmf', 'pmf'),
    Method('mmtbd2', 'mmtbd2'),
    Method('bernoulli order 1', 'bernoulli'),
)
RULES: dict[str, dict[str, Any]] = {
    'existence': {},
    'gospa': {'decision.rule': 'gospa'},
    'gospa, wait .5': {'decision.rule': 'gospa', 'decision.wait_cost': 0.5},
    'hit': {'decision.rule': 'hit'},
}
CHANGES = tuple(f'{figure}_{part}' for figure in FIGURES for part in ('change', 'low', 'high'))
FIELDS = (
    'method', 'snr_db', 'rule', *FIGURES, *CHANGES, 'empty_rate', 'empty_low', 'empty_high',
    'threshold', 'frame_ms', 'runs', 'calibration_runs', 'seed')


def main() -> int:
    """Compute, print and write the table; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False,
        epilog='example: python benchmarks/decision_table.py --runs 200')
    parser.add_argument('--runs', type=int, default=200, help='runs with an object (200)')
    parser.add_argument(
        '--calibration-runs', type=int, default=1000, help='empty runs a threshold (1000)')
    parser.add_argument('--seed', type=int, default=0, help='root seed (0)')
    parser.add_argument('--snr', type=float, nargs='+', default=SNRS_DB, metavar='DB')
    labels = [method.label for method in METHODS]
    parser.add_argument('--method', nargs='+', default=labels, metavar='LABEL', choices=labels)
    parser.add_argument('--out', type=Path, default=ROOT / 'results' / 'decision_table.csv')
    options = parser.parse_args()
    _environment.ensure()
    write_rows(options.out, FIELDS, (
        row for method in METHODS if method.label in options.method for snr_db in options.snr
        for row in measure(
            method, snr_db, options.runs, options.seed, options.calibration_runs)), line)
    return 0


def measure(
    method: Method, snr_db: float, runs: int, seed: int, calibration_runs: int,
) -> Iterator[dict[str, Any]]:
    """Yield a row for every rule of a method."""
    base: Any = None
    for rule, settings in RULES.items():
        ruled = Method(method.label, method.detector, method.settings | settings)
        scores, alarms, found, frame_ms = scored(ruled, snr_db, runs, seed, calibration_runs)
        base = scores if base is None else base
        low, high = bootstrap(alarms, seed)
        yield {
            'method': method.label, 'snr_db': snr_db, 'rule': rule,
            **dict(zip(FIGURES, scores.mean(axis=0))),
            **dict(zip(CHANGES, changes(scores, base, seed))), 'empty_rate': alarms.mean(),
            'empty_low': low, 'empty_high': high, 'threshold': found.threshold,
            'frame_ms': frame_ms, 'runs': runs, 'calibration_runs': calibration_runs,
            'seed': seed}


def changes(scores: Any, base: Any, seed: int) -> list[float]:
    """Return change and interval of every figure [per cent], (3 figures)."""
    import numpy as np

    draws = np.random.default_rng(seed).integers(len(base), size=(BOOTSTRAPS, len(base)))
    drawn = 100.0 * (scores[draws].mean(axis=1) / base[draws].mean(axis=1) - 1.0)
    value = 100.0 * (scores.mean(axis=0) / base.mean(axis=0) - 1.0)
    return np.stack([value, *np.quantile(drawn, (0.025, 0.975), axis=0)], axis=1).ravel().tolist()


def line(row: dict[str, Any]) -> str:
    """Return a row as it is printed."""
    figures = '  '.join(
        f'{figure} {row[figure]:.3f} ({row[f"{figure}_change"]:+.1f} '
        f'[{row[f"{figure}_low"]:+.1f}, {row[f"{figure}_high"]:+.1f}])' for figure in FIGURES)
    return (
        '{method:>18} {snr_db:g} dB {rule:>14}  '.format(**row) + figures
        + '  empty {empty_rate:.4f} [{empty_low:.4f}, {empty_high:.4f}]'
          '  {frame_ms:.2f} ms'.format(**row))


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
