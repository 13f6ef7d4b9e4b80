"""
Truth from a table, for recordings of real frames.

A CSV file with a header line ``frame,x,y`` or ``t_s,x,y``, and a column ``id`` where there are
several objects.  Frames are numbered from 1, times are those of the frames [s]; x is the column
and y the row, in pixels from 0.  There is no object where x or y is empty or ``nan``, nor in a
frame without a line.
"""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Sequence
import csv
import math
from pathlib import Path

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_common.core.motion import POS
from lowsnr_common.core.records import Truth
import numpy as np
from numpy.typing import NDArray

OBJECT = 'object'
# A time in the table belongs to the nearest frame, if it is within this part of the period.
_PERIOD_PART = 0.5


def truth_at(x: float, y: float, name: str = OBJECT) -> Truth:
    """Return an object at a pixel, for cells of 1 m; its velocity is NaN (unknown)."""
    state = np.full(4, np.nan)
    state[POS] = x, y
    return Truth(name, state)


def truth_of_array(truth: NDArray[np.floating]) -> Iterator[list[Truth]]:
    """Yield the objects of every frame from positions (T, 2) [pixels], NaN for none."""
    return ([truth_at(x, y)] if math.isfinite(x + y) else [] for x, y in truth.astype(float))


def read_truth(path: Path, times_s: NDArray[np.floating]) -> list[list[Truth]]:
    """
    Read a table of truth.

    Parameters
    ----------
    path
        The CSV file.
    times_s : (T,) ndarray
        Times of the frames [s].

    Returns
    -------
    list of list of Truth
        Objects of every frame.

    Raises
    ------
    UnusableFile
        With reason ``unreadable``, ``header``, ``number``, ``no such frame`` or ``twice``; the
        sentence names the line.

    """
    found: list[dict[str, Truth]] = [{} for _ in times_s]
    try:
        with path.open(newline='', encoding='utf-8-sig') as file:
            reader = csv.DictReader(file)
            key = _key(path, reader.fieldnames or [])
            for row in reader:
                line = _Line(path, reader.line_num)
                x, y = line.number(row['x']), line.number(row['y'])
                index = line.frame_index(row[key], key, times_s)
                name = row.get('id') or OBJECT
                if name in found[index]:
                    raise line.fault('twice', f'{name} is twice in frame {index + 1}')
                if math.isfinite(x + y):
                    found[index][name] = truth_at(x, y, name)
    except OSError as error:
        raise UnusableFile(path, 'unreadable', f'cannot be read: {error.strerror}') from None
    except (csv.Error, UnicodeDecodeError) as error:
        raise UnusableFile(
            path, 'unreadable', f'not a CSV file: {" ".join(str(error).split())}') from None
    return [list(objects.values()) for objects in found]


def _key(path: Path, header: Sequence[str]) -> str:
    """Return the name of the column that identifies the frame."""
    names = {str(name) for name in header}
    for key in ('frame', 't_s'):
        if {key, 'x', 'y'} <= names <= {key, 'x', 'y', 'id'}:
            return key
    raise UnusableFile(
        path, 'header', 'the header must be frame,x,y or t_s,x,y, with id if there are several')


class _Line:
    """A line of a table."""

    def __init__(self, path: Path, number: int) -> None:
        self._path, self._number = path, number

    def fault(self, reason: str, sentence: str) -> UnusableFile:
        """Return the error that names the line."""
        return UnusableFile(self._path, reason, f'line {self._number}: {sentence}')

    def number(self, text: str | None) -> float:
        """Return a number; NaN for an empty field."""
        try:
            return float(text) if text and text.strip() else math.nan
        except ValueError:
            raise self.fault('number', f'{text!r} is not a number') from None

    def frame_index(self, text: str | None, key: str, times_s: NDArray[np.floating]) -> int:
        """Return the index of the frame that the line is about."""
        value = self.number(text)
        if key == 'frame':
            if not (value.is_integer() and 1 <= value <= len(times_s)):
                raise self.fault(
                    'no such frame', f'frame {text} is not one of 1 to {len(times_s)}')
            return int(value) - 1
        away_s = np.abs(times_s - value)
        period_s = np.median(np.diff(times_s)) if len(times_s) > 1 else 1.0
        if not away_s.min() < _PERIOD_PART * period_s:
            raise self.fault('no such frame', f'there is no frame at {text} s')
        return int(away_s.argmin())
