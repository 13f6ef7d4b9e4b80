# SPDX-License-Identifier: Apache-2.0
"""
Print the table of what the tracker reaches: of its figures, their goals, and which it meets.

Each section prints its rows, and writes its figures into one JSON file.  The comparison with Stone
Soup needs the package ``stonesoup``; without it, this section is skipped and says so.
"""

import argparse
from collections.abc import Iterator
from collections.abc import Sequence
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

PARTICLES = (2000, 10_000)
EXACT_PARTICLES = (2000, 20_000)
HEADER = '| what | measured | goal | met |\n|---|---|---|---|'
SNR_DB, ITERATIONS = 9.0, 5
MODELS = {'PDA': '', 'JPDA': ' (one constant-velocity Kalman filter, on objects that turn)'}


def main() -> int:
    """Measure, print and write the figures; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False,
        epilog='example: python benchmarks/tracker_figures.py --runs 500 --seed 0')
    parser.add_argument('--runs', type=int, default=500, help='runs of filter and SDT (500)')
    parser.add_argument('--seed', type=int, default=0, help='root seed (0)')
    parser.add_argument('--only', nargs='+', choices=[*SECTIONS], default=[*SECTIONS])
    parser.add_argument('--processes', type=int, default=2, help='processes (2)')
    parser.add_argument('--out', type=Path, default=ROOT / 'results' / 'tracker_figures.json')
    options = parser.parse_args()
    # One thread each, because the processes share the cores and times are compared.
    os.environ |= {'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'}
    _environment.ensure(dev=True)
    figures: dict[str, Any] = {'runs': options.runs, 'seed': options.seed}
    print(HEADER, flush=True)
    with ProcessPoolExecutor(options.processes) as pool:
        for section in options.only:
            start = time.monotonic()
            measure, rows = SECTIONS[section]
            figures[section] = measure(pool, options.runs, options.seed)
            for row in rows(figures[section]):
                print(row, flush=True)
            print(f'{section}: {time.monotonic() - start:.0f} s', file=sys.stderr, flush=True)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(figures, indent=1) + '\n', encoding='utf-8')
    print(f'written to {options.out}', file=sys.stderr)
    return 0


def sdt(pool: ProcessPoolExecutor, runs: int, seed: int) -> dict[str, Any]:
    """Measure tracks on declarations of SDT."""
    from tracker_sdt import measure
    return measure(pool, runs, 2 * runs, seed, SNR_DB, ITERATIONS)


def consistency(pool: ProcessPoolExecutor, runs: int, seed: int) -> dict[str, Any]:
    """Measure the NEES of objects that appear as in the tracker's model."""
    import tracker_filter
    return {str(particles): tracker_filter.consistency(pool, runs, seed, particles)
            for particles in PARTICLES}


