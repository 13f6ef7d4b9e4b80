"""Which stamps of a stream are new, which come too late, and when its clock was set back."""

from __future__ import annotations

from enum import Enum

# Refused messages in a row, each later than the one before, that show a clock set back.
SET_BACK_AFTER = 10


class Verdict(Enum):
    """What a stamp says of its message."""

    NEW = 'new'
    LATE = 'late'
    SET_BACK = 'set back'


class Timeline:
    """
    The stamps of one stream.

    A message that is not later than all before is late, and of no use.  But where the clock of
    the stream was set back, or one stamp lay in a far future, all that follow would be late:
    the stream goes on with the ``SET_BACK_AFTER``-th message in a row that is late and yet later
    than the one before.  Repeated stamps alone never set it back.  ``newest`` is the stamp that
    new ones must exceed [ns], -1 before the first; negative stamps are always late.
    """

    def __init__(self, newest: int = -1) -> None:
        self.newest = newest
        self._row = 0
        self._last_late = -1

    def judge(self, stamp: int) -> Verdict:
        """Take a stamp [ns]; a message that is new or shows a clock set back is to be used."""
        if stamp > self.newest:
            self._go_on(stamp)
            return Verdict.NEW
        self._row = 1 + self._row * (stamp > self._last_late) if stamp >= 0 else 0
        self._last_late = stamp
        if self._row < SET_BACK_AFTER:
            return Verdict.LATE
        self._go_on(stamp)
        return Verdict.SET_BACK

    def _go_on(self, stamp: int) -> None:
        self.newest, self._row, self._last_late = stamp, 0, -1
