# SPDX-License-Identifier: Apache-2.0
"""
The tables of a run, ``frames.csv`` and ``latency.csv``: written, continued, and read back.

``frames.csv`` is what was scored: one line for each frame, detector and level, with all that the
figures of a run are computed from, and nothing that depends on the wall clock.  ``latency.csv``
holds the wall times.
"""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Mapping
from collections.abc import Sequence
from itertools import groupby
from itertools import product
from pathlib import Path

from lowsnr_bringup.run import results_folder as files
from lowsnr_bringup.run.growing_file import WriteFault
from lowsnr_eval.scoring import score_rows as rows
from lowsnr_eval.scoring.frame_scoring import Answer
from lowsnr_eval.scoring.frame_scoring import FrameScore
from lowsnr_eval.scoring.frame_scoring import LEVELS
from lowsnr_eval.scoring.table_files import lines_backwards
from lowsnr_eval.scoring.table_files import lines_of
from lowsnr_eval.scoring.table_files import open_table
from lowsnr_eval.scoring.table_files import parsed


class ScoreTables:
    """
    Writer of both tables.

    Every line is on disk when the call returns, so that a process that is killed loses nothing
    that it scored.  On a full disk lines wait in memory until there is room.

    Parameters
    ----------
    folder
        Results folder, which exists.
    detectors
        Names of the chains.
    resumed
        Whether to continue the tables of an earlier process.  ``number`` and ``stamp_ns`` are
        then those of the last frame whose lines are all there; what follows them is cut off.

    Raises
    ------
    ValueError
        One line, if the folder holds earlier results and is not to be continued, cannot be
        written to, or holds a table that no evaluator wrote.

    """

    def __init__(self, folder: Path, detectors: Sequence[str], resumed: bool = False) -> None:
        frames, latency = folder / files.FRAMES_FILE, folder / files.LATENCY_FILE
        self.number, self.stamp_ns = 0, -1
        ends: tuple[int | None, int | None] = (None, None)
        if resumed:
            self.number, self.stamp_ns, end = _last_frame(frames, len(LEVELS) * len(detectors))
            ends = (end, _latency_end(latency, self.number))
        self._frames = open_table(frames, rows.FRAME_COLUMNS, ends[0])
        try:
            self._latency = open_table(latency, rows.LATENCY_COLUMNS, ends[1])
        except ValueError:
            self._frames.close()
            raise

    def add(self, scores: Sequence[FrameScore], answers: Mapping[str, Answer]) -> None:
        """Append the scores of a frame, and the wall times of the answers to it."""
        self._frames.append(rows.as_lines(map(rows.frame_row, scores)))
        self._latency.append(rows.as_lines(
            rows.latency_row(scores[0].frame, name, answer)
            for name, answer in answers.items() if answer.latency_ms is not None))

    def flush(self) -> WriteFault | None:
        """Write what waits for room, recreate what was removed; return what prevents it."""
        faults = [self._frames.flush(), self._latency.flush()]
        return faults[0] or faults[1]

    def close(self) -> None:
        """Write what can be written, of all things the scores, and close the files."""
        if self._frames.flush():
            self._latency.give_way()
        self._frames.close()
        self._latency.close()


def read_frames(path: Path, detectors: Sequence[str]) -> Iterator[list[FrameScore]]:
    """
    Yield the scores of each frame of ``frames.csv``, in order, one frame in memory at a time.

    A last frame whose lines are not all there is left out.

    Raises
    ------
    ValueError
        One line, if the file is not a table of these chains.

    """
    wanted = list(product(detectors, LEVELS))
    unfinished = 0
    lines = lines_of(path, rows.FRAME_COLUMNS)
    scores = (parsed(path, line, rows.frame_score) for line in lines)
    for number, group in groupby(scores, lambda score: score.frame):
        frame = list(group)
        found = [(score.detector, score.level) for score in frame]
        if unfinished or found != wanted[:len(found)]:
            raise ValueError(f'{path}: frame {unfinished or number} has not one line for each '
                             'detector and level')
        if len(found) < len(wanted):
            unfinished = number
        else:
            yield frame


def read_latency(path: Path, detectors: Sequence[str]) -> Iterator[rows.Latency]:
    """Yield the wall times of ``latency.csv``; ValueError if it is not one of these chains."""
    for line in lines_of(path, rows.LATENCY_COLUMNS):
        found = parsed(path, line, rows.latency)
        if found.detector not in detectors:
            raise ValueError(f'{path}: {found.detector!r} is not a detector of this run')
        yield found


def _last_frame(path: Path, lines_a_frame: int) -> tuple[int, int, int]:
    """Return number and stamp [ns] of the last whole frame, and where it ends [bytes]."""
    number, count, end = -1, 0, 0
    for stop, line in lines_backwards(path, rows.FRAME_COLUMNS):
        score = parsed(path, line, rows.frame_score)
        if score.frame != number:
            number, count, end = score.frame, 0, stop
        count += 1
        if count == lines_a_frame:
            return number, round(1e9 * score.stamp_s), end
    return 0, -1, 0


def _latency_end(path: Path, number: int) -> int:
    """Return where the last line of a frame up to this one ends [bytes]."""
    lines = lines_backwards(path, rows.LATENCY_COLUMNS)
    return next((stop for stop, line in lines
                 if parsed(path, line, rows.latency).frame <= number), 0)
