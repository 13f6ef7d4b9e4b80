# SPDX-License-Identifier: Apache-2.0
"""Whether each track follows one object, and each object keeps its track."""

from __future__ import annotations

from collections import Counter
from typing import Any

from lowsnr_eval.scoring import metrics
from lowsnr_eval.track_metrics.track_frame import TrackFrame
import numpy as np

# A track that is in no pair for so many frames does not return.
FORGET_AFTER_FRAMES = 1000


class Identities:
    """
    Switches and swaps of identity, and the purity of tracks.

    Objects and tracks are paired one with one in each frame.  A pair of the frame before remains
    while it is within the gate; the others are paired as in the score of a frame.  So tracks that
    pass each other within the gate do not change their objects for a moment.  This is the mapping
    of Bernardin and Stiefelhagen, "Evaluating multiple object tracking performance: the CLEAR MOT
    metrics", EURASIP J. Image Video Processing 2008, section 2.1.

    ``identity_switches``: an object is paired with another track than the last time (their
    mismatches mme).  One that comes again after a frame without it is another object, which
    nobody could have followed.  ``identity_swaps``: a track is paired with another object than the
    last time, it has gone over to it; two objects that exchange their tracks make two.
    ``track_purity``: the pairs of each track with the object that it has most, over all pairs; 1
    if no track had two objects.

    Parameters
    ----------
    gate_m
        Largest distance of a pair [m].

    """

    def __init__(self, gate_m: float) -> None:
        self._gate_m = gate_m
        self._pairs: dict[str, str] = {}  # track by object, of the last frame
        self._track_of: dict[str, str] = {}  # the last one of each object that is present
        self._object_of: dict[str, tuple[str, int]] = {}  # last one, and in which frame
        self._objects_of: dict[str, Counter[str]] = {}  # frames of each track with each object
        self._switches = self._swaps = self._paired = self._pure = self._frame = 0

    def add(self, frame: TrackFrame) -> None:
        """Add a frame; frames come in order."""
        self._frame += 1
        self._pairs = self._pair(frame)
        for name in self._track_of.keys() - set(frame.object_ids):
            del self._track_of[name]
        for name, track in self._pairs.items():
            self._switches += self._track_of.get(name, track) != track
            self._swaps += self._object_of.get(track, (name, 0))[0] != name
            self._track_of[name] = track
            self._object_of[track] = name, self._frame
            self._objects_of.setdefault(track, Counter())[name] += 1
        self._paired += len(self._pairs)
        if self._frame % FORGET_AFTER_FRAMES == 0:
            self._forget()

    def _pair(self, frame: TrackFrame) -> dict[str, str]:
        """Return the track of each object that has one."""
        rows = {name: n for n, name in enumerate(frame.object_ids)}
        columns = {name: n for n, name in enumerate(frame.track_ids)}
        pairs = {
            name: track for name, track in self._pairs.items()
            if name in rows and track in columns
            and frame.distance[rows[name], columns[track]] <= self._gate_m}
        left = [n for name, n in rows.items() if name not in pairs]
        free = [n for name, n in columns.items() if name not in pairs.values()]
        if not left or not free:
            return pairs
        found = metrics.match_within_gate(frame.distance[np.ix_(left, free)], self._gate_m)
        return pairs | {
            frame.object_ids[left[row]]: frame.track_ids[free[column]]
            for row, column in zip(*found, strict=True)}

    def _forget(self) -> None:
        before = self._frame - FORGET_AFTER_FRAMES
        for track, (_, at) in list(self._object_of.items()):
            if at <= before:
                del self._object_of[track]
                self._pure += max(self._objects_of.pop(track).values())

    def figures(self) -> dict[str, Any]:
        """Return the figures so far; the purity of no pair is None."""
        pure = self._pure + sum(max(each.values()) for each in self._objects_of.values())
        return {
            'identity_switches': self._switches, 'identity_swaps': self._swaps,
            'track_purity': metrics.ratio(pure, self._paired)}
