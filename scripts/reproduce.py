"""Reproduce Section VI by Monte Carlo: figures, and a verdict on every claim."""

import argparse
import os
from pathlib import Path
import shlex
import sys
from typing import Any

from _arguments import INTERRUPTED
from _arguments import Parser
from _arguments import USAGE
import _environment

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / 'config'
DONE, FAILED = 0, 1


def parse_arguments(arguments: list[str]) -> argparse.Namespace:
    """Return the options; ``--help`` and errors end here."""
    parser = Parser(
        prog='reproduce.py', description=__doc__, allow_abbrev=False,
        epilog='example: python scripts/reproduce.py --example 3 --runs 100; exit code: 0 done, '
        '1 failed, 2 usage error, 130 after Ctrl-C (finished runs are kept, --resume goes on)')
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument('--example', type=int, metavar='N', help='example of the paper, 1 to 6')
    what.add_argument('--all', action='store_true', help='all examples')
    parser.add_argument('--runs', type=int, default=100, metavar='R',
                        help='Monte Carlo runs at each SNR (default: 100)')
    parser.add_argument('--snr', type=float, nargs='+', metavar='DB',
                        help="SNRs [dB] (default: the paper's)")
    parser.add_argument('--detectors', nargs='+', metavar='NAME', help='(default: all)')
    parser.add_argument('--seed', type=int, default=0, metavar='N', help='(default: 0)')
    where = parser.add_mutually_exclusive_group()
    where.add_argument('--jobs', type=int, metavar='J',
                       help='processes to run on (default: one for each core)')
    where.add_argument('--scheduler', metavar='ADDRESS',
                       help='address of a dask scheduler to run on, HOST:PORT')
    parser.add_argument('--results', type=Path, default=ROOT / 'results', metavar='DIR',
                        help='folder for the folders exampleN (default: results)')
    parser.add_argument('--resume', action='store_true', help='go on with an earlier start')
    return parser.parse_args(arguments)


def main() -> int:
    """Run; return the exit code."""
    _environment.ensure()
    options = parse_arguments(sys.argv[1:])
    from lowsnr_eval.study.study_folder import check_folder
    from lowsnr_eval.study.workers import workers
    try:
        check(options)
        studies = plan(options)
        for study in studies:
            check_folder(options.results / study.example.scenario, study, options.resume)
        jobs = options.jobs or len(os.sched_getaffinity(0))
        with workers(jobs, options.scheduler) as client:
            return run(client, studies, options)
    except ValueError as error:
        print(f'reproduce.py: {error}', file=sys.stderr)
        return USAGE


def check(options: argparse.Namespace) -> None:
    """Refuse numbers that no study can have."""
    for name, least in (('jobs', 1), ('seed', 0)):
        value = getattr(options, name)
        if value is not None and value < least:
            raise ValueError(f'--{name} {value}: must be at least {least}')


def plan(options: argparse.Namespace) -> list[Any]:
    """Return the studies that the options ask for, all checked."""
    from lowsnr_eval.study.examples import EXAMPLES
    from lowsnr_eval.study.study import plan_study
    from lowsnr_eval.study.study_options import StudyOptions
    return [
        plan_study(StudyOptions(
            example=number, runs=options.runs, seed=options.seed,
            snrs_db=tuple(sorted(set(options.snr))) if options.snr else None,
            detectors=tuple(options.detectors) if options.detectors else None), CONFIG)
        for number in (EXAMPLES if options.all else [options.example])]


def run(client: Any, studies: list[Any], options: argparse.Namespace) -> int:
    """Run the studies one after the other, and write what came out of each."""
    from lowsnr_eval.report.claims_table import claims_markdown
    from lowsnr_eval.study.progress import Bar
    from lowsnr_eval.study.reproduction import calibrate_all
    from lowsnr_eval.study.study_folder import open_folder
    folders = [open_folder(options.results / study.example.scenario, study, options.resume)
               for study in studies]
    claims: list[Any] = []
    status = DONE
    try:
        with Bar() as bar:
            thresholds = calibrate_all(client, studies, bar)
        for study, folder in zip(studies, folders):
            status = run_one(client, study, thresholds, folder, claims)
            if status != DONE:
                break
    except KeyboardInterrupt:
        status = INTERRUPTED
    if claims:
        table = claims_markdown(claims)
        print(table)
        if options.all:
            (options.results / 'claims.md').write_text(table, encoding='utf-8')
    if status == INTERRUPTED:
        print('reproduce.py: interrupted; finished runs are kept, --resume goes on',
              file=sys.stderr)
    return status


def run_one(
    client: Any, study: Any, thresholds: Any, folder: Any, claims: list[Any],
) -> int:
    """Run a study and write what came out of it, also after Ctrl-C; return the exit code."""
    from distributed import KilledWorker
    from lowsnr_eval.report.study_report import write_study
    from lowsnr_eval.study.progress import Bar
    from lowsnr_eval.study.reproduction import collect
    from lowsnr_eval.study.reproduction import draw_all
    from lowsnr_eval.study.reproduction import run_study
    from lowsnr_eval.study.reproduction import thresholds_by_name
    status = DONE
    try:
        with Bar() as bar:
            run_study(client, study, thresholds, folder, bar)
    except KeyboardInterrupt:
        status = INTERRUPTED
    except KilledWorker as error:
        print(f'reproduce.py: {str(error).splitlines()[0]}', file=sys.stderr)
        status = FAILED
    outcome = collect(study, thresholds, folder)
    if outcome.runs_done:
        command = shlex.join(['python', 'scripts/reproduce.py', *sys.argv[1:]])
        claims += write_study(
            outcome, thresholds_by_name(study, thresholds), folder.path, command,
            lambda plan: draw_all(client, plan))
        print(f'results in {folder.path}')
    return status


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
