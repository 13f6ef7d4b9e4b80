"""The results folder of a run: scores as they come, and the summary at any time."""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping
import json
from pathlib import Path
from types import TracebackType
from typing import Any

from lowsnr_bringup.run.results_folder import cannot_write
from lowsnr_bringup.run.results_folder import FRAMES_FILE
from lowsnr_common.settings.config import flat_values
from lowsnr_eval.scoring.frame_scoring import Answer
from lowsnr_eval.scoring.frame_scoring import FrameScore
from lowsnr_eval.scoring.growing_file import GrowingFile
from lowsnr_eval.scoring.score_tables import as_lines
from lowsnr_eval.scoring.score_tables import FRAME_COLUMNS
from lowsnr_eval.scoring.score_tables import frame_row
from lowsnr_eval.scoring.score_tables import LATENCY_COLUMNS
from lowsnr_eval.scoring.score_tables import latency_row
from lowsnr_eval.scoring.tallies import Scoreboard

SCHEMA = 1
LATENCY_FILE = 'latency.csv'
SUMMARY_FILE = 'summary.json'
CHECKPOINT_FILE = 'checkpoint.json'


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
            'published': published, 'scored': scored, 'unanswered': published - scored,
            'unseen': 0},
        'restarts': {},
        'evaluation': flat_values(board.evaluation),
        'detectors': board.figures(),
    }


def note_losses(folder: Path, published: int, restarts: Mapping[str, int]) -> None:
    """
    Add to ``summary.json`` what only the starter of the nodes knows.

    Parameters
    ----------
    folder
        Results folder; without a summary nothing is done.
    published
        Frames that the source sent; those that the evaluator has not heard of are ``unseen``.
    restarts
        How often each node was started again, by its label.

    """
    try:
        summary = json.loads((folder / SUMMARY_FILE).read_text(encoding='utf-8'))
        frames = summary['frames']
        frames['unseen'] = max(0, published - frames['published'])
        frames['published'] += frames['unseen']
        summary['restarts'] = dict(restarts)
        _write_whole(folder / SUMMARY_FILE, _as_text(summary))
    except OSError:
        return  # there is no summary, or no room: the evaluator has said so


class ResultsWriter:
    """
    Writer of the files of a results folder; use it in a ``with`` statement.

    ``frames.csv`` has one line for each frame, detector and level and nothing that depends on
    the wall clock; ``latency.csv`` has that.  Every line is on disk when the call returns, so
    that an interrupted run loses nothing it scored; on a full disk it is as soon as there is
    room again.

    Parameters
    ----------
    folder
        The folder, which exists.
    ends
        Where ``frames.csv`` and ``latency.csv`` of an earlier life go on [bytes].

    Raises
    ------
    ValueError
        One line, if the folder holds earlier results or cannot be written to.

    """

    def __init__(
        self, folder: Path, ends: tuple[int | None, int | None] = (None, None),
    ) -> None:
        self._folder = folder
        self._frames = _opened(folder / FRAMES_FILE, FRAME_COLUMNS, ends[0])
        try:
            self._latency = _opened(folder / LATENCY_FILE, LATENCY_COLUMNS, ends[1])
        except ValueError:
            self._frames.close()
            raise

    def __enter__(self) -> ResultsWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def add_scores(self, scores: Iterable[FrameScore]) -> None:
        """Append the scores of a frame to ``frames.csv``."""
        self._frames.append(as_lines(map(frame_row, scores)))

    def add_latency(self, frame: int, detector: str, answer: Answer) -> None:
        """Append the wall times from a frame to tracks and detections to ``latency.csv``."""
        self._latency.append(as_lines([latency_row(frame, detector, answer)]))

    def settle(self) -> str:
        """Write what waits for room, make again what was removed; say what is wrong."""
        return self._frames.settle() or self._latency.settle()

    def write_checkpoint(self, state: dict[str, Any]) -> None:
        """Write what a restart goes on from, with the sizes of the tables it belongs to."""
        _write_whole(self._folder / CHECKPOINT_FILE, json.dumps(
            state | {'ends': [self._frames.size, self._latency.size]}))

    def write_summary(self, summary: dict[str, Any]) -> None:
        """Write ``summary.json``; whoever reads it sees the whole of it, old or new."""
        _write_whole(self._folder / SUMMARY_FILE, _as_text(summary))

    def close(self) -> None:
        """Close the files; what was written stays."""
        self._frames.close()
        self._latency.close()


def _as_text(summary: Mapping[str, Any]) -> str:
    return json.dumps(summary, indent=2, allow_nan=False) + '\n'


def _write_whole(path: Path, text: str) -> None:
    """Write a file; whoever reads it sees the whole of it, old or new."""
    draft = path.with_name(f'{path.name}.tmp')
    draft.write_text(text, encoding='utf-8')
    draft.replace(path)


def _opened(path: Path, columns: tuple[str, ...], end: int | None) -> GrowingFile:
    try:
        file = GrowingFile(path, end)
    except OSError as error:
        raise cannot_write(path.parent, error) from None
    if file.size == 0:
        file.append(as_lines([columns]))
    return file
