# SPDX-License-Identifier: Apache-2.0
"""The attributes of a single integrated air picture (SIAP)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from dataclasses import field

from lowsnr_eval.scoring import metrics
from lowsnr_eval.track_metrics.track_frame import assign_to_nearest
from lowsnr_eval.track_metrics.track_frame import TrackFrame
import numpy as np


@dataclass
class _Continuity:
    """What an object had in tracks: times [s], segments, and the tracks that have it now."""

    first_s: float
    last_s: float
    tracked_s: float = 0.0
    longest_s: float = 0.0
    segments: int = 0
    since_s: dict[str, float] = field(default_factory=dict)  # by track
    candidates: frozenset[str] = frozenset()  # tracks that had it in all of the segment

    def add(self, stamp_s: float, tracks: frozenset[str]) -> None:
        """Add a frame in which these tracks are assigned to the object."""
        if self.since_s.keys() & tracks:
            self.tracked_s += stamp_s - self.last_s
        self.since_s = {name: self.since_s.get(name, stamp_s) for name in tracks}
        self.longest_s = max([
            self.longest_s, *(stamp_s - start for start in self.since_s.values())])
        self.candidates &= tracks
        if tracks and not self.candidates:
            self.segments += 1
            self.candidates = tracks
        self.last_s = stamp_s


class Siap:
    """
    The SIAP attributes of a run.

    With J(t) objects, N(t) tracks, J_T(t) objects that have a track and N_A(t) tracks that are
    assigned to an object, at distances d, summed over all frames ::

        completeness C        = sum J_T / sum J              objects that have a track, ideally 1
        ambiguity A           = sum N_A / sum J_T            tracks an object, ideally 1
        spuriousness S        = sum (N - N_A) / sum N        tracks without an object, ideally 0
        position error PA     = sum d / sum N_A              [m]
        track number changes R = sum_j (U_j - 1) / sum_j T_j   [1/s], ideally 0
        longest segment LS    = sum_j L_j / sum_j D_j        ideally 1

    where object j exists for D_j, has a track for T_j and one and the same for at most L_j [s];
    one that comes again after a frame without it is another object.
    U_j is the least number of segments, each of one track in successive frames, that cover the
    frames in which it has one.  Votruba et al., "Single Integrated Air Picture (SIAP) Metrics
    Implementation", SIAP SE TF 2001, as in Stone Soup's ``SIAPMetrics``.  A track is assigned to
    the nearest object within the gate.

    Parameters
    ----------
    gate_m
        Largest distance of a track from its object [m].

    """

    def __init__(self, gate_m: float) -> None:
        self._gate_m = gate_m
        self._counts = dict.fromkeys(('objects', 'tracked', 'tracks', 'assigned'), 0)
        self._distance_m = 0.0
        self._objects: dict[str, _Continuity] = {}
        # Of objects that have gone: changes of track; seconds tracked, of longest segment, of life
        self._changes, self._times_s = 0, np.zeros(3)

    def add(self, frame: TrackFrame) -> None:
        """Add a frame; frames come in order."""
        assigned = assign_to_nearest(frame, self._gate_m)
        for track, number in assigned.items():
            self._distance_m += float(frame.distance[number, track])
        names: dict[int, set[str]] = {}
        for track, number in assigned.items():
            names.setdefault(number, set()).add(frame.track_ids[track])
        for key, count in (
                ('objects', len(frame.object_ids)), ('tracked', len(names)),
                ('tracks', len(frame.track_ids)), ('assigned', len(assigned))):
            self._counts[key] += count
        if gone := self._objects.keys() - set(frame.object_ids):
            self._end_lives(gone)
        for number, name in enumerate(frame.object_ids):
            known = self._objects.setdefault(name, _Continuity(frame.stamp_s, frame.stamp_s))
            known.add(frame.stamp_s, frozenset(names.get(number, ())))

    def _end_lives(self, gone: Iterable[str]) -> None:
        changes, times_s = _sums([self._objects.pop(name) for name in gone])
        self._changes += changes
        self._times_s += times_s

    def figures(self) -> dict[str, float | None]:
        """Return the attributes so far; None where one does not exist."""
        counts = self._counts
        changes, times_s = _sums(self._objects.values())
        tracked_s, longest_s, life_s = (self._times_s + times_s).tolist()
        assigned = counts['assigned']
        return {
            'completeness': metrics.ratio(counts['tracked'], counts['objects']),
            'ambiguity': metrics.ratio(assigned, counts['tracked']),
            'spuriousness': metrics.ratio(counts['tracks'] - assigned, counts['tracks']),
            'position_error_m': self._distance_m / assigned if assigned else None,
            'track_number_changes_per_s':
                (self._changes + changes) / tracked_s if tracked_s else None,
            'longest_segment': longest_s / life_s if life_s else None,
        }


def _sums(objects: Iterable[_Continuity]) -> tuple[int, np.ndarray]:
    """Return changes of track, and the sums of the times tracked, of longest segment, of life."""
    known = list(objects)
    times_s = [(one.tracked_s, one.longest_s, one.last_s - one.first_s) for one in known]
    return sum(max(one.segments - 1, 0) for one in known), np.sum(
        np.reshape(times_s, (-1, 3)), axis=0)
