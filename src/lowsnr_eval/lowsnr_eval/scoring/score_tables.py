"""
The tables ``frames.csv`` and ``latency.csv``: scores to lines, and lines back to scores.

A line has all that the figures of a run are made of, so that they can be made again from it.
"""

from __future__ import annotations

from collections.abc import Iterable
import csv
import io
from typing import Any
from urllib.parse import quote
from urllib.parse import unquote

from lowsnr_eval.scoring.frame_scoring import Answer
from lowsnr_eval.scoring.frame_scoring import FrameScore
from lowsnr_eval.scoring.frame_scoring import Outcome
import numpy as np

FRAME_COLUMNS = (
    'frame', 'stamp_s', 'detector', 'level', 'objects', 'declared', 'hits', 'false_alarms',
    'rmse_position_m', 'rmse_velocity_mps', 'gospa_m', 'velocities', 'object_ids', 'hit_ids')
LATENCY_COLUMNS = ('frame', 'detector', 'latency_ms', 'detection_ms')
_NAMELESS = '%'


def as_lines(rows: Iterable[Iterable[Any]]) -> bytes:
    """Return rows as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator='\n').writerows(rows)
    return text.getvalue().encode()


def frame_row(score: FrameScore) -> list[Any]:
    """Return the fields of a score; those without an answer or without truth are empty."""
    # repr is the shortest text that reads back as the same time, also for seconds since 1970.
    stamp = repr(float(score.stamp_s))
    objects = '' if score.objects is None else len(score.objects)
    row: list[Any] = [score.frame, stamp, score.detector, score.level, objects]
    outcome, ids = score.outcome, _id_field(score.objects or ())
    if outcome is None:
        return row + [''] * (len(FRAME_COLUMNS) - len(row) - 2) + [ids, '']
    figures = (outcome.rmse_position_m, outcome.rmse_velocity_mps, outcome.gospa_m)
    return row + [
        outcome.declared, *(
            ('', '') if score.objects is None else (len(outcome.hit), outcome.false_alarms)),
        *('' if value is None else f'{value:.9g}' for value in figures),
        outcome.velocity_errors_mps.size, ids, _id_field(outcome.hit)]


def frame_score(row: Iterable[str]) -> FrameScore:
    """
    Return the score that a row tells of; errors of several hits are their root mean square.

    Raises
    ------
    ValueError
        If the row is not one of :func:`frame_row`.

    """
    (frame, stamp, detector, level, objects, declared, _, false_alarms, position, velocity, gospa,
     velocities, object_ids, hit_ids) = row
    outcome = None
    if declared:
        hit = _ids(hit_ids)
        outcome = Outcome(
            int(declared), hit, int(false_alarms) if false_alarms else None,
            _repeated(position, len(hit)), _repeated(velocity, int(velocities)),
            float(gospa) if gospa else None)
    return FrameScore(
        int(frame), float(stamp), detector, level, _ids(object_ids) if objects else None, outcome)


def latency_row(frame: int, detector: str, answer: Answer) -> list[Any]:
    """Return the fields of the wall times from a frame to tracks and detections [ms]."""
    times = (answer.latency_ms, answer.detection_ms)
    return [frame, detector, *('' if each is None else f'{each:.3f}' for each in times)]


def latencies(row: Iterable[str]) -> tuple[int, str, Answer]:
    """Return frame, detector and times of a row of :func:`latency_row`, or raise ValueError."""
    frame, detector, *times = row
    latency_ms, detection_ms = (float(each) if each else None for each in times)
    return int(frame), detector, Answer(None, None, latency_ms, detection_ms)


def _id_field(ids: Iterable[str]) -> str:
    """Return ids as one field, apart by spaces; what is not a plain letter is escaped."""
    return ' '.join(quote(name, safe='') or _NAMELESS for name in ids)


def _ids(field: str) -> tuple[str, ...]:
    return tuple('' if name == _NAMELESS else unquote(name) for name in field.split())


def _repeated(field: str, count: int) -> np.ndarray:
    return np.full(count, float(field)) if count else np.empty(0)
