# SPDX-License-Identifier: Apache-2.0
"""What the figures of tracked runs share: their options, and the runs in several processes."""

import argparse
from collections.abc import Callable
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
import os
from pathlib import Path
import sys
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'scripts'))

import _environment  # noqa: E402

# The figures of a run, by its scenario, detector, SNR [dB] and seed.
Measure = Callable[[str, str, float, int], dict[str, Any]]


def parser(
    description: str | None, scenario: str, detectors: list[str], snr_db: float, runs: int,
) -> argparse.ArgumentParser:
    """Return the parser of the options, with these defaults."""
    found = argparse.ArgumentParser(
        description=(description or '').strip().partition('\n')[0], allow_abbrev=False)
    found.add_argument('--scenario', default=scenario, help=f'({scenario})')
    found.add_argument(
        '--detector', nargs='+', default=detectors, help=f'({" ".join(detectors)})')
    found.add_argument(
        '--snr', type=float, nargs='+', default=[snr_db], help=f'[dB] ({snr_db:g})')
    found.add_argument('--runs', type=int, default=runs, help=f'runs of each ({runs})')
    found.add_argument('--seed', type=int, default=0, help='seed of the first run (0)')
    found.add_argument('--processes', type=int, default=2, help='processes (2)')
    return found


def measured(
    measure: Measure, options: argparse.Namespace,
) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """Yield a title, and the figures of all runs, for each detector and SNR."""
    _environment.ensure()
    os.environ |= {'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'}
    seeds = range(options.seed, options.seed + options.runs)
    for detector in options.detector:
        for snr_db in options.snr:
            with ProcessPoolExecutor(options.processes) as pool:
                found = list(pool.map(partial(measure, options.scenario, detector, snr_db), seeds))
            yield (f'{options.scenario}, {detector}, {snr_db:g} dB, {options.runs} runs, '
                   f'seed {options.seed}', found)
