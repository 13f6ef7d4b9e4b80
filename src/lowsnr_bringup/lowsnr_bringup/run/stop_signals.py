# SPDX-License-Identifier: Apache-2.0
"""The signals that ask a run to end: Ctrl-C, SIGTERM, and SIGHUP when its terminal closes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import os
import signal
import stat
from types import FrameType
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopSignals:
    """
    Counts the signals that ask for the end; use it as a context manager.

    Each raises KeyboardInterrupt, but within :meth:`deferred`, where ``count`` tells of them.  A
    SIGHUP that the process was started to ignore, by ``nohup``, stays ignored.
    """

    def __init__(self) -> None:
        self.count = 0
        self._deferred = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> StopSignals:
        for number in _SIGNALS:
            before = signal.getsignal(number)
            if number is not signal.SIGHUP or before is not signal.SIG_IGN:
                self._before[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    @contextmanager
    def deferred(self) -> Iterator[None]:
        """Raise nothing in the ``with`` block: what it does must be done."""
        self._deferred = True
        try:
            yield
        finally:
            self._deferred = False

    def _on_signal(self, number: int, _: FrameType | None) -> None:
        self.count += 1
        if number == signal.SIGHUP:
            _leave_terminal()
        if not self._deferred:
            raise KeyboardInterrupt


def _leave_terminal() -> None:
    """Write to nowhere what would go to a terminal: writing to one that is closed is an error."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1, 2):
        if stat.S_ISCHR(os.fstat(number).st_mode):
            os.dup2(nowhere, number)
    os.close(nowhere)