def exact(pool: ProcessPoolExecutor, runs: int, seed: int) -> dict[str, Any]:
    """Compare RMSE and mode probabilities with those of the exact Kalman mixture."""
    import numpy as np
    import tracker_filter
    from tracker_model import flat_likelihood_error
    return {
        **tracker_filter.against_exact(pool, runs, seed, EXACT_PARTICLES),
        'modes': tracker_filter.mode_probabilities(pool, max(runs // 10, 2), seed),
        'flat': flat_likelihood_error(100_000, 10, np.random.default_rng([seed, 7]))}


def stonesoup(pool: ProcessPoolExecutor, runs: int, seed: int) -> dict[str, Any] | None:
    """Compare with Stone Soup on the same detections."""
    if importlib.util.find_spec('stonesoup') is None:
        print('Stone Soup is not compared: the package stonesoup is missing', file=sys.stderr)
        return None
    import tracker_stonesoup as comparison
    # In processes of the pool, which have one thread; one after the other, as they are timed.
    few = max(runs // 5, 1)
    return {
        name: pool.submit(measure, count, seed).result()
        for name, measure, count in (
            ('alone', comparison.compare_alone, runs),
            ('PDA', comparison.against_particle_filter, few),
            ('JPDA', comparison.against_joint_pda, few))}


def speed(pool: ProcessPoolExecutor, runs: int, seed: int) -> dict[str, Any]:
    """Time many objects, and a particle and frame."""
    import tracker_speed
    return tracker_speed.measure(seed)


def row(what: str, measured: str, goal: str, met: bool) -> str:
    """Return a row of the table in Markdown."""
    return f'| {what} | {measured} | {goal} | {"yes" if met else "no"} |'


def between(figure: Sequence[float], form: str = '.3f') -> str:
    """Return a figure and its 95 % interval."""
    value, low, high = figure
    return f'{value:{form}} [{low:{form}}, {high:{form}}]'


def sdt_rows(found: dict[str, Any]) -> Iterator[str]:
    """Yield the rows of tracks behind SDT."""
    empty = between([100 * each for each in found['empty_frames_with_track']], '.2f')
    yield row(f'SDT at 9 dB, `s_m` 5, 0.1 false detections a frame, tracks in {empty} % of empty '
              'frames: frames 10 to 35 with a track within 1.5 cells', between(found['pd']),
              '0.92', found['pd'][0] >= 0.92)
    first = found['first']
    yield row('frames from the appearance to the first hit: median, 90 %',
              ', '.join(between(each, '.0f') for each in first), '3, 6',
              first[0][0] <= 3 and first[1][0] <= 6)
    after = found['after'][:3]
    yield row('track of the last frame still there in the 1st, 2nd, 3rd frame after the end',
              ', '.join(between(each, '.2f') for each in after), 'at most 0.80, 0.50, 0.25',
              all(each[0] <= goal for each, goal in zip(after, (0.8, 0.5, 0.25))))
    for key, what in (('existence', 'in runs with an object'),
                      ('existence_at_birth_density', 'in runs with and without, mixed as the '
                       'density of births says')):
        error = found[key]['largest']
        yield row(f'stated existence against truth, all tracks and frames, {what}: largest error '
                  'of ten bins', between(error), '0.05', error[0] <= 0.05)
    yield row('NEES of hits behind SDT, 4 if exact', between(found['nees'], '.2f'), '3.8 to 4.2',
              3.8 <= found['nees'][0] <= 4.2)


def consistency_rows(found: dict[str, Any]) -> Iterator[str]:
    """Yield the rows of the NEES on detections from the tracker's model."""
    for particles, result in found.items():
        yield row(f'NEES on Gaussian detections, {int(particles):,} particles, 4 if exact',
                  between(result['interval'], '.2f'), '3.8 to 4.2', 3.8 <= result['nees'] <= 4.2)
        yield row('its mean over the runs inside the 95 % chi-square bounds, in frames',
                  f'{result["chi_square"]:.2f}', '0.90', result['chi_square'] >= 0.9)


def exact_rows(found: dict[str, Any]) -> Iterator[str]:
    """Yield the rows of the comparison with the exact filter."""
    for particles, goal in zip(EXACT_PARTICLES, (5.0, 1.0)):
        excess = [[100 * each for each in part]
                  for part in found[str(particles)]['excess'].values()]
        yield row(
            f'RMSE above that of the exact mixture of Kalman filters [%], {particles:,} '
            'particles: position, velocity', ', '.join(between(each, '+.1f') for each in excess),
            f'{goal:g}', all(each[0] <= goal for each in excess))
    inside = found['modes']['inside_95']
    yield row(f'mode probabilities within 95 % of the Monte Carlo error of the exact ones, '
              f'{found["modes"]["sequences"]} sequences of {found["modes"]["frames"]} frames',
              f'{inside:.3f}', '0.95', inside >= 0.95)
    yield row("flat likelihood: modes stay at the chain's own, worst of 30 [standard errors]",
              f'{found["flat"]:.1f}', '4', found['flat'] <= 4)


def stonesoup_rows(found: dict[str, Any] | None) -> Iterator[str]:
    """Yield the rows of the comparison with Stone Soup, where its GOSPA is best."""
    if found is None:
        return
    alone = [found['alone'][name]['ratio'] for name in ('position', 'velocity')]
    yield row('RMSE over that of Stone Soup 1.9.1, PDA with its multi-model particle filter, one '
              'track, 10,000 particles: position, velocity',
              ', '.join(between(each, '.2f') for each in alone), '1',
              all(each[0] < 1 for each in alone))
    for name in ('PDA', 'JPDA'):
        pairs = found[name]['confirmed_after']
        count = min(pairs, key=lambda each: pairs[each]['gospa_m'][1])
        pair, faster = pairs[count], found[name]['median_ratio']
        yield row(
            f"against Stone Soup's {name}{MODELS[name]}, same detections, "
            f'{found[name]["runs"]} runs, at most its {pair["false"][1]:.2f} false tracks a frame '
            f'(confirmed after {count} detections, its best GOSPA): hits more; GOSPA, RMSE, over '
            'its own; its time over ours',
            f'{between(pair["pd_gain"], "+.3f")}; {between(pair["gospa_ratio"], ".2f")}, '
            f'{between(pair["rmse_ratio"], ".2f")}; {faster:.1f}', '0; 1, 1; 1',
            pair['pd_gain'][0] > 0 and max(
                pair['gospa_ratio'][0], pair['rmse_ratio'][0], 1 / faster) < 1)


def speed_rows(found: dict[str, Any]) -> Iterator[str]:
    """Yield the rows of times."""
    rate, low, high = found['frames_per_s']
    yield row(f'200 objects, 1024 x 1024 cells, {found["particles"]:,} particles a track: frames '
              f'a second (load of the host {found["load"]:.1f})',
              f'{rate:.0f} ({low:.0f} to {high:.0f})', '30', rate >= 30)
    for what, case in found.items():
        if what.startswith('PDA-MMPF'):
            yield row(f'{what.removeprefix("PDA-MMPF, ")}, 10,000 particles: ns a particle and '
                      f'frame (over {case["reference"]})',
                      f'{case["ns"]:.0f} ({case["ratio"]:.2f})', f'{case["goal_ns"]:.0f}',
                      case['ns'] <= case['goal_ns'])


SECTIONS = {
    'sdt': (sdt, sdt_rows), 'consistency': (consistency, consistency_rows),
    'stonesoup': (stonesoup, stonesoup_rows), 'speed': (speed, speed_rows),
    'exact': (exact, exact_rows)}


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
