# SPDX-License-Identifier: Apache-2.0
"""
P_D of a detector for an object that is fainter or brighter than its design SNR.

SDT, CUSUM and HMM are designed for one SNR.  Each is calibrated to 1 % of empty frames with a
declaration at its design SNR, and run with that threshold on objects 3 dB below, at, and 3 dB
above it, and compared with the detector that is designed for the SNR of the object.
Scenario, scored frames and intervals are those of detector_table.py.
"""

import argparse
from pathlib import Path
import sys
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / 'scripts'), str(ROOT / 'benchmarks')]

import _environment  # noqa: E402
from detector_runs import build  # noqa: E402
from detector_runs import matched  # noqa: E402
from detector_runs import with_interval  # noqa: E402
from detector_table import METHODS  # noqa: E402
from detector_table import run_scores  # noqa: E402

LABELS = ('sdt s_m=5', 'cusum', 'hmm order 2')
DESIGNS_DB = (6.0, 9.0)
OFFSETS_DB = (-3.0, 0.0, 3.0)


def main() -> int:
    """Measure and print the table as Markdown; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False,
        epilog='example: python benchmarks/unknown_intensity.py --runs 200')
    parser.add_argument('--runs', type=int, default=200, help='runs with an object (200)')
    parser.add_argument('--seed', type=int, default=0, help='root seed (0)')
    parser.add_argument('--only', nargs='+', choices=LABELS, default=LABELS)
    options = parser.parse_args()
    _environment.ensure()
    print(f'P_D at 1 % false alarms a frame, {options.runs} runs, seed {options.seed}\n')
    print('| detector | designed for | object | P_D [95 %] | P_D designed for the object | '
          'difference [95 %] |\n|---|---|---|---|---|---|')
    for label in options.only:
        method = next(method for method in METHODS if method.label == label)
        for design in DESIGNS_DB:
            for offset in OFFSETS_DB:
                found, own = (
                    hits(method, snr, design + offset, options.runs, options.seed)
                    for snr in (design, design + offset))
                print(f'| {label} | {design:g} dB | {design + offset:g} dB | '
                      f'{with_interval(found, options.seed, 3)} | {own.mean():.3f} | '
                      f'{with_interval(found - own, options.seed, 3)} |', flush=True)
    return 0


def hits(method: Any, design_db: float, object_db: float, runs: int, seed: int) -> Any:
    """Return the fraction of scored frames with a hit, for each run; paired over the designs."""
    from lowsnr_common.core.measurement import SensorModel
    from lowsnr_sensor.scenario import load_scenario

    scenario = load_scenario(ROOT / 'config' / 'scenarios' / 'random.yaml')
    detector, _ = matched(
        build(method, SensorModel(snr_db=design_db), scenario.objects[0].random), scenario.shape)
    scores, _ = run_scores(detector, scenario, SensorModel(snr_db=object_db), runs, seed)
    return scores[:, 0]


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
