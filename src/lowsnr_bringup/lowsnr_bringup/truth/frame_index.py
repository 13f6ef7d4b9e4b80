# SPDX-License-Identifier: Apache-2.0
"""The frame that a line of truth is about: by number, time or file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from pathlib import Path
import re

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.fits_dates import unix_ns
from lowsnr_common.core.motion import POS
from lowsnr_common.core.records import Truth
import numpy as np
from numpy.typing import NDArray

OBJECT = 'object'
# A time belongs to the nearest frame, if it is within this part of the period.
_PERIOD_PART = 0.5
# Times below it do not count from 1970.
_UNIX_S = 1e8
_DATE = re.compile(r'\d{4}-\d\d-\d\d.\d\d:\d\d:\d\d')


def truth_at(x: float, y: float, name: str = OBJECT) -> Truth:
    """Return an object at a pixel, for cells of 1 m; its velocity is NaN (unknown)."""
    state = np.full(4, np.nan)
    state[POS] = x, y
    return Truth(name, state)


@dataclass(frozen=True, kw_only=True)
class Reading:
    """
    How truth is read where its form leaves that open.

    Attributes
    ----------
    columns
        Names of the columns of a table by what they hold: frame, t_s, x, y, id.
    first
        Number of the first frame, 0 or 1; None for 0 in a table that has a frame 0, else 1.
    origin
        Coordinate of the first pixel, 0 or 1; None for 1 in the form of MOT, else 0.

    """

    columns: tuple[tuple[str, str], ...] = ()
    first: int | None = None
    origin: int | None = None


class Line:
    """A line of a file of truth, for errors that name it."""

    def __init__(self, path: Path, number: int) -> None:
        self._path, self._number = path, number

    def fault(self, reason: str, sentence: str) -> UnusableFile:
        """Return the error that names the line."""
        return UnusableFile(self._path, reason, f'line {self._number}: {sentence}')

    def number(self, text: str | None, decimal: str = '.') -> float:
        """Return a number; NaN for an empty field."""
        try:
            return float(text.replace(decimal, '.')) if text and text.strip() else math.nan
        except ValueError:
            raise self.fault('number', f'{text!r} is not a number') from None

    def time_s(self, text: str | None, decimal: str = '.') -> float:
        """Return a time [s]: a number, or a date since 1970."""
        if text and _DATE.match(text.strip()):
            found = unix_ns(text.strip().replace(',', '.'))
            if found is not None:
                return found / 1e9
        return self.number(text, decimal)


class FrameIndex:
    """
    The frames that truth can be about.

    Parameters
    ----------
    times_s : (T,) ndarray
        Their times [s].
    files
        Names of their files, where each has one.

    """

    def __init__(self, times_s: NDArray[np.floating], files: Sequence[str] = ()) -> None:
        self.count, self.files = len(times_s), files
        self._times_s = np.asarray(times_s, float)
        self._period_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 1.0

    def by_number(self, line: Line, value: float, first: int) -> int:
        """Return the index of a frame by its number."""
        if not (float(value).is_integer() and first <= value < first + self.count):
            raise line.fault(
                'no such frame', f'frame {value:.15g} is not one of {first} to '
                f'{first + self.count - 1}')
        return int(value) - first

    def by_time(self, line: Line, time_s: float, from_first: bool) -> int:
        """Return the index of the nearest frame; times may count from the first frame."""
        away_s = np.abs(self._times_s - time_s - (self._times_s[0] if from_first else 0.0))
        if not away_s.min() < _PERIOD_PART * self._period_s:
            raise line.fault('no such frame', f'there is no frame at {time_s:.15g} s')
        return int(away_s.argmin())

    def counts_from_first(self, times_s: Sequence[float]) -> bool:
        """Whether times of a table count from the first frame, whose own time is since 1970."""
        return bool(self.count and self._times_s[0] > _UNIX_S and times_s
                    and np.nanmax(times_s) < _UNIX_S)
