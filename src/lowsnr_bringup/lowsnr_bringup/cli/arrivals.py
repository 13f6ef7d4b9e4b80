# SPDX-License-Identifier: Apache-2.0
"""The rate and the delay of messages, from the times at which they arrive."""

from __future__ import annotations

from collections import deque
from statistics import fmean
from statistics import pstdev

_SECOND_NS = 1_000_000_000


class _Window:
    """The last durations of a kind [ns]."""

    def __init__(self, size: int) -> None:
        self._durations: deque[int] = deque(maxlen=size)

    def clear(self) -> None:
        """Forget all durations."""
        self._durations.clear()

    @property
    def _spread(self) -> str:
        least, most = min(self._durations), max(self._durations)
        return (f'\tmin: {least / _SECOND_NS:.3f}s max: {most / _SECOND_NS:.3f}s '
                f'std dev: {pstdev(self._durations) / _SECOND_NS:.5f}s '
                f'window: {len(self._durations)}')


class Rate(_Window):
    """The mean rate at which messages arrive."""

    def __init__(self, size: int) -> None:
        super().__init__(size)
        self._last_ns: int | None = None

    def add(self, now_ns: int) -> None:
        """Add a message that arrives now; a clock that is set back starts the window again."""
        if self._last_ns is not None and now_ns < self._last_ns:
            self.clear()
        elif self._last_ns is not None:
            self._durations.append(now_ns - self._last_ns)
        self._last_ns = now_ns

    def text(self) -> str | None:
        """Return the mean rate and the spread of the intervals; None before the second one."""
        if not self._durations:
            return None
        mean_ns = fmean(self._durations)
        return f'average rate: {_SECOND_NS / mean_ns if mean_ns else 0.0:.3f}\n{self._spread}'


class Delay(_Window):
    """The mean time from the stamp of a message to its arrival."""

    def add(self, now_ns: int, stamp_ns: int) -> None:
        """Add a message that arrives now, with the stamp of its header."""
        self._durations.append(now_ns - stamp_ns)

    def text(self) -> str | None:
        """Return the mean delay and its spread; None before the first message."""
        if not self._durations:
            return None
        return f'average delay: {fmean(self._durations) / _SECOND_NS:.3f}\n{self._spread}'
