"""How an evaluator that was started again goes on from what it had scored."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
import csv
from dataclasses import dataclass
import itertools
import json
from pathlib import Path
from typing import TypeVar

from lowsnr_bringup.run.results_folder import FRAMES_FILE
from lowsnr_eval.scoring.results import CHECKPOINT_FILE
from lowsnr_eval.scoring.results import LATENCY_FILE
from lowsnr_eval.scoring.score_tables import FRAME_COLUMNS
from lowsnr_eval.scoring.score_tables import frame_score
from lowsnr_eval.scoring.score_tables import latencies
from lowsnr_eval.scoring.tallies import LEVELS
from lowsnr_eval.scoring.tallies import Scoreboard

T = TypeVar('T')


@dataclass(frozen=True)
class Resumed:
    """
    The last frame that was scored before, and where the tables of results go on.

    ``number`` is that of the frame, ``stamp`` its time [ns], ``ends`` are the sizes of
    ``frames.csv`` and ``latency.csv`` up to it [bytes].
    """

    number: int = 0
    stamp: int = -1
    ends: tuple[int | None, int | None] = (None, None)


def resume(folder: Path, board: Scoreboard) -> Resumed:
    """
    Restore the scores of an earlier life into a new scoreboard.

    The checkpoint has all up to its second; the tables have what was scored after it.  A frame
    whose lines were not all written counts as not scored.

    Parameters
    ----------
    folder
        Results folder; nothing needs to be in it.
    board
        Scoreboard without scores.

    Raises
    ------
    ValueError
        One line, if a table holds what no evaluator writes.

    """
    starts = _from_checkpoint(folder, board)
    ends = (_replay(folder / FRAMES_FILE, starts[0], board),
            _add_times(folder / LATENCY_FILE, starts[1], board))
    return Resumed(board.frames, round(1e9 * board.stamp_s) if board.frames else -1, ends)


def _from_checkpoint(folder: Path, board: Scoreboard) -> tuple[int, int]:
    """Restore the checkpoint, if there is one of these tables; return their sizes then."""
    try:
        state = json.loads((folder / CHECKPOINT_FILE).read_text(encoding='utf-8'))
        frames, latency = (int(end) for end in state['ends'])
        whole = all((folder / name).stat().st_size >= end for name, end in (
            (FRAMES_FILE, frames), (LATENCY_FILE, latency)))
        if whole:
            board.restore(state['board'])
            return frames, latency
    except (OSError, ValueError, KeyError, TypeError):
        pass  # the tables alone have it all
    return 0, 0


def _replay(path: Path, start: int, board: Scoreboard) -> int:
    """Count the frames that are whole from a place on; return where the last one ends."""
    end = start
    for name, group in itertools.groupby(
            _whole_lines(path, start), lambda line: line.partition(',')[0]):
        lines = list(group)
        if name != FRAME_COLUMNS[0]:
            if len(lines) < len(LEVELS) * board.chains:
                break
            board.replay([_parsed(path, line, frame_score) for line in lines])
        end += sum(len(line.encode()) for line in lines)
    return end


def _add_times(path: Path, start: int, board: Scoreboard) -> int:
    """Add the times of the frames that were counted; return where the last of them ends."""
    end = start
    for line in _whole_lines(path, start):
        if not line.startswith(FRAME_COLUMNS[0]):
            frame, detector, times = _parsed(path, line, latencies)
            if frame > board.frames:
                break
            board.add_times(detector, times)
        end += len(line.encode())
    return end


def _whole_lines(path: Path, start: int) -> Iterator[str]:
    """Yield the lines from a place on; the last one only if it is whole."""
    if path.is_file():
        with path.open('rb') as file:
            file.seek(start)
            for line in file:
                if line.endswith(b'\n'):
                    yield line.decode('ascii', 'replace')


def _parsed(path: Path, line: str, parse: Callable[[list[str]], T]) -> T:
    try:
        return parse(next(csv.reader([line])))
    except ValueError:
        raise ValueError(f'{path}: {line.strip()!r} is not a line of this table') from None
