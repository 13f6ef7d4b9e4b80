"""What the tracker remembers from frame to frame, and what it answers to one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from lowsnr_common.core.records import Estimate
from lowsnr_track.track_management import Tracks


@dataclass(frozen=True)
class TrackerState:
    """
    Memory between frames.

    ``stamp_s`` is the time of the last frame, None before the first [s]; ``frames`` their
    number; ``next_id`` the next track's number; ``clutter`` the density of false detections
    [1/cell].
    """

    stamp_s: float | None
    frames: int
    next_id: int
    clutter: float
    tracks: Tracks


@dataclass(frozen=True)
class TrackerOutput:
    """
    The answer to one frame.

    ``confirmed`` and ``tentative`` hold a whole state each, with the existence probability as
    score; ``refused`` counts detections that could not be used, by reason.
    """

    confirmed: list[Estimate]
    tentative: list[Estimate]
    refused: Mapping[str, int]
