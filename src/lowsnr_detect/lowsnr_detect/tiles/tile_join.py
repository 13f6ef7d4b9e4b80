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
    """
    What the tiles found in a frame, by number of the tile.

    Parameters
    ----------
    stamp
        Stamp of the frame [ns].
    first_s
        When the first of it came [s].
    parts
        What each tile found.
    passed
        Tiles that will not answer the frame.

    """

    stamp: int
    first_s: float
    parts: dict[int, Any] = field(default_factory=dict)
    passed: set[int] = field(default_factory=set)


class TileJoin:
    """
    Joins what ``tiles`` tiles, numbered from 1, find in each frame.

    A frame waits for every tile for at most ``within_s``, and not for one that has passed it: that
    has answered a later one, or was started again.  A tile for which a frame has waited in vain is
    away, and not waited for until it answers again.

    A clock that is set back may give the same stamps again.  A frame is therefore known by its
    turn, which is how often the clock was set back before, and its stamp.  A tile may be behind
    others by up to half of the time by which the clock is set back.
    """

    def __init__(self, tiles: int, within_s: float) -> None:
        self._within_s = within_s
        # Turn and stamp of the last answer.
        self._newest = dict.fromkeys(range(1, tiles + 1), (0, -1))
        self._away: set[int] = set()
        self._open: dict[tuple[int, int], JoinedFrame] = {}
        self._joined: deque[tuple[int, int]] = deque(maxlen=_MOST_JOINED)

    def add(self, tile: int, stamp: int, found: Any, now_s: float) -> bool:
        """Take what a tile found in the frame of a stamp [ns]; return whether it is in time."""
        key = self._newest[tile] = self._turn_of(tile, stamp), stamp
        self._away.discard(tile)
        if key in self._joined:
            return False
        frame = self._open.setdefault(key, JoinedFrame(stamp, now_s))
        frame.parts[tile] = found
        return True

    def _turn_of(self, tile: int, stamp: int) -> int:
        """Return the turn of the next answer of a tile."""
        turn, last = self._newest[tile]
        if stamp > last:
            return turn
        # The clock is that of all tiles: it was not set back where others are at this stamp, and
        # the last one was an error.
        others = [newest for each, (its, newest) in self._newest.items()
                  if each not in {tile, *self._away} and its == turn]
        return turn + (not any(abs(other - stamp) < abs(other - last) for other in others))

    def pass_by(self, tile: int) -> None:
        """Expect nothing of a tile for the frames that are open: it was started again."""
        for frame in self._open.values():
            frame.passed.add(tile)

    def take(self, now_s: float) -> list[JoinedFrame]:
        """Return the frames that wait for no tile any more, in the order of their stamps."""
        taken = []
        for key in sorted(self._open):
            frame = self._open[key]
            waits = {tile for tile, newest in self._newest.items() if newest < key
                     and tile not in {*frame.parts, *frame.passed, *self._away}}
            if waits and now_s - frame.first_s < self._within_s:
                break
            self._away |= waits
            self._joined.append(key)
            taken.append(self._open.pop(key))
            for tile, newest in self._newest.items():  # a tile may be away when a turn begins
                self._newest[tile] = max(newest, (key[0], -1))
        return taken
