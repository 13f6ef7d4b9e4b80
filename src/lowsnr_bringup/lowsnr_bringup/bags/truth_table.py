"""
Truth from a table, for recordings of real frames.

A CSV file with a header line: ``frame,x,y`` or ``t_s,x,y``, and ``id`` where there are several
objects.  Frames are numbered from 1, times are those of the frames [s]; x is the column and y
the row, in pixels from 0.  Where x or y is empty or ``nan``, or a frame has no line, there is
no object.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path

from lowsnr_common.core.motion import POS
from lowsnr_common.core.records import Truth
import numpy as np

OBJECT = 'object'
# A time in the table belongs to a frame that is less than this away, in shares of the period.
_SHARE = 0.5


def truth_at(x: float, y: float, name: str = OBJECT) -> Truth:
    """Return an object at a pixel, of cells of 1 m, with a velocity that is not known."""
    state = np.full(4, np.nan)
    state[POS] = x, y
    return Truth(name, state)


def truth_of_array(truth: np.ndarray) -> list[list[Truth]]:
    """Return the objects of every frame for positions (T, 2), NaN where there is none."""
    return [[truth_at(x, y)] if math.isfinite(x + y) else [] for x, y in truth.astype(float)]


def read_truth(path: Path, times_s: np.ndarray) -> list[list[Truth]]:
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
    ValueError
        One line that names file, line and what is wrong.

    """
    found: list[dict[str, Truth]] = [{} for _ in times_s]
    try:
        with path.open(newline='', encoding='utf-8-sig') as file:
            reader = csv.DictReader(file)
            key = _key(path, reader.fieldnames or [])
            for row in reader:
                where = f'{path}: line {reader.line_num}'
                x, y = _number(row['x'], where), _number(row['y'], where)
                index = _index(row[key], key, times_s, where)
                name = row.get('id') or OBJECT
                if name in found[index]:
                    raise ValueError(f'{where}: {name} is twice in frame {index + 1}')
                if math.isfinite(x + y):
                    found[index][name] = truth_at(x, y, name)
    except OSError as error:
        raise ValueError(f'{path}: cannot be read: {error.strerror}') from None
    except (csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f'{path}: not a CSV file: {" ".join(str(error).split())}') from None
    return [list(frame.values()) for frame in found]


def _key(path: Path, header: object) -> str:
    names = {str(name) for name in header} if isinstance(header, (list, tuple)) else set()
    for key in ('frame', 't_s'):
        if {key, 'x', 'y'} <= names <= {key, 'x', 'y', 'id'}:
            return key
    raise ValueError(f'{path}: the header must be frame,x,y or t_s,x,y, and id if wanted')


def _number(text: str | None, where: str) -> float:
    """Return a number, NaN for nothing."""
    try:
        return float(text) if text and text.strip() else math.nan
    except ValueError:
        raise ValueError(f'{where}: {text!r} is not a number') from None


def _index(text: str | None, key: str, times_s: np.ndarray, where: str) -> int:
    """Return the index of the frame that a line is about."""
    value = _number(text, where)
    if key == 'frame':
        if not (value.is_integer() and 1 <= value <= len(times_s)):
            raise ValueError(f'{where}: frame {text} is not one of 1 to {len(times_s)}')
        return int(value) - 1
    away = abs(times_s - value)
    period_s = np.median(np.diff(times_s)) if len(times_s) > 1 else 1.0
    if not away.min() < _SHARE * period_s:
        raise ValueError(f'{where}: there is no frame at {text} s')
    return int(away.argmin())
