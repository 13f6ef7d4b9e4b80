# SPDX-License-Identifier: Apache-2.0
"""The ledger of a run's frames: how many were published, and where those without a score went."""

from __future__ import annotations


class FrameLedger:
    """
    Counts what becomes of each published frame.

    The evaluator scores frames in the order of their stamps, numbers them from 1, writes each
    into its table and then announces it.  Two counts follow from what happens, not from a
    difference to the published frames, so that the sum of all counts can be checked:

    - ``unseen``: a frame that was still awaited when the evaluator announced a later one, or when
      the run ended;
    - ``lost``: a frame that was announced, but that the table does not hold, because an evaluator
      that was started again numbers on from an earlier one, or because the table ends earlier.

    A frame that an evaluator wrote before it ended, without announcing it, is neither: the numbers
    show that the table holds it.  Memory grows only with the frames that wait for their score.

    Parameters
    ----------
    number
        Frames that the table holds already; they count as published.
    told
        Whether :meth:`publish` tells of each frame.  Of a camera only what the evaluator writes
        is known: those frames count as published.

    """

    def __init__(self, number: int = 0, told: bool = True) -> None:
        self.published = self._number = number
        self._told = told
        self.unseen = self.lost = 0
        self._awaited: dict[int, None] = {}  # stamps in the order of publication
        self._early: set[int] = set()  # stamps announced before their publication was known

    @property
    def awaits(self) -> bool:
        """Whether a published frame has neither been announced nor passed."""
        return bool(self._awaited)

    def publish(self, stamp: int) -> None:
        """Count a frame that the source published, by its stamp [ns]."""
        self.published += 1
        if stamp in self._early:
            self._early.remove(stamp)
        elif stamp in self._awaited:  # only one frame of a stamp is scored
            self.unseen += 1
        else:
            self._awaited[stamp] = None

    def publish_unheard(self, total: int) -> None:
        """Count the frames that are missing of a total published: their stamps were not heard."""
        unheard = max(0, total - self.published) if self._told else 0
        self.published += unheard
        for stamp in sorted(self._early)[:unheard]:  # announced: these have been seen
            self._early.remove(stamp)
            unheard -= 1
        self.unseen += unheard

    def score(self, stamp: int, number: int) -> None:
        """Count a frame that the evaluator announced, by its stamp [ns] and its number."""
        passed = 0
        while (first := next(iter(self._awaited), stamp)) < stamp:
            del self._awaited[first]
            passed += 1
        if stamp in self._awaited:
            del self._awaited[stamp]
        elif self._told:
            self._early.add(stamp)
        else:
            self.published += 1
        self._continue_after(number - 1, passed)
        self._number = number

    def close(self, frames: int, last: int) -> None:
        """Close the ledger of a run whose table holds so many frames, the last of that number."""
        passed = len(self._awaited)
        self._awaited.clear()
        self._continue_after(last, passed)
        self.lost += last - frames  # those between others: too many had waited for room

    def _continue_after(self, last: int, passed: int) -> None:
        """Count frames that were passed, where the table holds those up to a number."""
        written = last - self._number
        if not self._told:  # those that were written and not announced
            self.published += max(written, 0)
            passed += max(written, 0)
        self.unseen += passed - max(written, 0)
        self.lost += max(-written, 0)
        self._number = last
