# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK
"""Score a recorded run against its truth, or complete the results of a run that was killed."""

import argparse
from collections.abc import Iterator
from contextlib import closing
from contextlib import contextmanager
from dataclasses import replace
import json
import os
from pathlib import Path
import sys
from tempfile import TemporaryDirectory
from typing import Any
from typing import TYPE_CHECKING

from _arguments import command_line
from _arguments import CONFIG
from _arguments import input_path
from _arguments import INTERRUPTED
from _arguments import Parser
from _arguments import RESULTS
from _arguments import shown_path
from _arguments import USAGE
import _environment

if TYPE_CHECKING:
    from lowsnr_bringup.bags.reader import Bag
    from lowsnr_bringup.run.frame_ledger import FrameLedger
    from lowsnr_eval.scoring.recorded_chains import RecordedChains

DONE, FAILED = 0, 1


def parse_arguments(arguments: list[str]) -> argparse.Namespace:
    """Return the options; ``--help`` and errors end here."""
    parser = Parser(
        prog='evaluate.py', description=__doc__,
        epilog='example: python scripts/evaluate.py bags/monday; it starts no node; exit code: 0 '
        'done, 1 frames, metrics or paths of the run are missing, 2 usage error or a bag that '
        'cannot be scored, 130 after Ctrl-C')
    parser.add_argument(
        'bag', type=input_path, metavar='BAG',
        help='folder of a rosbag2 bag, or a file; or the results folder of a run, which gets the '
        'summary and the report of all that was scored')
    parser.add_argument(
        '--results', type=Path, metavar='DIR',
        help='folder for results (default: results/BAG-evaluated, or that with a number)')
    parser.add_argument(
        '--frames-topic', metavar='TOPIC',
        help='topic of the frames, for the report (default: those of the camera or sensor)')
    parser.add_argument(
        '--truth-topic', metavar='TOPIC',
        help='topic of the truth (default: /ground_truth)')
    parser.add_argument(
        '--export', type=Path, metavar='DIR',
        help='write what was declared, detections.csv and tracks.csv, into this folder, and '
        'nothing else')
    parser.add_argument(
        '--smooth', action='store_true',
        help='write the smoothed path of each track into smoothed.csv of the results, and show '
        'its errors beside those of the track')
    return parser.parse_args(arguments)


def main() -> int:
    """Score; return the exit code."""
    options = parse_arguments(sys.argv[1:])
    _environment.ensure(() if (options.bag / 'frames.csv').is_file() else ('bags', 'files'))
    from lowsnr_common.settings.text import one_line
    from lowsnr_eval.scoring.final_summary import missing_frames
    from lowsnr_eval.track_metrics.run_metrics import add_track_metrics
    try:
        if options.export is not None:
            export(options)
            return DONE
        folder, summary = summarized(options)
    except (OSError, ValueError) as error:
        print(f'evaluate.py: {one_line(error)}', file=sys.stderr)
        return USAGE
    missing = missing_frames(summary['frames']) + add_track_metrics(folder)
    smoothed, faults = smooth(folder, summary) if options.smooth else ([], [])
    report(folder, shown_path(folder, options.results), smoothed)
    for line in missing + faults:
        print(f'evaluate.py: {line}', file=sys.stderr)
    return FAILED if missing or faults else DONE


def summarized(options: argparse.Namespace) -> tuple[Path, dict[str, Any]]:
    """Summarize a results folder, or score a bag; return the folder and its summary."""
    from lowsnr_bringup.run.results_folder import FRAMES_FILE
    from lowsnr_eval.scoring.final_summary import summarize_folder

    if not (options.bag / FRAMES_FILE).is_file():
        return score(options)
    if options.results or options.frames_topic or options.truth_topic:
        raise ValueError(f'{options.bag}: is a results folder; options are for bags')
    return options.bag, summarize_folder(options.bag)


