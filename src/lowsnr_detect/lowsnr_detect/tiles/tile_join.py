# SPDX-License-Identifier: Apache-2.0
"""What the tiles found in each frame, joined by stamp."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from dataclasses import field
from typing import Any

# Reason of the fault, and counter, of frames that are answered without one.
WITHOUT_TILE = 'without a tile'
# Frames that were joined, of which something may still come.
_MOST_JOINED = 2000


@dataclass
class JoinedFrame:
    """What the tiles found in a frame, by number of the tile, and when the first of it came."""

    stamp: int
    first_s: float
    parts: dict[int, Any] = field(default_factory=dict)


class TileJoin:
    """
    Joins what ``tiles`` tiles, numbered from 1, find in each frame.

    A frame waits for every tile for at most ``within_s``, and not for one that has passed it: that
    has answered a later one, or was started again.  A tile for which a frame has waited in vain is
    away, and not waited for until it answers again.
    """

    def __init__(self, tiles: int, within_s: float) -> None:
        self._within_s = within_s
        self._newest = dict.fromkeys(range(1, tiles + 1), -1)  # stamp of the last answer
        self._away: set[int] = set()
        self._open: dict[int, JoinedFrame] = {}
        self._joined: deque[int] = deque(maxlen=_MOST_JOINED)

    def add(self, tile: int, stamp: int, found: Any, now_s: float) -> bool:
        """Take what a tile found in the frame of a stamp [ns]; return whether it is in time."""
        self._newest[tile] = stamp
        self._away.discard(tile)
        if stamp in self._joined:
            return False
        frame = self._open.setdefault(stamp, JoinedFrame(stamp, now_s))
        frame.parts[tile] = found
        return True

    def pass_by(self, tile: int) -> None:
        """Expect nothing of a tile for the frames that are open: it was started again."""
        self._newest[tile] = max([self._newest[tile], *self._open])

    def take(self, now_s: float) -> list[JoinedFrame]:
        """Return the frames that wait for no tile any more, in the order of their stamps."""
        taken = []
        for stamp in sorted(self._open):
            frame = self._open[stamp]
            waits = {tile for tile, newest in self._newest.items()
                     if tile not in frame.parts and tile not in self._away and newest < stamp}
            if waits and now_s - frame.first_s < self._within_s:
                break
            self._away |= waits
            self._joined.append(stamp)
            taken.append(self._open.pop(stamp))
        return taken
