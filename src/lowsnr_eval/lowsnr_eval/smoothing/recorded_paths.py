# SPDX-License-Identifier: Apache-2.0
"""The paths of the tracks of a run: states, and the detections and objects that belong to them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field
from pathlib import Path
from typing import NamedTuple

from lowsnr_bringup.run import results_folder as files
from lowsnr_eval.scoring import metrics
from lowsnr_eval.scoring.camera_table import View
from lowsnr_eval.scoring.entry_tables import Entry
from lowsnr_eval.scoring.entry_tables import FrameRows
from lowsnr_eval.scoring.entry_tables import TRUTH_COLUMNS
import numpy as np

# A track that is not published for so many frames does not return.
FORGET_AFTER_FRAMES = 1000
_Values = tuple[float, ...]
_NOTHING = (np.nan,) * 4


class Point(NamedTuple):
    """
    A track in one frame; positions in pixels of the image, velocities in pixels a second.

    ``filtered`` is x, y, v_x, v_y and their standard deviations; ``detected`` is x, y of the
    track's detection and their standard deviations, ``truth`` x, y, v_x, v_y of its object; NaN
    is not known, or none.
    """

    frame: int
    stamp_ns: int
    view: View
    filtered: _Values
    detected: _Values
    truth: _Values


@dataclass
class TrackPath:
    """The points of a track, in order, and the names of track and chain as in the tables."""

    detector: str
    name: str
    points: list[Point] = field(default_factory=list)


def read_paths(
    folder: Path, views: Mapping[int, View] | None, gate_cells: float, left_out: Counter[str],
) -> Iterator[TrackPath]:
    """
    Yield the path of each track when it has ended.

    In each frame tracks are paired one with one with objects as in its score.  A detection belongs
    to a track where each is the nearest one of the other, within the gate: a track whose detection
    is missing does not get that of another track, nor this one a false one in its place.

    Parameters
    ----------
    folder
        Results folder.  Its tables are read line by line; in memory are the tracks that live.
    views
        View of each stamp [ns]; None for a camera that stands still and is not conditioned.
        Tracks in frames without one are left out.
    gate_cells
        Largest distance of a pair [cells]; of objects it is in pixels, as in the scores.
    left_out
        Counts the points of each chain that are left out.

    """
    tracks = FrameRows(folder / files.TRACKS_FILE)
    detections = FrameRows(folder / files.DETECTIONS_FILE)
    truth = FrameRows(folder / files.TRUTH_FILE, TRUTH_COLUMNS)
    living: dict[tuple[str, str], TrackPath] = {}
    while group := tracks.advance():
        frame, rows = group
        view = View() if views is None else views.get(rows[0].stamp_ns)
        if view is None:
            left_out.update(row.detector for row in rows)
            continue
        seen, objects = detections.take(frame), truth.take(frame)
        for name, own in _by_detector(rows).items():
            found = [row for row in seen if row.detector == name]
            for point, row in zip(_points(own, found, objects, gate_cells, view), own):
                yield from _extend(living, row, point)
        yield from _ended(living, frame - FORGET_AFTER_FRAMES)
    yield from living.values()


def _extend(
    living: dict[tuple[str, str], TrackPath], row: Entry, point: Point,
) -> Iterator[TrackPath]:
    """Add a point to the path of its track; where the clock was set back, a new one begins."""
    key = row.detector, row.name
    path = living.setdefault(key, TrackPath(*key))
    if path.points and point.stamp_ns <= path.points[-1].stamp_ns:
        yield living.pop(key)
        path = living.setdefault(key, TrackPath(*key))
    path.points.append(point)


def _ended(living: dict[tuple[str, str], TrackPath], before: int) -> Iterator[TrackPath]:
    for key in [key for key, path in living.items() if path.points[-1].frame < before]:
        yield living.pop(key)


def _by_detector(rows: Sequence[Entry]) -> dict[str, list[Entry]]:
    found: dict[str, list[Entry]] = {}
    for row in rows:
        found.setdefault(row.detector, []).append(row)
    return found


def _points(
    tracks: Sequence[Entry], detections: Sequence[Entry], objects: Sequence[Entry], gate: float,
    view: View,
) -> Iterator[Point]:
    """Yield the point of each track of a chain in a frame."""
    seen = _pairs(detections, tracks, gate * view.binning, metrics.match_nearest)
    true = _pairs(objects, tracks, gate, metrics.match_within_gate)
    for number, row in enumerate(tracks):
        values = seen[number].values if number in seen else _NOTHING * 2
        yield Point(
            row.frame, row.stamp_ns, view, row.values[:8], (*values[:2], *values[4:6]),
            true[number].values if number in true else _NOTHING)


def _pairs(
    entries: Sequence[Entry], tracks: Sequence[Entry], gate: float, match: metrics.Matching,
) -> dict[int, Entry]:
    """Return the entry of each track that has one, by the index of the track."""
    places, own = (np.reshape([row.values[:2] for row in some], (-1, 2))
                   for some in (entries, tracks))
    pairs = match(metrics.distances(places, own), gate)
    return {int(track): entries[row] for row, track in zip(*pairs, strict=True)}