def score(options: argparse.Namespace) -> tuple[Path, dict[str, Any]]:
    """Score a bag; return the folder of the results, and their summary."""
    from lowsnr_bringup.bags.recording import CUSTOM_PARAMETERS
    from lowsnr_bringup.run.results_folder import Account
    from lowsnr_bringup.run.results_folder import fresh_folder
    from lowsnr_bringup.run.results_folder import PARAMETERS_FILE
    from lowsnr_eval.scoring.final_summary import summarize
    from lowsnr_eval.scoring.final_summary import write_summary

    with chains_of(options) as (bag, chains):
        folder = fresh_folder(
            options.results or RESULTS / f'{options.bag.resolve().stem}-evaluated')
        if CUSTOM_PARAMETERS in bag.custom:
            (folder / PARAMETERS_FILE).write_text(bag.custom[CUSTOM_PARAMETERS], encoding='utf-8')
        ledger = write_tables(bag, chains, folder)
    summary = summarize(folder, replace(chains.run, results=str(folder)), chains.evaluation,
                        chains.seed, Account(ledger))
    write_summary(folder, summary)
    return folder, summary


def export(options: argparse.Namespace) -> None:
    """Write the detections and tracks of a bag into a folder that has no such tables yet."""
    from lowsnr_bringup.run.results_folder import DETECTIONS_FILE
    from lowsnr_bringup.run.results_folder import TRACKS_FILE

    for name in ('results', 'smooth'):
        if getattr(options, name):
            raise ValueError(f'--{name}: --export writes nothing but its tables; leave it out')
    tables = [options.export / name for name in (DETECTIONS_FILE, TRACKS_FILE)]
    for path in tables:
        if path.exists():
            raise ValueError(f'{path}: is there already: remove it, or choose another --export')
    with chains_of(options) as (bag, chains):
        options.export.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(dir=options.export) as place:
            write_tables(bag, chains, Path(place))
            for path in tables:
                (Path(place) / path.name).rename(path)
                print(f'wrote {path}')


@contextmanager
def chains_of(options: argparse.Namespace) -> 'Iterator[tuple[Bag, RecordedChains]]':
    """Open the bag, and find its chains; print at the end what is wrong with it."""
    from lowsnr_bringup.bags.reader import Bag
    from lowsnr_bringup.plan.config_files import load_config
    from lowsnr_eval.scoring.recorded_chains import find_chains

    with Bag(options.bag) as bag:
        yield bag, find_chains(
            bag, load_config(CONFIG), options.frames_topic, options.truth_topic)
        for note in bag.notes:
            print(f'evaluate.py: {note}', file=sys.stderr)


def write_tables(bag: 'Bag', chains: 'RecordedChains', folder: Path) -> 'FrameLedger':
    """Score the chains of a bag into the tables of a folder; return where its frames went."""
    from lowsnr_eval.ros.recorded_messages import score_bag
    from lowsnr_eval.scoring.run_scoring import RunScorer

    scorer = RunScorer(
        replace(chains.run, results=str(folder)), chains.evaluation,
        lambda sentence, _: bag.notes.append(sentence), conditioned=bool(chains.cells_topics))
    with closing(scorer):
        score_bag(bag, chains, scorer)
    return scorer.ledger


def smooth(folder: Path, summary: dict[str, Any]) -> tuple[list[str], list[str]]:
    """Write the smoothed paths of a results folder; return their errors, or why there are none."""
    from lowsnr_bringup.plan.config_files import load_config
    from lowsnr_common.settings.text import one_line
    from lowsnr_eval.smoothing.error_table import format_errors
    from lowsnr_eval.smoothing.smoothed_table import write_smoothed

    try:
        errors = write_smoothed(folder, summary, load_config(CONFIG))
    except (OSError, ValueError) as error:
        return [], [f'no smoothed paths: {one_line(error)}']
    return [format_errors(errors, summary['evaluation'])], []


def report(folder: Path, shown: str, smoothed: list[str]) -> None:
    """Print the figures and write the page that shows the run."""
    from lowsnr_bringup.run.results_folder import SUMMARY_FILE
    from lowsnr_common.settings.text import one_line
    from lowsnr_eval.report.run_report import write_run_report
    from lowsnr_eval.report.table import format_table
    from lowsnr_eval.track_metrics.metrics_table import format_metrics

    summary = json.loads((folder / SUMMARY_FILE).read_text('utf-8'))
    print('\n\n'.join(filter(None, [
        format_table(summary), format_metrics(summary), *smoothed])))
    print(f'results in {shown}')
    command = command_line('evaluate', sys.argv[1:])
    try:
        print(f'report: {os.path.join(shown, write_run_report(folder, command).name)}')
    except (OSError, ValueError) as error:
        print(f'evaluate.py: no report: {one_line(error)}', file=sys.stderr)


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
