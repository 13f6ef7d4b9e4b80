# SPDX-License-Identifier: Apache-2.0
"""The rows of ``frames.csv`` and ``latency.csv``: scores to lines, and lines back to scores."""

from __future__ import annotations

from collections.abc import Iterable
import csv
from functools import lru_cache
import io
from typing import Any
from typing import NamedTuple
from urllib.parse import quote
from urllib.parse import unquote

from lowsnr_eval.scoring.frame_scoring import Answer
from lowsnr_eval.scoring.frame_scoring import Comparison
from lowsnr_eval.scoring.frame_scoring import FrameScore

FRAME_COLUMNS = (
    'frame', 'stamp_s', 'detector', 'level', 'objects', 'declared', 'hits', 'false_alarms',
    'rmse_position_m', 'rmse_velocity_mps', 'gospa_m', 'velocities', 'object_ids', 'hit_ids')
LATENCY_COLUMNS = ('frame', 'detector', 'latency_ms', 'detection_ms')
_NAMELESS = '%'
_LONGEST_CACHED = 200
# Largest count, time [s or ms] and figure of merit that a line of a run can have.
_MOST, _LATEST, _LARGEST = 2**53, 2.0**43, 1e150
# The ids of 10,000 objects of 255 letters, each letter escaped, are 31 MB.
csv.field_size_limit(2**26)


class Latency(NamedTuple):
    """The wall times from a frame to the tracks and to the detections of a chain [ms]."""

    frame: int
    detector: str
    latency_ms: float
    detection_ms: float | None


def as_lines(rows: Iterable[Iterable[Any]]) -> bytes:
    """Return rows as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator='\n').writerows(rows)
    return text.getvalue().encode()


def frame_row(score: FrameScore) -> list[Any]:
    """Return the fields of a score; those without an answer or without truth are empty."""
    # repr is the shortest text that reads back as the same time, also for seconds since 1970.
    stamp = repr(float(score.stamp_s))
    truth, comparison = score.object_ids is not None, score.comparison
    ids = score.object_ids or ()
    row = [score.frame, stamp, score.detector, score.level, len(ids) if truth else '']
    if comparison is None:
        return [*row, *[''] * 7, id_field(ids), '']
    figures = (comparison.rmse_position_m, comparison.rmse_velocity_mps, comparison.gospa_m)
    return [
        *row, comparison.declared, len(comparison.hit_ids) if truth else '',
        comparison.false_alarms if truth else '',
        *('' if value is None else f'{value:.9g}' for value in figures),
        comparison.velocities, id_field(ids), id_field(comparison.hit_ids)]


def frame_score(line: bytes) -> FrameScore:
    """Return the score that a line of :func:`frame_row` holds, or raise ValueError."""
    frame, stamp, rest = line.split(b',', 2)
    # In a long run most lines are alike, but for frame and stamp.
    parse = _cached_score_of if len(rest) < _LONGEST_CACHED else _score_of
    return FrameScore(_count(frame), _time(stamp), *parse(rest))


def _score_of(rest: bytes) -> tuple[str, str, tuple[str, ...] | None, Comparison | None]:
    """Return detector, level, ids of the objects and comparison of a line without its frame."""
    (detector, level, objects, declared, _, false_alarms, position, velocity, gospa, velocities,
     object_ids, hit_ids) = next(csv.reader([rest.decode()]))
    ids = _ids(object_ids) if objects else None
    if not declared:
        return detector, level, ids, None
    return detector, level, ids, Comparison(
        _count(declared), _ids(hit_ids), _count(false_alarms) if false_alarms else None,
        _figure(position), _figure(velocity), _figure(gospa), _count(velocities))


_cached_score_of = lru_cache(maxsize=4096)(_score_of)


def latency_row(frame: int, detector: str, answer: Answer) -> list[Any]:
    """Return the fields of the wall times of an answer that has tracks."""
    times = (answer.latency_ms, answer.detection_ms)
    return [frame, detector, *('' if each is None else f'{each:.3f}' for each in times)]


def latency(line: bytes) -> Latency:
    """Return the wall times that a line of :func:`latency_row` holds, or raise ValueError."""
    frame, detector, tracks, detections = next(csv.reader([line.decode()]))
    return Latency(
        _count(frame), detector, _time(tracks), _time(detections) if detections else None)


def frame_number(line: bytes) -> int:
    """Return the number of the frame with which a line begins, or raise ValueError."""
    return _count(line.partition(b',')[0])


def stamp_text(stamp: int) -> str:
    """Return a stamp [ns] in seconds, to the nanosecond."""
    return f'{stamp // 1_000_000_000}.{stamp % 1_000_000_000:09d}'


def stamp_ns(text: str) -> int:
    """Return the stamp [ns] that a text of :func:`stamp_text` holds, or raise ValueError."""
    seconds, _, part = text.partition('.')
    if len(part) != 9:
        raise ValueError(text)
    return _count(seconds) * 1_000_000_000 + _count(part)


def _count(text: str | bytes) -> int:
    return int(_within(int(text), 0, _MOST))


def _time(text: str | bytes) -> float:
    return _within(float(text), -_LATEST, _LATEST)


def _figure(text: str) -> float | None:
    return _within(float(text), 0.0, _LARGEST) if text else None


def _within(value: float, least: float, most: float) -> float:
    """Return a value that a run can have; its sums and squares are then finite too."""
    if not least <= value <= most:
        raise ValueError(value)
    return value


def id_field(ids: Iterable[str]) -> str:
    """
    Return ids as one field, separated by spaces, all but plain letters escaped.

    So is a minus at the start, which a spreadsheet would take for that of a formula.
    """
    fields = (quote(name, safe='') or _NAMELESS for name in ids)
    return ' '.join(f'%2D{each[1:]}' if each[0] == '-' else each for each in fields)


def _ids(field: str) -> tuple[str, ...]:
    names = field.split()
    if '%' in field:
        names = ['' if name == _NAMELESS else unquote(name) for name in names]
    return tuple(names)
