"""The tables of what was declared, ``detections.csv`` and ``tracks.csv``: a line an entry."""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Mapping
from collections.abc import Sequence
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
                        entry_rows(frame, stamp, name, entries, self._cell_size_m)))

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


def entry_rows(
    frame: int, stamp: int, detector: str, entries: Sequence[Estimate], cell_size_m: float,
) -> Iterator[list[Any]]:
    """Yield the fields of each entry of a frame with a stamp [ns]."""
    states = np.array([item.state for item in entries])
    variances = np.array([np.diagonal(item.cov) for item in entries])
    with np.errstate(invalid='ignore'):  # a negative variance has no root
        deviations = np.sqrt(variances)
    order = [*POS, *VEL]
    values = np.hstack([states[:, order], deviations[:, order]]) / cell_size_m
    first = [frame, f'{stamp // 1_000_000_000}.{stamp % 1_000_000_000:09d}', detector]
    for item, own in zip(entries, values.tolist()):
        name = rows.id_field([item.id]) if item.id else ''
        yield [*first, name, *map(_text, own), _text(item.score)]


def _text(value: float) -> str:
    return f'{value:.9g}' if math.isfinite(value) else ''


def _end_of(path: Path, number: int) -> int:
    """Return where the last line of a frame up to this one ends [bytes]."""
    for stop, line in lines_backwards(path, COLUMNS):
        if parsed(path, line, rows.frame_number) <= number:
            return stop
    return 0
