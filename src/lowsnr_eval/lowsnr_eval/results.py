"""The results folder of a run: scores as they come, and the summary at any time."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import ExitStack
import csv
import json
import os
from pathlib import Path
from types import TracebackType
from typing import Any

from lowsnr_eval.scoreboard import Scoreboard
from lowsnr_eval.scoring import Answer
from lowsnr_eval.scoring import FrameScore
from lowsnr_sensor.config import flat_values

SCHEMA = 1
FRAMES_FILE = 'frames.csv'
LATENCY_FILE = 'latency.csv'
SUMMARY_FILE = 'summary.json'
FRAME_COLUMNS = (
    'frame', 'stamp_s', 'detector', 'level', 'objects', 'declared', 'hits', 'false_alarms',
    'rmse_position_m', 'rmse_velocity_mps', 'gospa_m')
LATENCY_COLUMNS = ('frame', 'detector', 'latency_ms', 'detection_ms')


def fresh_folder(wanted: Path) -> Path:
    """
    Make a folder for results, never one that holds earlier ones.

    Parameters
    ----------
    wanted
        The folder asked for.  It is made, or taken where it is empty; otherwise the first of
        ``<wanted>-2``, ``<wanted>-3`` ... for which that can be done.

    Returns
    -------
    Path
        The folder, absolute; an empty ``frames.csv`` in it keeps other runs away.

    Raises
    ------
    ValueError
        One line that names the path and the mend, if it cannot be made or written to.

    """
    wanted = Path(os.path.abspath(wanted))
    folder, number = wanted, 1
    while not _claim(folder):
        number += 1
        folder = wanted.with_name(f'{wanted.name}-{number}')
    return folder


def _claim(folder: Path) -> bool:
    """Make a folder ours; False if it holds anything or another run claims it first."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            return False
        (folder / FRAMES_FILE).touch(exist_ok=False)
    except FileExistsError as error:
        if folder.is_dir():
            return False
        raise _cannot_write(folder, error) from None
    except OSError as error:
        raise _cannot_write(folder, error) from None
    return True


def summarize(
    board: Scoreboard, *, scenario: str, seed: int, published: int,
) -> dict[str, Any]:
    """
    Return what ``summary.json`` holds.

    Parameters
    ----------
    board
        The scores so far.
    scenario
        Name of the scenario or of the recording.
    seed
        Root seed of the run.
    published
        Frames that were sent; those that were not scored count as unanswered.

    """
    scored = board.frames - board.unanswered
    return {
        'schema': SCHEMA,
        'scenario': scenario,
        'seed': seed,
        'frames': {
            'published': published, 'scored': scored, 'unanswered': published - scored},
        'evaluation': flat_values(board.evaluation),
        'detectors': board.figures(),
    }


class ResultsWriter:
    """
    Writer of the files of a results folder; use it in a ``with`` statement.

    ``frames.csv`` has one line for each frame, detector and level and nothing that depends on
    the wall clock; ``latency.csv`` has that.  Every line is on disk when the call returns, so
    that an interrupted run loses nothing it scored.

    Parameters
    ----------
    folder
        The folder, which exists.

    Raises
    ------
    ValueError
        One line, if the folder holds earlier results or cannot be written to.

    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files = ExitStack()
        try:
            self._frames = self._table(FRAMES_FILE, FRAME_COLUMNS)
            self._latency = self._table(LATENCY_FILE, LATENCY_COLUMNS)
        except OSError as error:
            self.close()
            raise _cannot_write(folder, error) from None

    def __enter__(self) -> ResultsWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def add_scores(self, scores: Iterable[FrameScore]) -> None:
        """Append the scores of a frame to ``frames.csv``."""
        self._frames.writerows(map(_frame_row, scores))

    def add_latency(self, frame: int, detector: str, answer: Answer) -> None:
        """Append the wall times from a frame to tracks and detections to ``latency.csv``."""
        times = (answer.latency_ms, answer.detection_ms)
        self._latency.writerow(
            (frame, detector, *('' if each is None else f'{each:.3f}' for each in times)))

    def write_summary(self, summary: dict[str, Any]) -> None:
        """Write ``summary.json``; whoever reads it sees the whole of it, old or new."""
        text = json.dumps(summary, indent=2, allow_nan=False)
        draft = self._folder / f'{SUMMARY_FILE}.tmp'
        draft.write_text(f'{text}\n', encoding='utf-8')
        draft.replace(self._folder / SUMMARY_FILE)

    def close(self) -> None:
        """Close the files; what was written stays."""
        self._files.close()

    def _table(self, name: str, columns: tuple[str, ...]) -> Any:
        file = self._files.enter_context(
            (self._folder / name).open('a', buffering=1, encoding='utf-8', newline=''))
        if file.tell() > 0:
            raise FileExistsError(0, f'{name} holds earlier results')
        writer = csv.writer(file, lineterminator='\n')
        writer.writerow(columns)
        return writer


def _frame_row(score: FrameScore) -> list[Any]:
    """Return the fields of a score; those without an answer or without truth are empty."""
    # repr is the shortest text that reads back as the same time, also for seconds since 1970.
    stamp = repr(float(score.stamp_s))
    objects = '' if score.objects is None else len(score.objects)
    row: list[Any] = [score.frame, stamp, score.detector, score.level, objects]
    outcome = score.outcome
    if outcome is None:
        return row + [''] * (len(FRAME_COLUMNS) - len(row))
    figures = (outcome.rmse_position_m, outcome.rmse_velocity_mps, outcome.gospa_m)
    return row + [
        outcome.declared, *(
            ('', '') if score.objects is None else (len(outcome.hit), outcome.false_alarms)),
        *('' if value is None else f'{value:.9g}' for value in figures)]


def _cannot_write(folder: Path, error: OSError) -> ValueError:
    return ValueError(
        f'{folder}: results cannot be written there: {error.strerror}; '
        'choose another folder with --results')
