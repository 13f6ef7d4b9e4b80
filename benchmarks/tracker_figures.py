# SPDX-License-Identifier: Apache-2.0
"""
Measure the tracker: consistency, errors against an exact filter, Stone Soup, SDT.

Each section prints its figures and their goals, and writes them into one JSON file.  The
comparison with Stone Soup needs the package ``stonesoup``; without it, this section is skipped and
says so.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
import importlib.util
import json
import os
from pathlib import Path
import sys
import time
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / 'scripts'), str(ROOT / 'test')]

import _environment  # noqa: E402

SECTIONS = ('consistency', 'modes', 'exact', 'flat', 'stonesoup', 'sdt')
PARTICLES = (2000, 10_000)
EXACT_PARTICLES = (2000, 20_000)


def main() -> int:
    """Measure, print and write the figures; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False,
        epilog='example: python benchmarks/tracker_figures.py --runs 500 --seed 0')
    parser.add_argument('--runs', type=int, default=500, help='runs of filter and SDT (500)')
    parser.add_argument('--seed', type=int, default=0, help='root seed (0)')
    parser.add_argument('--only', nargs='+', choices=SECTIONS, default=SECTIONS)
    parser.add_argument('--processes', type=int, default=2, help='processes (2)')
    parser.add_argument('--out', type=Path, default=ROOT / 'results' / 'tracker_figures.json')
    options = parser.parse_args()
    _environment.ensure()
    # One thread each, because the processes share the cores and times are compared.
    os.environ |= {'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'}
    figures: dict[str, Any] = {'runs': options.runs, 'seed': options.seed}
    with ProcessPoolExecutor(options.processes) as pool:
        for section in options.only:
            start = time.monotonic()
            figures[section] = globals()[section](pool, options.runs, options.seed)
            print(f'  {section}: {time.monotonic() - start:.0f} s', flush=True)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(figures, indent=1) + '\n', encoding='utf-8')
    print(f'written to {options.out}')
    return 0


def show(what: str, value: str, goal: str = '') -> None:
    """Print one line of the table."""
    print(f'{what:<58} {value:<34} {goal}', flush=True)


def consistency(pool: ProcessPoolExecutor, runs: int, seed: int) -> dict[str, Any]:
    """Measure the NEES of objects that appear as in the tracker's model."""
    import tracker_filter

    found = {}
    for particles in PARTICLES:
        result = found[str(particles)] = tracker_filter.consistency(pool, runs, seed, particles)
        show(f'frames with NEES inside 95 % chi-square, {particles} particles',
             f'{result["chi_square"]:.2f}, mean NEES {result["nees"]:.2f}', '0.90')
        show('    inside the spread of the runs', f'{result["sample"]:.2f}', '0.95 if exact')
    return found


def modes(pool: ProcessPoolExecutor, runs: int, seed: int) -> dict[str, Any]:
    """Compare mode probabilities with the exact filter on short sequences."""
    import tracker_filter

    result = tracker_filter.mode_probabilities(pool, max(runs // 10, 2), seed)
    show('mode probabilities inside 95 % of Monte Carlo error',
         '{:.3f}'.format(result['inside_95']), '0.95')
    show('    its standard deviation; rms error of the mean of 10 filters',
         '{monte_carlo_std:.4f}, {rms_error_of_mean:.4f}'.format(**result))
    return result


def exact(pool: ProcessPoolExecutor, runs: int, seed: int) -> dict[str, Any]:
    """Compare the RMSE with that of the exact Kalman mixture."""
    import tracker_filter

    result = tracker_filter.against_exact(pool, runs, seed, EXACT_PARTICLES)
    show('exact Kalman mixture: RMSE of position, velocity',
         '{position:.4f} m, {velocity:.4f} m/s'.format(**result['exact']))
    show('    its NEES inside 95 % chi-square', f'{result["exact"]["chi_square"]:.2f}')
    for particles, goal in zip(EXACT_PARTICLES, ('5 %', '1 %')):
        for name, (value, low, high) in result[str(particles)]['excess'].items():
            show(f'RMSE of {name} above it, {particles} particles',
                 f'{100 * value:+.2f} % [{100 * low:+.2f}, {100 * high:+.2f}]', goal)
    return result


def flat(pool: ProcessPoolExecutor, runs: int, seed: int) -> dict[str, Any]:
    """Compare mode probabilities without any detection with the Markov chain."""
    import numpy as np
    from tracker_model import flat_likelihood_error

    worst = flat_likelihood_error(100_000, 10, np.random.default_rng([seed, 7]))
    show('flat likelihood: modes from the chain, worst of 30', f'{worst:.1f} standard errors', '4')
    return {'standard_errors': worst}


def stonesoup(pool: ProcessPoolExecutor, runs: int, seed: int) -> dict[str, Any] | None:
    """Compare with Stone Soup on the same detections."""
    if importlib.util.find_spec('stonesoup') is None:
        show('Stone Soup', 'not measured: the package stonesoup is missing')
        return None
    from tracker_stonesoup import compare
    from tracker_stonesoup import compare_alone

    # In a process of the pool, which has one thread.
    alone = pool.submit(compare_alone, runs, seed, 10_000).result()
    for name in ('position', 'velocity'):
        value, low, high = alone[name]['ratio']
        show(f'Stone Soup, one track: RMSE of {name}, ours over theirs',
             f'{value:.3f} [{low:.3f}, {high:.3f}]', '1')
    result = pool.submit(compare, max(runs // 10, 1), seed, 10_000).result()
    for count, both in result['confirmed_after'].items():
        for name, line in both.items():
            show(f'    {name}, theirs confirmed after {count} detections',
                 'P_D {pd:.3f}, false {false_tracks:.3f}, RMSE {rmse_m:.3f}, nearest '
                 '{rmse_nearest_m:.3f}'.format(**line))
    show('    CPU time of a frame, median: ours, theirs, ratio',
         '{:.2f} ms, {:.2f} ms, {:.1f}'.format(*result['median_ms'], result['median_ratio']), '4')
    return {'alone': alone, 'tracker': result}


def sdt(pool: ProcessPoolExecutor, runs: int, seed: int) -> dict[str, Any]:
    """Measure tracks on declarations of SDT."""
    from tracker_sdt import measure

    result = measure(pool, runs, 2 * runs, seed, 9.0, 5)
    for key, what, goal in (
            ('pd', 'SDT 9 dB, s_m = 5: frames 10 to 35 with a track', '0.85'),
            ('empty_frames_with_track', '    empty frames with a track', '0.01'),
            ('false_tracks', '    false tracks a frame while the object is present', ''),
            ('false_after', '    frames 36 to 40 with a track', '')):
        value, low, high = result[key]
        show(what, f'{value:.4f} [{low:.4f}, {high:.4f}]', goal)
    return result


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
