# SPDX-License-Identifier: Apache-2.0
"""
Measure every row of the table of performance, and print it beside its goal.

Times of the graph are those of a clock on this machine, where other work makes them longer.
Times of kernels are the median processor time of one thread; a kernel and its reference are timed
in turn, so that both meet the same disturbances of a shared machine.
"""

import argparse
import json
import os
from pathlib import Path
import sys
from typing import TYPE_CHECKING

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / 'scripts'), str(ROOT / 'test' / 'support')]

import _environment  # noqa: E402

if TYPE_CHECKING:
    from rows.row import Measurement

HEADER = '| what | measured | goal | met |\n|---|---|---|---|'


def main() -> int:
    """Measure and print the rows; return 1 where one could not be measured."""
    options = parse_arguments()
    _environment.ensure(dev=True)
    chosen = [each for each in measurements(options.seconds, options.rounds)
              if options.only.lower() in each.what.lower()]
    if not chosen:
        print(f'--only {options.only}: no row has this in its name; --list prints all names',
              file=sys.stderr)
        return 2
    if options.list:
        print('\n'.join(each.what for each in chosen))
        return 0
    from graph_runs import enter_own_domain
    enter_own_domain()
    rows, missing = [], 0
    print(HEADER, flush=True)
    for each in chosen:
        row, measured = each.row()
        rows.append(row)
        missing += not measured
        print(row.line(), flush=True)
    print(f'\n{len(rows)} rows, {sum(row.met is True for row in rows)} meet their goal, '
          f'{sum(row.met is False for row in rows)} miss it, {missing} not measured; '
          f'load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores')
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / 'table.json').write_text(
            json.dumps([row._asdict() for row in rows], indent=1), encoding='utf-8')
        (options.out / 'table.md').write_text(
            '\n'.join([HEADER, *(row.line() for row in rows), '']), encoding='utf-8')
    return int(missing > 0)


def parse_arguments() -> argparse.Namespace:
    """Return the options."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
        epilog='example: python benchmarks/table.py --only SDT --out results/table; exit code: 0 '
        'all rows measured, whether they meet their goals or not, 1 some could not be, which says '
        'why, 2 no such row')
    parser.add_argument('--only', default='', help='rows whose name contains this')
    parser.add_argument('--list', action='store_true', help='print the names of the rows alone')
    parser.add_argument('--out', type=Path, help='write table.md and table.json to this folder')
    parser.add_argument(
        '--seconds', type=float, default=2.0, help='least time for each kernel [s] (2)')
    parser.add_argument(
        '--rounds', type=int, default=7, help='least number of rounds for each kernel (7)')
    return parser.parse_args()


def measurements(seconds: float, rounds: int) -> list['Measurement']:
    """Return all rows before they are measured, with the options of the kernels."""
    from rows import calibration_rows
    from rows import camera_rows
    from rows import chain_rows
    from rows import graph_rows
    from rows import host_rows
    from rows import kernel_rows

    return [
        *graph_rows.measurements(), *chain_rows.measurements(), *camera_rows.measurements(),
        *host_rows.measurements(), *calibration_rows.measurements(),
        *kernel_rows.measurements(seconds, rounds)]


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
