# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""Reproduce Section VI by Monte Carlo: draw its figures and test every claim."""

import argparse
from collections.abc import Callable
import os
from pathlib import Path
import sys
from typing import Any
from typing import TYPE_CHECKING

from _arguments import command_line
from _arguments import CONFIG
from _arguments import detector_name
from _arguments import INTERRUPTED
from _arguments import number
from _arguments import Parser
from _arguments import RESULTS
from _arguments import SNR_DB
from _arguments import USAGE
import _environment

if TYPE_CHECKING:
    from lowsnr_eval.study.study import Study
    from lowsnr_eval.study.study import Thresholds
    from lowsnr_eval.study.study_folder import StudyFolder
    from lowsnr_eval.study.workers import TlsFiles
    from lowsnr_eval.study.workers import Workers

DONE, FAILED = 0, 1


def parse_arguments(arguments: list[str]) -> argparse.Namespace:
    """Return the options; ``--help`` and errors end here."""
    parser = Parser(
        prog='reproduce.py', description=__doc__,
        epilog='example: python scripts/reproduce.py --example 3 --runs 100; exit code: 0 done, '
        '1 failed, 2 usage error, 130 after Ctrl-C (finished runs are kept, --resume continues)')
    examples = parser.add_mutually_exclusive_group(required=True)
    examples.add_argument('--example', type=number(1, 6, whole=True), metavar='N',
                          help='example of the paper, 1 to 6')
    examples.add_argument('--all', action='store_true', help='all examples')
    parser.add_argument('--runs', type=number(1, whole=True), default=100, metavar='R',
                        help='Monte Carlo runs at each SNR (default: 100)')
    parser.add_argument('--snr', type=number(*SNR_DB), nargs='+', metavar='DB',
                        help="SNRs [dB] (default: the paper's)")
    parser.add_argument('--detector', nargs='+', type=detector_name, metavar='NAME',
                        dest='detectors', help='detectors to compare (default: all)')
    parser.add_argument('--seed', type=number(0, whole=True), default=0, metavar='N',
                        help='(default: 0)')
    where = parser.add_mutually_exclusive_group()
    where.add_argument('--jobs', type=number(1, whole=True), metavar='J',
                       help='number of local processes (default: one for each core)')
    where.add_argument('--scheduler', metavar='ADDRESS', help='run on the workers of this dask '
                       'scheduler, HOST:PORT; on another machine it needs TLS')
    for name, what in (('ca', 'certificate of the authority'), ('cert', 'own certificate'),
                       ('key', 'own key')):
        parser.add_argument(f'--tls-{name}', type=Path, metavar='PEM',
                            help=f'{what} for the connection to the scheduler')
    parser.add_argument('--results', type=Path, default=RESULTS, metavar='DIR',
                        help='folder for the folders exampleN (default: results)')
    parser.add_argument('--resume', action='store_true',
                        help='continue an interrupted study, with the same settings and code')
    return parser.parse_args(arguments)


def main() -> int:
    """Run the command; return the exit code."""
    parse_arguments(sys.argv[1:])  # which names what is wrong before anything is installed
    _environment.ensure(('study',))
    return reproduce(sys.argv[1:])


def reproduce(arguments: list[str]) -> int:
    """Reproduce what the arguments ask for; return the exit code."""
    options = parse_arguments(arguments)
    from lowsnr_eval.study.study_folder import check_folder
    from lowsnr_eval.study.workers import workers
    try:
        studies = plan(options)
        for study in studies:
            check_folder(options.results / study.example.scenario, study, options.resume)
        jobs = options.jobs or len(os.sched_getaffinity(0))
        with workers(jobs, options.scheduler, log, tls_files(options)) as found:
            command = command_line('reproduce', arguments)
            return run(found, studies, options, command)
    except ValueError as error:
        print(f'reproduce.py: {error}', file=sys.stderr)
        return USAGE
    except OSError as error:
        print(f'reproduce.py: {error.filename or options.results}: {error.strerror or error}; '
              'finished runs are kept, --resume continues', file=sys.stderr)
        return FAILED


def tls_files(options: argparse.Namespace) -> 'TlsFiles | None':
    """Return the files of the connection to a scheduler; None if there are none."""
    from lowsnr_eval.study.workers import TlsFiles
    files = TlsFiles(options.tls_ca, options.tls_cert, options.tls_key)
    if not any(files):
        return None
    if options.scheduler is None or not all(files):
        raise ValueError('--tls-ca, --tls-cert and --tls-key belong together, with --scheduler')
    return files


def log(text: str) -> None:
    """Print a line above the progress bar."""
    from tqdm import tqdm
    tqdm.write(f'reproduce.py: {text}', file=sys.stderr)


def plan(options: argparse.Namespace) -> 'list[Study]':
    """Return the studies that the options ask for, all checked."""
    from lowsnr_eval.study.examples import EXAMPLES
    from lowsnr_eval.study.study import StudyOptions
    from lowsnr_eval.study.study_plan import plan_study
    return [
        plan_study(StudyOptions(
            example=number, runs=options.runs, seed=options.seed,
            snrs_db=tuple(sorted(set(options.snr))) if options.snr else None,
            detectors=tuple(options.detectors) if options.detectors else None), CONFIG)
        for number in (EXAMPLES if options.all else [options.example])]


def run(
    workers: 'Workers', studies: 'list[Study]', options: argparse.Namespace, command: str,
) -> int:
    """Run the studies one after the other, and write the results of each."""
    from lowsnr_eval.report.study_report import claims_markdown
    from lowsnr_eval.study.reproduction import calibrate_all
    from lowsnr_eval.study.study_folder import open_folder
    folders = [open_folder(options.results / study.example.scenario, study, options.resume, log)
               for study in studies]
    claims: list[dict[str, Any]] = []

    def run_all() -> int:
        thresholds = calibrate_all(workers, studies)
        for study, folder in zip(studies, folders):
            status, rows = run_one(workers, study, thresholds, folder, command)
            claims.extend(rows)
            if status != DONE:
                return status
        return DONE

    status = status_of(run_all)
    if claims:
        table = claims_markdown(claims)
        print(table)
        if options.all:
            (options.results / 'claims.md').write_text(table, encoding='utf-8')
    if status == INTERRUPTED:
        log('interrupted; finished runs are kept, --resume continues')
    return status


def run_one(
    workers: 'Workers', study: 'Study', thresholds: 'Thresholds', folder: 'StudyFolder',
    command: str,
) -> tuple[int, list[dict[str, Any]]]:
    """Run a study and write its results, also after Ctrl-C; return exit code and verdicts."""
    from lowsnr_eval.report.study_report import write_study
    from lowsnr_eval.study.reproduction import collect
    from lowsnr_eval.study.reproduction import run_study
    from lowsnr_eval.study.reproduction import thresholds_by_name
    status = status_of(lambda: run_study(workers, study, thresholds, folder))
    results = collect(study, thresholds, folder)
    if not results.runs_done:
        return status, []
    rows = write_study(
        results, thresholds_by_name(study, thresholds), folder.path, command, workers)
    print(f'results in {folder.path}')
    return status, rows


def status_of(work: Callable[[], int | None]) -> int:
    """Do work; return its exit code, or that of Ctrl-C or of a worker that died."""
    from lowsnr_eval.study.workers import WorkerDiedError
    try:
        return work() or DONE
    except KeyboardInterrupt:
        return INTERRUPTED
    except WorkerDiedError as error:
        log(str(error))
        return FAILED


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
