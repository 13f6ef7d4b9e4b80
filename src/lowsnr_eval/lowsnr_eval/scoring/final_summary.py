"""The summary of a run: computed from its tables when the run has ended, by one author."""

from __future__ import annotations

from collections.abc import Mapping
import json
from pathlib import Path
from typing import Any

from lowsnr_bringup.plan.graph import build
from lowsnr_bringup.run import results_folder as files
from lowsnr_common.settings.flat_values import flat_values
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.scoring.earlier_run import earlier_counts
from lowsnr_eval.scoring.earlier_run import earlier_restarts
from lowsnr_eval.scoring.earlier_run import evaluator_parameters
from lowsnr_eval.scoring.score_tables import read_frames
from lowsnr_eval.scoring.score_tables import read_latency
from lowsnr_eval.scoring.tallies import Tallies

SCHEMA = 1


def summarize(
    folder: Path, run: RunSettings, evaluation: Evaluation, seed: int, account: files.Account,
) -> dict[str, Any]:
    """
    Return what ``summary.json`` holds, from the tables of a run.

    Parameters
    ----------
    folder
        Results folder with ``frames.csv`` and ``latency.csv``, which are read line by line: the
        memory that this takes does not grow with the run.
    run, evaluation, seed
        What was scored and how.
    account
        What only the process that started the nodes knows.

    Raises
    ------
    OSError
        If a table cannot be read.
    ValueError
        One line, if a table is damaged.

    """
    tallies = Tallies(run.detectors)
    for scores in read_frames(folder / files.FRAMES_FILE, run.detectors):
        tallies.add(scores)
    for times in read_latency(folder / files.LATENCY_FILE, run.detectors):
        tallies.add_latency(times.detector, times.latency_ms, times.detection_ms)
    detectors = tallies.figures()
    for name, point in zip(run.detectors, run.operating_points):
        detectors[name]['operating_point'] = point
    published = max(account.published, tallies.frames)
    return {
        'schema': SCHEMA,
        'scenario': run.scenario,
        'seed': seed,
        'frames': {
            'published': published, 'scored': tallies.frames - tallies.unanswered,
            'unanswered': tallies.unanswered, 'unseen': published - tallies.frames},
        'restarts': dict(account.restarts),
        'evaluation': flat_values(evaluation),
        'detectors': detectors,
    }


def write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """Write ``summary.json``, whole or not at all; ValueError names a folder that has no room."""
    draft = folder / f'{files.SUMMARY_FILE}.tmp'
    text = json.dumps(summary, indent=2, allow_nan=False) + '\n'
    try:
        draft.write_text(text, encoding='utf-8')
        draft.replace(folder / files.SUMMARY_FILE)
    except OSError as error:
        raise files.cannot_write(folder, error) from None


def summarize_run(folder: Path, evaluator: Mapping[str, Any], account: files.Account) -> None:
    """
    Write the summary of a run, of which the parameters of the evaluator are given.

    It writes nothing where the evaluator did not begin its table, and raises what
    :func:`summarize` and :func:`write_summary` raise.
    """
    table = folder / files.FRAMES_FILE
    if table.is_file() and table.stat().st_size:
        write_summary(folder, summarize(
            folder, build(RunSettings, evaluator, 'evaluator'),
            build(Evaluation, evaluator, 'evaluator'), evaluator.get('seed', 0), account))


def summarize_folder(folder: Path) -> None:
    """
    Write the summary of a run whose starter was killed, or that still runs.

    An earlier summary tells how many frames the source published; without it, frames that the
    evaluator has not seen are unknown.  A folder without the parameters of a run, or without a
    scored frame, raises ValueError too.
    """
    account = files.Account(
        earlier_counts(folder).get('published', 0), earlier_restarts(folder))
    summarize_run(folder, evaluator_parameters(folder), account)
    if not (folder / files.SUMMARY_FILE).is_file():
        raise ValueError(f'{folder}: nothing was scored')
