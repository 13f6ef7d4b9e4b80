# SPDX-License-Identifier: Apache-2.0
"""The order of the stamps of a stream: new, late, or of a clock that was set back."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from enum import Enum

# So many late messages in a row, each later than the one before, show a clock that was set back;
# two are enough where the first came so long ago [s]: the frames of a slow camera, or of a source
# that waits for an answer to each.
SET_BACK_AFTER, SET_BACK_AFTER_S = 10, 5.0


def in_seconds(stamp: int) -> str:
    """Return a stamp [ns] in seconds, in full."""
    seconds, nanoseconds = divmod(abs(stamp), 1_000_000_000)
    return f'{"-" * (stamp < 0)}{seconds}.{nanoseconds:09}'


class StampOrder(Enum):
    """How a stamp relates to those before it."""

    NEW = 'new'
    LATE = 'late'
    SET_BACK = 'set back'


class Timeline:
    """
    The stamps of one stream.

    A message that is not later than all before it is late, and the node rejects it.  After the
    clock of the stream was set back, or after one stamp in the far future, every message would be
    late.  The stream therefore continues with the ``SET_BACK_AFTER``-th late message in a row, or
    with one ``SET_BACK_AFTER_S`` after the first, provided that each is later than the one
    before; repeated stamps alone do not count.
    ``newest`` is the stamp that new ones must exceed [ns], -1 before the first; negative stamps
    are always late.
    """

    def __init__(self, newest: int = -1) -> None:
        self.newest = newest
        self._row = 0
        self._since_s = 0.0
        self._last_late = -1

    def classify(self, stamp: int, now_s: float) -> StampOrder:
        """Take the next stamp [ns], and when it came [s]; the message is usable unless late."""
        if stamp > self.newest:
            self._continue_from(stamp)
            return StampOrder.NEW
        self._row = 1 + self._row * (stamp > self._last_late) if stamp >= 0 else 0
        self._last_late = stamp
        if self._row <= 1:
            self._since_s = now_s
        if self._row < SET_BACK_AFTER and not (
                self._row > 1 and now_s - self._since_s >= SET_BACK_AFTER_S):
            return StampOrder.LATE
        self._continue_from(stamp)
        return StampOrder.SET_BACK

    def _continue_from(self, stamp: int) -> None:
        self.newest, self._row, self._last_late = stamp, 0, -1


def increasing(stamps: Sequence[int]) -> list[int]:
    """
    Return the indices of the most stamps of which each is later than the one before.

    Negative stamps are left out.  It is the longest increasing subsequence, in
    O(n log n): ``ends[k]`` is the smallest last stamp of any such sequence of k + 1.
    """
    ends: list[int] = []
    last: list[int] = []  # index of the last stamp of the sequence of that length
    before: list[int] = [-1] * len(stamps)
    for index, stamp in enumerate(stamps):
        if stamp < 0:
            continue
        length = bisect_left(ends, stamp)
        if length < len(ends) and ends[length] == stamp:  # a repeated stamp: the first one stays
            continue
        before[index] = last[length - 1] if length else -1
        ends[length:length + 1] = [stamp]
        last[length:length + 1] = [index]
    found, index = [], last[-1] if last else -1
    while index >= 0:
        found.append(index)
        index = before[index]
    return found[::-1]
