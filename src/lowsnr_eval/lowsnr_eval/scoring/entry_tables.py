"""The tables of what was declared, ``detections.csv`` and ``tracks.csv``: a line an entry."""

from __future__ import annotations

from collections.abc import Mapping
import math
from pathlib import Path
from typing import Any

from lowsnr_bringup.run import results_folder as files
from lowsnr_bringup.run.growing_file import GrowingFile
from lowsnr_bringup.run.growing_file import WriteFault
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_common.core.records import Estimate
from lowsnr_eval.scoring import score_rows as rows
from lowsnr_eval.scoring.frame_scoring import Answer
from lowsnr_eval.scoring.table_files import lines_backwards
from lowsnr_eval.scoring.table_files import open_table
from lowsnr_eval.scoring.table_files import parsed
import numpy as np

# Positions and their standard deviations in pixels of the frame, velocities in pixels a second;
# a field is empty where the value is not known.
COLUMNS = (
    'frame', 'stamp_s', 'detector', 'id', 'x', 'y', 'v_x', 'v_y', 'sd_x', 'sd_y', 'sd_v_x',
    'sd_v_y', 'score')


class EntryTables:
    """
    Writer of both tables; :meth:`close` it at the end.

    Parameters
    ----------
    folder
        Results folder, which exists.
    cell_size_m
        Side of a cell [m].
    after
        Number of the last frame that an earlier process scored, None for a new run: what follows
        it in the tables is cut off.

    Raises
    ------
    ValueError
        One line, if the folder cannot be written to, or holds tables that are not continued or
        that no evaluator wrote.

    """

    def __init__(self, folder: Path, cell_size_m: float, after: int | None = None) -> None:
        self._cell_size_m = cell_size_m
        paths = (folder / files.DETECTIONS_FILE, folder / files.TRACKS_FILE)
        ends = [None if after is None else _end_of(path, after) for path in paths]
        self._files: list[GrowingFile] = []
        try:
            for path, end in zip(paths, ends):
                self._files.append(open_table(path, COLUMNS, end))
        except ValueError:
            self.close()
            raise

    def add(self, frame: int, stamp: int, answers: Mapping[str, Answer]) -> None:
        """Append all entries of the answers to a frame, by its number and stamp [ns]."""
        detections, tracks = self._files
        for name, answer in answers.items():
            for file, entries in ((detections, answer.detections), (tracks, answer.tracks)):
                if entries:
                    file.append(rows.as_lines(
                        entry_row(frame, stamp, name, item, self._cell_size_m)
                        for item in entries))

    def flush(self) -> WriteFault | None:
        """Write what waits for room, recreate what was removed; return what prevents it."""
        faults = [file.flush() for file in self._files]
        return faults[0] or faults[1]

    def give_way(self) -> None:
        """Give the room that the files take to others: they are empty from now on."""
        for file in self._files:
            file.give_way()

    def close(self) -> None:
        """Write what can be written, and close the files."""
        for file in self._files:
            file.close()


def entry_row(
    frame: int, stamp: int, detector: str, item: Estimate, cell_size_m: float,
) -> list[Any]:
    """Return the fields of an entry of a frame with a stamp [ns]."""
    with np.errstate(invalid='ignore'):  # a negative variance has no root
        deviations = np.sqrt(np.diag(item.cov))
    values = np.concatenate(
        [item.state[POS], item.state[VEL], deviations[POS], deviations[VEL]]) / cell_size_m
    return [
        frame, f'{stamp // 1_000_000_000}.{stamp % 1_000_000_000:09d}', detector,
        rows.id_field([item.id]) if item.id else '', *map(_text, values.tolist()),
        _text(item.score)]


def _text(value: float) -> str:
    return f'{value:.9g}' if math.isfinite(value) else ''


def _end_of(path: Path, number: int) -> int:
    """Return where the last line of a frame up to this one ends [bytes]."""
    for stop, line in lines_backwards(path, COLUMNS):
        if parsed(path, line, rows.frame_number) <= number:
            return stop
    return 0
