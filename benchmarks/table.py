# SPDX-License-Identifier: Apache-2.0
"""
Write a table of the times of detectors and filters, as ratios to the times of references.

Every figure is the median CPU time of one thread.  Subject and reference are timed in turn, so
that both meet the same disturbances of a shared machine.
"""

import argparse
import json
from pathlib import Path
import sys
from typing import Any
from typing import TYPE_CHECKING

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'scripts'))

import _environment  # noqa: E402

if TYPE_CHECKING:
    import kernels

HEADER = (
    '| what | size | time | a unit | reference | ratio | goal | met |\n'
    '|---|---|---|---|---|---|---|---|')


def main() -> int:
    """Time the cases and write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog='example: python benchmarks/table.py --only SDT --out results/kernels')
    parser.add_argument('--only', default='', help='time the cases whose name contains this')
    parser.add_argument('--out', type=Path, help='write table.md and table.json to this folder')
    parser.add_argument('--seconds', type=float, default=2.0, help='least time for each case [s]')
    parser.add_argument('--rounds', type=int, default=7,
                        help='least number of rounds for each case')
    given = parser.parse_args()
    _environment.ensure(dev=True)
    import kernels
    rows = []
    print(HEADER)
    for case in kernels.cases():
        if given.only in case.what:
            timing = kernels.timed(case, given.seconds, given.rounds)
            rows.append(figures(case, timing))
            print(line(rows[-1]), flush=True)
    if given.out:
        given.out.mkdir(parents=True, exist_ok=True)
        (given.out / 'table.json').write_text(json.dumps(rows, indent=1), encoding='utf-8')
        text = '\n'.join([HEADER, *(line(row) for row in rows)])
        (given.out / 'table.md').write_text(f'{text}\n', encoding='utf-8')
    return 0


def figures(case: 'kernels.Case', timing: 'kernels.Timing') -> dict[str, Any]:
    """Return the row of a case: its times, its ratio, and whether it meets its goal."""
    ratio, unit_ns = timing.subject / timing.reference, 1e9 * timing.subject / case.count
    goal, met = '', None
    if case.goal is not None:
        goal = f'{1 / case.goal:,.0f} times faster' if case.faster else f'ratio {case.goal:g}'
        met = ratio <= case.goal
    if case.goal_ns is not None:
        goal, met = f'{case.goal_ns:g} ns', unit_ns <= case.goal_ns
    return {
        'what': case.what, 'size': case.size, 'subject_s': timing.subject,
        'reference': case.reference, 'reference_s': timing.reference, 'ratio': ratio,
        'unit': case.unit, 'unit_ns': unit_ns, 'goal': goal, 'met': met}


def line(row: dict[str, Any]) -> str:
    """Return a row of the table in Markdown."""
    ratio = row['ratio']
    shown = f'{ratio:.2f}' if ratio > 0.1 else f'1 / {1 / ratio:,.0f}'
    met = {True: 'yes', False: 'no', None: ''}[row['met']]
    return (
        f"| {row['what']} | {row['size']} | {1e3 * row['subject_s']:.3g} ms "
        f"| {row['unit_ns']:.3g} ns/{row['unit']} | {row['reference']} | {shown} "
        f"| {row['goal']} | {met} |")


if __name__ == '__main__':
    sys.exit(main())
