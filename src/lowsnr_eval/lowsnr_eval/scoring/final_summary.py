# SPDX-License-Identifier: Apache-2.0
"""The summary of a run: computed from its tables when the run has ended, by one author."""

from __future__ import annotations

from collections.abc import Mapping
import json
import os
from pathlib import Path
from typing import Any

from lowsnr_bringup.plan.graph import build
from lowsnr_bringup.plan.graph import node_of
from lowsnr_bringup.run import results_folder as files
from lowsnr_bringup.run.earlier_run import earlier_alarm_rates
from lowsnr_bringup.run.earlier_run import earlier_counts
from lowsnr_bringup.run.earlier_run import earlier_restarts
from lowsnr_bringup.run.earlier_run import evaluator_parameters
from lowsnr_bringup.run.frame_ledger import FrameLedger
from lowsnr_common.core.records import AlarmRate
from lowsnr_common.settings.flat_values import flat_values
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.scoring.score_tables import read_frames
from lowsnr_eval.scoring.score_tables import read_latency
from lowsnr_eval.scoring.tallies import Tallies

SCHEMA = 1
# Room for a summary: what all have, and what each chain adds [bytes].
_SUMMARY_BYTES, _CHAIN_BYTES = 4096, 8192


def summarize(
    folder: Path, run: RunSettings, evaluation: Evaluation, seed: int, account: files.Account,
) -> dict[str, Any]:
    """
    Return what ``summary.json`` holds, from the tables of a run.

    The metrics of tracks, which take longer, are None until
    :func:`lowsnr_eval.track_metrics.run_metrics.add_track_metrics` adds them.

    Parameters
    ----------
    folder
        Results folder with ``frames.csv`` and ``latency.csv``.  They are read line by line: the
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
    lags = run.lags or (0,) * len(run.detectors)
    asked = run.false_tracks or (0.0,) * len(run.detectors)
    for name, point, lag, tracks in zip(run.detectors, run.operating_points, lags, asked):
        rate = account.alarm_rates.get(node_of(name), AlarmRate())
        detectors[name] |= {
            'operating_point': point, 'lag_frames': lag, 'pfa_asked': rate.asked,
            'pfa_measured': rate.measured, 'false_tracks_asked': tracks or None,
            'track_metrics': None}
    ledger = account.ledger or FrameLedger(tallies.frames)
    ledger.close(tallies.frames, tallies.last)
    return {
        'schema': SCHEMA,
        'scenario': run.scenario,
        'seed': seed,
        'frames': {
            'expected': run.expected_frames or None, 'published': ledger.published,
            'scored': tallies.frames - tallies.unanswered, 'unanswered': tallies.unanswered,
            'unseen': ledger.unseen, 'lost': ledger.lost},
        'restarts': dict(account.restarts),
        'evaluation': flat_values(evaluation),
        'detectors': detectors,
    }


def missing_frames(frames: Mapping[str, Any]) -> list[str]:
    """
    Return what keeps a run from being whole, a line for each kind; nothing if nothing is missing.

    Parameters
    ----------
    frames
        What ``summary.json`` holds about the frames; an old one lacks ``expected`` and ``lost``.

    """
    expected, published, lost = frames.get('expected'), frames['published'], frames.get('lost', 0)
    table = frames['scored'] + frames['unanswered']
    found = []
    if expected is not None and published < expected:
        found.append(f'the source ended after {published} of {expected} frames')
    if lost:
        found.append(f'{lost} of {published} frames were scored and lost: {files.FRAMES_FILE} '
                     'does not hold them')
    if frames['unseen']:
        found.append(f'{frames["unseen"]} of {published} frames did not reach the '
                     'evaluator, or not with their truth')
    if published != table + lost + frames['unseen'] or min(lost, frames['unseen']) < 0:
        found.append(
            f'the account of the frames does not add up: {published} published, {table} in '
            f'{files.FRAMES_FILE}, {lost} lost, {frames["unseen"]} unseen; does another program '
            'publish on the topics of the run?')
    return found


def reserve_summary(folder: Path, chains: int) -> None:
    """Reserve room for the summary of so many chains; OSError where the disk has none."""
    with _draft(folder).open('wb') as file:
        os.posix_fallocate(file.fileno(), 0, _SUMMARY_BYTES + chains * _CHAIN_BYTES)


def write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """
    Write ``summary.json``, whole or not at all; ValueError names a folder that has no room.

    It takes the room that :func:`reserve_summary` reserved, if it did.
    """
    draft = _draft(folder)
    text = json.dumps(summary, indent=2, allow_nan=False) + '\n'
    try:
        with draft.open('r+b' if draft.exists() else 'wb') as file:
            file.write(text.encode())
            file.truncate()
        draft.replace(folder / files.SUMMARY_FILE)
    except OSError as error:
        raise files.cannot_write(folder, error) from None


def _draft(folder: Path) -> Path:
    return folder / f'{files.SUMMARY_FILE}.tmp'


def summarize_run(
    folder: Path, evaluator: Mapping[str, Any], account: files.Account,
) -> dict[str, Any] | None:
    """
    Return the summary of a run, of which the parameters of the evaluator are given.

    It is None where no frame was published and the evaluator did not begin its table.  This
    raises what :func:`summarize` raises.
    """
    table = folder / files.FRAMES_FILE
    begun = table.is_file() and table.stat().st_size
    if not begun and not (account.ledger and account.ledger.published):
        return None
    return summarize(
        folder, build(RunSettings, evaluator, 'evaluator'),
        build(Evaluation, evaluator, 'evaluator'), evaluator.get('seed', 0), account)


def summarize_folder(folder: Path) -> dict[str, Any]:
    """
    Return the summary of a run whose starter was killed, or that still runs, and write it.

    An earlier summary tells how many frames the source published and where they went; without
    it, frames that the evaluator has not written are unknown.  A folder without the parameters of
    a run, or without a scored frame, raises ValueError too.
    """
    summary = summarize_run(
        folder, evaluator_parameters(folder), files.Account(
            restarts=earlier_restarts(folder), alarm_rates=earlier_alarm_rates(folder)))
    if summary is None:
        raise ValueError(f'{folder}: nothing was scored')
    frames, earlier = summary['frames'], earlier_counts(folder)
    if all(earlier.get(key) == frames[key] for key in ('scored', 'unanswered')):
        frames |= {key: earlier[key] for key in ('published', 'unseen', 'lost')
                   if earlier.get(key) is not None}
    write_summary(folder, summary)
    return summary
