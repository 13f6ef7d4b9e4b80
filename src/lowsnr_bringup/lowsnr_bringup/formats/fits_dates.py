# SPDX-License-Identifier: Apache-2.0
"""Times in the headers of FITS files: DATE-OBS and its older forms, and time axes of cubes."""

from __future__ import annotations

from datetime import date
import re
from typing import Any

_DATE = re.compile(r'(\d{4})-(\d\d)-(\d\d)')
_OLD_DATE = re.compile(r'(\d\d)/(\d\d)/(\d\d)')  # day, month and year of the 20th century
_TIME = re.compile(r'(\d\d):(\d\d):(\d\d)(?:\.(\d*))?')
_DATES, _TIMES = ('DATE-OBS', 'DATE-BEG'), ('TIME-OBS', 'TIME-BEG', 'UTC-OBS', 'UT', 'UTC')
_DAYS = {'MJD-OBS': 40_587.0, 'MJD-BEG': 40_587.0, 'JD': 2_440_587.5}  # those of 1970
_DAY_NS = 86_400 * 10**9
_UNITS_S = {'': 1.0, 's': 1.0, 'ms': 1e-3, 'us': 1e-6, 'min': 60.0, 'h': 3600.0, 'd': 86400.0}


def unix_ns(text: str, time_text: str = '') -> int | None:
    """
    Return the time of a date such as ``2026-01-01T00:00:30.5`` [ns since 1970, UTC].

    ``time_text`` is the time of day of a date without one; None if there is none in either.
    """
    found, old = _DATE.match(text.strip()), _OLD_DATE.match(text.strip())
    if found:
        year, month, day = map(int, found.groups())
        rest = text.strip()[found.end():].lstrip('T ')
    elif old:
        day, month, year = map(int, old.groups())
        year, rest = year + 1900, ''
    else:
        return None
    clock = _TIME.match(rest or time_text.strip())
    if clock is None:
        return None
    hours, minutes, seconds = (int(clock[k]) for k in (1, 2, 3))
    try:
        days = (date(year, month, day) - date(1970, 1, 1)).days
    except ValueError:
        return None
    fraction_ns = int((clock[4] or '').ljust(9, '0')[:9] or 0)
    return days * _DAY_NS + (hours * 3600 + minutes * 60 + seconds) * 10**9 + fraction_ns


def time_of(header: Any, primary: Any) -> int | None:
    """Return when an image was taken, by its header or that of the file [ns since 1970]."""
    for source in (header, primary):
        clock = next((str(source[key]) for key in _TIMES if key in source), '')
        for key in _DATES:
            found = unix_ns(str(source.get(key, '')), clock)
            if found is not None:
                return found
        for key, zero in _DAYS.items():
            days = source.get(key)
            if isinstance(days, int | float) and days > zero:
                return round((days - zero) * 86_400 * 10**6) * 10**3  # what a double resolves
    return None


def seconds_of_a_plane(header: Any) -> float | None:
    """Return the time between the planes of a cube whose third axis is time [s]."""
    step = header.get('CDELT3')
    unit = str(header.get('CUNIT3', '')).strip().lower()
    is_time = str(header.get('CTYPE3', '')).strip().upper().startswith(('TIME', 'UTC'))
    if is_time and isinstance(step, int | float) and step > 0 and unit in _UNITS_S:
        return float(step) * _UNITS_S[unit]
    return None
