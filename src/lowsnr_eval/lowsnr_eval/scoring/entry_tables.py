# SPDX-License-Identifier: Apache-2.0
"""
The tables of entries, a line each: ``detections.csv``, ``tracks.csv`` and ``truth.csv``.

They are written frame by frame, continued by a restarted evaluator, and read back.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Iterator
from collections.abc import Mapping
from collections.abc import Sequence
import csv
from itertools import groupby
import math
from pathlib import Path
from typing import Any
from typing import NamedTuple

from lowsnr_bringup.run import results_folder as files
from lowsnr_bringup.run.growing_file import GrowingFile
from lowsnr_bringup.run.growing_file import WriteFault
from lowsnr_common.core.motion import POS
from lowsnr_common.core.motion import VEL
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Truth
from lowsnr_eval.scoring import score_rows as rows
from lowsnr_eval.scoring.frame_scoring import Answer
from lowsnr_eval.scoring.table_files import lines_backwards
from lowsnr_eval.scoring.table_files import lines_of
from lowsnr_eval.scoring.table_files import open_table
from lowsnr_eval.scoring.table_files import parsed
import numpy as np

# Positions and their standard deviations in pixels of the frame, velocities in pixels a second;
# a field is empty where the value is not known.
COLUMNS = (
    'frame', 'stamp_s', 'detector', 'id', 'x', 'y', 'v_x', 'v_y', 'sd_x', 'sd_y', 'sd_v_x',
    'sd_v_y', 'score')
# The same of the objects that are present; their ids are escaped in the same way.
TRUTH_COLUMNS = ('frame', 'stamp_s', 'id', 'x', 'y', 'v_x', 'v_y')
# Largest position, velocity, deviation or score of a line [pixels, pixels/s].
_LARGEST = 1e12


class Entry(NamedTuple):
    """
    A line of a table.

    ``values`` are x, y, v_x, v_y, and but for the truth their standard deviations and the score,
    [pixels of the frame, pixels/s]; NaN is not known.  ``detector`` is empty for the truth.
    """

    frame: int
    stamp_ns: int
    detector: str
    name: str
    values: tuple[float, ...]


class EntryTables:
    """
    Writer of the tables; :meth:`close` it at the end.

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
        tables = [(folder / files.DETECTIONS_FILE, COLUMNS), (folder / files.TRACKS_FILE, COLUMNS),
                  (folder / files.TRUTH_FILE, TRUTH_COLUMNS)]
        ends = [None if after is None else _end_of(*table, after) for table in tables]
        self._files: list[GrowingFile] = []
        try:
            for (path, columns), end in zip(tables, ends):
                self._files.append(open_table(path, columns, end))
        except ValueError:
            self.close()
            raise

    def add(
        self, frame: int, stamp: int, answers: Mapping[str, Answer], truth: Sequence[Truth] = (),
    ) -> None:
        """Append truth and answers of a frame, by its number and stamp [ns]."""
        detections, tracks, objects = self._files
        if truth:
            objects.append(rows.as_lines(truth_rows(frame, stamp, truth, self._cell_size_m)))
        for name, answer in answers.items():
            for file, entries in ((detections, answer.detections), (tracks, answer.tracks)):
                if entries:
                    file.append(rows.as_lines(
                        entry_rows(frame, stamp, name, entries, self._cell_size_m)))

    def flush(self) -> WriteFault | None:
        """Write what waits for room, recreate what was removed; return what prevents it."""
        faults = [file.flush() for file in self._files]
        return next(filter(None, faults), None)

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
    first = [frame, rows.stamp_text(stamp), detector]
    for item, own in zip(entries, values.tolist()):
        yield [*first, _name(item.id), *map(_text, own), _text(item.score)]


def truth_rows(
    frame: int, stamp: int, objects: Sequence[Truth], cell_size_m: float,
) -> Iterator[list[Any]]:
    """Yield the fields of each object that is present in a frame with a stamp [ns]."""
    values = np.array([item.state for item in objects])[:, [*POS, *VEL]] / cell_size_m
    for item, own in zip(objects, values.tolist()):
        yield [frame, rows.stamp_text(stamp), _name(item.id), *map(_text, own)]


def read_entries(path: Path, columns: Sequence[str]) -> Iterator[Entry]:
    """Yield the lines of a table with these columns; ValueError names a file that is damaged."""
    parse = _truth_entry if columns is TRUTH_COLUMNS else _entry
    for line in lines_of(path, columns):
        yield parsed(path, line, parse)


class FrameRows:
    """
    The rows of a table, frame by frame: one frame in memory at a time.

    Parameters
    ----------
    path
        The table; a missing one, or None, has no rows.
    columns
        Its columns.

    """

    def __init__(self, path: Path | None, columns: Sequence[str] = COLUMNS) -> None:
        rows = read_entries(path, columns) if path is not None and path.is_file() else iter(())
        self._groups = groupby(rows, lambda row: row.frame)
        self._next: tuple[int, list[Entry]] | None = (0, [])

    def take(self, frame: int) -> list[Entry]:
        """Return the rows of a frame; those of earlier ones are gone."""
        while self._next is not None and self._next[0] < frame:
            self.advance()
        return self._next[1] if self._next is not None and self._next[0] == frame else []

    def advance(self) -> tuple[int, list[Entry]] | None:
        """Return the next frame that has rows, and these; None at the end."""
        group = next(self._groups, None)
        self._next = None if group is None else (group[0], list(group[1]))
        return self._next


def _entry(line: bytes) -> Entry:
    frame, stamp, detector, name, *values = next(csv.reader([line.decode()]))
    if len(values) != len(COLUMNS) - 4:
        raise ValueError(line)
    return Entry(_whole(frame), rows.stamp_ns(stamp), detector, name, _numbers(values))


def _truth_entry(line: bytes) -> Entry:
    frame, stamp, name, *values = next(csv.reader([line.decode()]))
    if len(values) != len(TRUTH_COLUMNS) - 3:
        raise ValueError(line)
    return Entry(_whole(frame), rows.stamp_ns(stamp), '', name, _numbers(values))


def _whole(text: str) -> int:
    return rows.frame_number(text.encode())


def _numbers(fields: Iterable[str]) -> tuple[float, ...]:
    values = tuple(float(text) if text else math.nan for text in fields)
    if any(abs(value) > _LARGEST for value in values):
        raise ValueError(values)
    return values


def _name(name: str) -> str:
    return rows.id_field([name]) if name else ''


def _text(value: float) -> str:
    """Return a value as text; what no run can have is not known either."""
    return f'{value:.9g}' if abs(value) <= _LARGEST else ''


def _end_of(path: Path, columns: Sequence[str], number: int) -> int:
    """Return where the last line of a frame up to this one ends [bytes]."""
    for stop, line in lines_backwards(path, columns):
        if parsed(path, line, rows.frame_number) <= number:
            return stop
    return 0
