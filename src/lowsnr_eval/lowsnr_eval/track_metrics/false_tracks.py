# SPDX-License-Identifier: Apache-2.0
"""The rate of false tracks: tracks that begin in frames without an object."""

from __future__ import annotations

from typing import Any

from lowsnr_eval.track_metrics.identity import FORGET_AFTER_FRAMES
from lowsnr_eval.track_metrics.track_frame import TrackFrame
import scipy

_CONFIDENCE = 0.95


class FalseTracks:
    """
    Tracks that begin in frames without an object, over these frames.

    A track that began while an object was there, and that outlives it, is none.  One that is not
    published for ``FORGET_AFTER_FRAMES`` frames does not return.
    """

    def __init__(self) -> None:
        self._last: dict[str, int] = {}  # frame in which each track was published last
        self._began = self._empty = self._frame = 0

    def add(self, frame: TrackFrame) -> None:
        """Add a frame; frames come in order."""
        self._frame += 1
        if not len(frame.object_ids):
            self._empty += 1
            self._began += sum(name not in self._last for name in frame.track_ids)
        self._last |= dict.fromkeys(frame.track_ids, self._frame)
        if self._frame % FORGET_AFTER_FRAMES == 0:
            oldest = self._frame - FORGET_AFTER_FRAMES
            self._last = {name: at for name, at in self._last.items() if at > oldest}

    def figures(self) -> dict[str, Any] | None:
        """Return tracks and frames, and their ratio with the exact interval of a Poisson rate."""
        if not self._empty:
            return None
        tail = (1.0 - _CONFIDENCE) / 2.0
        low = scipy.special.gammaincinv(self._began, tail) if self._began else 0.0
        high = scipy.special.gammaincinv(self._began + 1, 1.0 - tail)
        return {
            'tracks': self._began, 'frames': self._empty, 'per_frame': self._began / self._empty,
            'per_frame_interval': [float(low) / self._empty, float(high) / self._empty]}
